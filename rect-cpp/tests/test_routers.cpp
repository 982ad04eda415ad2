// Two routers on the simulated air, which in_the_air.py starts: a C++ robot at each.
#include <cstdlib>
#include <thread>
#include <vector>

#include "pair.hpp"

namespace {

rect::Robot at(const char* name, const char* variable) {
    const char* endpoint = std::getenv(variable);
    if (endpoint == nullptr) {
        throw std::runtime_error(std::string(variable) + " is not there: in_the_air.py sets it");
    }
    rect::Options options;
    options.router = endpoint;
    return must(rect::connect(name, options));
}

struct Routers {
    rect::Robot one = at("wombat-1", "RECT_ROUTER_1");
    rect::Robot two = at("wombat-2", "RECT_ROUTER_2");
};

}  // namespace

TEST_CASE("a message comes over Bluetooth, and says so", "[.routers]") {
    Routers routers;
    const auto subscriber = must(routers.two.subscribe("wombat-1/arm/angle"));
    rect::expected<rect::Message> message = subscriber.next(0ms);
    until([&] {
        must(routers.one.publish("arm/angle", "12.5"));
        message = subscriber.next(patience);
        return message && !(*message)->over().empty();
    });
    CHECK((*message)->over() == "ble");
    CHECK(must((*message)->payload.text()) == "12.5");
}

TEST_CASE("a service is asked over Bluetooth", "[.routers]") {
    Routers routers;
    const auto service = must(routers.two.serve("battery", [](const rect::Request& request) { return std::string(request.from()); }));
    rect::expected<rect::Reply> reply = routers.one.request("wombat-2", "battery", "", deadline);
    until([&] {
        if (!reply) {
            reply = routers.one.request("wombat-2", "battery", "", deadline);
        }
        return reply.has_value();
    });
    CHECK(must(reply->payload.text()) == "wombat-1");
}

TEST_CASE("a large transfer goes over Bluetooth while urgent messages overtake it", "[.routers]") {
    Routers routers;
    rect::ReceiveOptions taking;
    taking.max_bytes = 1 << 20;
    const auto transfers = must(routers.two.receive_transfers("*/map", taking));
    const std::string map(100'000, 'm');
    std::thread sending([&] { must(routers.one.transfer("wombat-2", "map", map)); });
    const auto subscriber = must(routers.two.subscribe("wombat-1/stop"));
    const auto urgent = must(routers.one.with(rect::Urgency::urgent));
    until([&] {
        must(urgent.publish("stop", "now"));
        return subscriber.next(patience).has_value();
    });
    const auto received = must(transfers.next(deadline));
    sending.join();
    CHECK(received.size_bytes() == map.size());
}

TEST_CASE("the registry is asked, and its connections are changed", "[.routers]") {
    Routers routers;
    std::vector<rect::Connection> connections;
    until([&] {
        connections = must(routers.one.connections("method=ble;state=connected"));
        return connections.size() == 1 && !connections[0].peer.empty();
    });
    CHECK(connections[0].peer == "wombat-2");
    CHECK(connections[0].state == rect::LinkState::connected);
    CHECK(connections[0].sent_bytes.has_value());
    CHECK_FALSE(must(routers.one.ask_registry("connections/count")).empty());

    rect::NamedConnection base{"base", "tcp", "127.0.0.1"};
    base.port = 1;
    must(routers.one.add_connection(base));
    until([&] {
        const auto all = must(routers.one.connections());
        return std::any_of(all.begin(), all.end(), [](const auto& one) { return one.name == "base"; });
    });
    must(routers.one.remove_connection("base"));
    until([&] {
        const auto all = must(routers.one.connections());
        return std::none_of(all.begin(), all.end(), [](const auto& one) { return one.name == "base"; });
    });
    CHECK(routers.one.remove_connection("base").error().code == rect::Code::service);
}

TEST_CASE("events tell of the link and over which radio it is", "[.routers]") {
    Routers routers;
    Flag linked;
    const auto state = must(routers.one.on_state([&](const rect::Event& event) {
        if (event.kind() == rect::Event::Kind::link_up && event.method() == "ble" && event.robot() == "wombat-2") {
            linked.set();
        }
    }));
    CHECK(linked.wait());
}
