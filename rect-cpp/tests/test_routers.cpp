// Tests C++ programs at two routers on the simulated air, which run_with_routers.py starts.
//
//     python tests/run_with_routers.py build/default/tests/rect_tests '[.routers]'
#include <thread>
#include <vector>

#include "routers.hpp"

TEST_CASE("a message received over Bluetooth reports its method", "[.routers]") {
    Routers routers;
    const auto subscriber = must(routers.two.subscribe("wombat-1/arm/angle"));
    rect::expected<rect::Message> message = subscriber.next(0ms);
    until([&] {
        must(routers.one.publish("arm/angle", "12.5"));
        message = subscriber.next(retry_interval);
        return message && !message->method().empty();
    });
    CHECK(message->method() == "ble");
    CHECK(must(message->payload.text()) == "12.5");
}

TEST_CASE("messages over Bluetooth arrive once the subscription is established", "[.routers]") {
    Routers routers;
    must(routers.two.wait_for_peer("wombat-1", deadline));
    const auto subscriber = must(routers.two.subscribe("wombat-1/arm/*"));
    must(routers.two.wait_until_established(deadline));
    must(routers.one.publish("arm/angle", 12.5));
    CHECK(must(subscriber.next(deadline)).topic() == "arm/angle");
}

TEST_CASE("a publisher waits for a subscriber over Bluetooth", "[.routers]") {
    Routers routers;
    // Another topic than in the test before, whose subscription may still be known.
    const auto angles = must(routers.one.publisher("leg/angle"));
    const auto subscriber = must(routers.two.subscribe("wombat-1/leg/*"));
    must(angles.wait_for_subscriber(deadline));
    must(angles.publish(12.5));
    CHECK(must(subscriber.next(deadline)).topic() == "leg/angle");
}

TEST_CASE("a request over Bluetooth is answered", "[.routers]") {
    Routers routers;
    const auto service = must(routers.two.serve("battery", [](const rect::Request& request) { return std::string(request.sender()); }));
    rect::expected<rect::Reply> reply = routers.one.request("wombat-2", "battery", "", deadline);
    until([&] {
        if (!reply) {
            reply = routers.one.request("wombat-2", "battery", "", deadline);
        }
        return reply.has_value();
    });
    CHECK(must(reply->payload.text()) == "wombat-1");
}

TEST_CASE("urgent messages overtake a large transfer over Bluetooth", "[.routers]") {
    Routers routers;
    rect::ReceiveOptions options;
    options.max_bytes = 1 << 20;
    const auto transfers = must(routers.two.receive_transfers("*/map", options));
    const std::string map(100'000, 'm');
    std::thread sending([&] { must(routers.one.transfer("wombat-2", "map", map)); });
    const auto subscriber = must(routers.two.subscribe("wombat-1/stop"));
    const auto urgent = must(routers.one.with_urgency(rect::Urgency::urgent));
    until([&] {
        must(urgent.publish("stop", "now"));
        return subscriber.next(retry_interval).has_value();
    });
    const auto received = must(transfers.next(deadline));
    sending.join();
    CHECK(received.size_bytes() == map.size());
}

TEST_CASE("connections are queried, added and removed", "[.routers]") {
    Routers routers;
    std::vector<rect::Connection> connections;
    until([&] {
        connections = must(routers.one.connections("method=ble;state=connected"));
        return connections.size() == 1 && !connections[0].peer.empty();
    });
    CHECK(connections[0].peer == "wombat-2");
    CHECK(connections[0].state == rect::ConnectionState::connected);
    CHECK(connections[0].sent_bytes.has_value());
    CHECK_FALSE(must(routers.one.query_registry("connections/count")).empty());

    rect::NamedConnection base{"base", "tcp", "127.0.0.1"};
    base.port = 1;
    must(routers.one.add_connection(base));
    until([&] {
        const auto all = must(routers.one.connections());
        return std::any_of(all.begin(), all.end(), [](const auto& connection) { return connection.name == "base"; });
    });
    must(routers.one.remove_connection("base"));
    until([&] {
        const auto all = must(routers.one.connections());
        return std::none_of(all.begin(), all.end(), [](const auto& connection) { return connection.name == "base"; });
    });
    CHECK(routers.one.remove_connection("base").error().code == rect::Code::service);
}

TEST_CASE("events report the link and its method", "[.routers]") {
    Routers routers;
    Flag linked;
    const auto subscription = must(routers.one.on_event([&](const rect::Event& event) {
        if (event.kind() == rect::Event::Kind::link_up && event.method() == "ble" && event.robot() == "wombat-2") {
            linked.set();
        }
    }));
    CHECK(linked.wait());
}
