// Tests retained messages: a late subscriber, changes, the last value, a topic that is forgotten, and values that are not kept.
//
//     build/default/tests/rect_tests -# '[#test_retained]'
#include <optional>
#include <rect/nlohmann.hpp>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "pair.hpp"
#include "routers.hpp"

namespace {

// Returns the last value of a topic of wombat-1, which other robots can ask for a moment after its first retained message.
template <class T>
rect::MessageOf<T> latest_when_available(const rect::Robot& robot, const char* topic) {
    auto message = must(robot.latest<T>("wombat-1", topic, deadline));
    until([&] {
        if (!message) {
            message = must(robot.latest<T>("wombat-1", topic, deadline));
        }
        return message.has_value();
    });
    return std::move(*message);
}

}  // namespace

TEST_CASE("a late subscription receives the last value, and each change once") {
    Pair pair;
    const auto modes = must(pair.one.retained());
    must(modes.publish("mode", "auto"));
    must(modes.publish("mode", "manual"));
    std::this_thread::sleep_for(100ms);
    const auto subscriber = must(pair.two.subscribe("wombat-1/mode"));
    const auto first = must(subscriber.next(deadline));
    CHECK(must(first.payload.text()) == "manual");
    CHECK(first.sender() == "wombat-1");
    CHECK(first.topic() == "mode");
    CHECK(first.sent_at().has_value());
    const auto retained = first.retained();
    REQUIRE(retained.has_value());
    CHECK(retained->age >= 100ms);
    CHECK(retained->age < deadline);
    CHECK_FALSE(retained->has_ended);
    CHECK_FALSE(retained->is_forgotten);
    for (const auto* mode : {"auto", "stop", "auto"}) {
        must(modes.publish("mode", mode));
        const auto message = must(subscriber.next(deadline));
        CHECK(must(message.payload.text()) == mode);
        CHECK(message.retained().has_value());
    }
    CHECK(subscriber.next(0ms).error().code == rect::Code::timed_out);
}

TEST_CASE("a forgotten topic is received as a message without a value") {
    Pair pair;
    must(must(pair.one.retained()).publish("battery", 80));
    const auto subscriber = must(pair.two.subscribe("wombat-1/battery"));
    const auto typed = must(pair.two.subscribe<double>("wombat-1/battery"));
    CHECK(must(must(subscriber.next(deadline)).payload.value<double>()) == 80);
    CHECK(must(must(typed.next(deadline)).value()) == 80);
    must(pair.one.forget("battery"));
    const auto message = must(subscriber.next(deadline));
    REQUIRE(message.retained().has_value());
    CHECK(message.retained()->is_forgotten);
    CHECK(message.payload.bytes().empty());
    CHECK(message.problem() == "the topic was forgotten: there is no value any more");
    const auto without_value = must(typed.next(deadline));
    CHECK(without_value.retained()->is_forgotten);
    CHECK(without_value.value().error().code == rect::Code::payload);
    CHECK(without_value.problem() == "the topic was forgotten: there is no value any more");
    CHECK(must(pair.two.counters()).problems == 0);
    // The copy of this robot's keeper may change a moment after the subscriber has received the message.
    until([&] { return !must(pair.two.latest("wombat-1", "battery", deadline)).has_value(); });
    must(pair.one.forget("battery"));
}

TEST_CASE("the last value is known without a subscription") {
    Pair pair;
    CHECK_FALSE(must(pair.two.latest("wombat-1", "battery", deadline)).has_value());
    const auto batteries = must(must(pair.one.retained()).publisher<double>("battery"));
    must(batteries.publish(80));
    must(batteries.publish(79));
    for (const auto* robot : {&pair.one, &pair.two}) {
        const auto message = latest_when_available<double>(*robot, "battery");
        CHECK(must(message.value()) == 79);
        CHECK(message.retained().has_value());
    }
    CHECK(must(must(pair.two.latest("wombat-1", "battery", deadline))->payload.text()) == "79.0");
    const auto mismatch = must(pair.two.latest<bool>("wombat-1", "battery", deadline));
    REQUIRE(mismatch.has_value());
    CHECK(mismatch->value().error().code == rect::Code::payload);
    CHECK_FALSE(must(pair.two.latest("wombat-7", "battery", deadline)).has_value());
    CHECK(pair.two.latest("a b", "battery").error().code == rect::Code::name);
    CHECK(pair.two.latest("wombat-1", "battery/*").error().code == rect::Code::topic);
}

TEST_CASE("a value over 64 kB is published and not retained") {
    Pair pair;
    const auto maps = must(pair.one.retained());
    const auto subscriber = must(pair.two.subscribe("wombat-1/map"));
    std::vector<std::uint8_t> map(64 * 1024);
    must(maps.publish("map", map));
    CHECK(must(subscriber.next(deadline)).retained().has_value());
    map.push_back(1);
    const auto refused = maps.publish("map", map);
    REQUIRE_FALSE(refused.has_value());
    CHECK(refused.error().code == rect::Code::not_retained);
    CHECK_THAT(refused.error().text, ContainsSubstring("map is not retained: the value has 65537 bytes"));
    const auto message = must(subscriber.next(deadline));
    CHECK(message.payload.bytes().size() == map.size());
    CHECK_FALSE(message.retained().has_value());
}

TEST_CASE("a program without a router keeps a value for the disk in memory") {
    Pair pair;
    must(must(pair.one.retained_on_disk()).publish("calibration", 1.5));
    CHECK(must(latest_when_available<double>(pair.two, "calibration").value()) == 1.5);
}

TEST_CASE("a value is received over Bluetooth after its program has ended", "[.routers]") {
    Routers routers;
    {
        const auto program = connect_to("wombat-1", "RECT_ROUTER_1");
        must(must(program.retained()).publish("cell", "base"));
    }
    const auto subscriber = must(routers.two.subscribe("wombat-1/cell"));
    auto message = must(subscriber.next(deadline));
    CHECK(must(message.payload.text()) == "base");
    until([&] {
        std::this_thread::sleep_for(retry_interval);
        const auto latest = must(routers.two.latest("wombat-1", "cell", deadline));
        return latest && latest->retained()->has_ended;
    });
    must(routers.one.forget("cell"));
    until([&] { return must(subscriber.next(deadline)).retained()->is_forgotten; });
}
