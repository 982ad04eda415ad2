// Request and response: a robot serves its battery's state; another asks, and all are asked.
//
//     build/default/examples/request wombat-1             # serves
//     build/default/examples/request wombat-2 wombat-1    # asks
#include <chrono>
#include <iostream>
#include <rect.hpp>
#include <rect/nlohmann.hpp>
#include <thread>

using nlohmann::json;
constexpr auto patience = std::chrono::seconds(2);

json battery(const rect::Request& request) {
    const auto asked = rect::must(request.payload.value<json>());
    const auto cell = asked.value("cell", 0);
    if (cell < 1 || cell > 2) {
        throw rect::Refusal("there are the cells 1 and 2");
    }
    return {{"cell", cell}, {"volt", 3.6}};
}

void show(const rect::expected<rect::Reply>& reply) {
    if (reply) {
        std::cout << reply->from() << ": " << reply->payload.text().value_or("(no text)") << std::endl;
    } else {
        std::cout << reply.error().text << std::endl;
    }
}

int main(int argc, char** argv) {
    const auto robot = rect::must(rect::connect(argc > 1 ? argv[1] : "wombat-1"));
    if (argc <= 2) {
        const auto service = rect::must(robot.serve("battery", battery));
        std::cout << rect::must(robot.name()) << " serves; Ctrl-C ends this" << std::endl;
        for (;;) {
            std::this_thread::sleep_for(std::chrono::hours(1));
        }
    }
    // The answer comes to this call alone. An error of the service is an error here.
    show(robot.request(argv[2], "battery", json{{"cell", 1}}, patience));
    const auto replies = rect::must(robot.request_all("battery", json{{"cell", 9}}, patience));
    for (auto reply = replies.next();; reply = replies.next()) {
        if (!reply && reply.error().code != rect::Code::service) {
            return 0;
        }
        show(reply);
    }
}
