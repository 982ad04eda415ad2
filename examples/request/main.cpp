// Request: a robot offers its battery's state as a service. Another robot sends requests to it, and to all robots.
//
//     build/default/examples/request wombat-1             # offers the service
//     build/default/examples/request wombat-2 wombat-1    # sends requests
#include <chrono>
#include <iostream>
#include <rect.hpp>
#include <rect/nlohmann.hpp>
#include <thread>

using nlohmann::json;

json battery(const rect::Request& request) {
    const auto query = rect::must(request.payload.value<json>());
    const auto cell = query.value("cell", 0);
    if (cell < 1 || cell > 2) {
        throw rect::Refusal("the cell must be 1 or 2");
    }
    return {{"cell", cell}, {"volt", 3.6}};
}

void show(const rect::expected<rect::Reply>& reply) {
    if (reply) {
        std::cout << reply->sender() << ": " << reply->payload.text().value_or("(no text)") << std::endl;
    } else {
        std::cout << reply.error().text << std::endl;
    }
}

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    if (argc <= 2) {
        const auto service = rect::must(robot.serve("battery", battery));
        std::cout << rect::must(robot.name()) << " serves requests; press Ctrl-C to stop" << std::endl;
        for (;;) {
            std::this_thread::sleep_for(std::chrono::hours(1));
        }
    }
    // Only this call receives the reply. If the service replies with an error, the call fails with it.
    show(robot.request(argv[2], "battery", json{{"cell", 1}}));
    const auto replies = rect::must(robot.request_all("battery", json{{"cell", 9}}));
    for (auto reply = replies.next();; reply = replies.next()) {
        if (!reply && reply.error().code != rect::Code::service) {
            return 0;
        }
        show(reply);
    }
}
