// Tests publishers, and waiting for robots and subscribers. test_routers.cpp waits until subscriptions are established.
//
//     build/default/tests/rect_tests -# '[#test_waiting]'
#include <future>
#include <thread>

#include "pair.hpp"

TEST_CASE("the first message after waiting for a subscriber is received") {
    Pair pair;
    const auto angles = must(pair.one.publisher("arm/angle"));
    CHECK_FALSE(must(angles.has_subscribers()));
    const auto nobody = angles.wait_for_subscriber(1ms).error();
    CHECK(nobody.code == rect::Code::timed_out);
    CHECK_THAT(nobody.text, ContainsSubstring("subscriber of arm/angle"));
    const auto subscriber = must(pair.two.subscribe("*/arm/*"));
    must(angles.wait_for_subscriber(deadline));
    CHECK(must(angles.has_subscribers()));
    must(angles.publish(12.5));
    const auto message = must(subscriber.next(deadline));
    CHECK(message.topic() == "arm/angle");
    CHECK(must(message.payload.text()) == "12.5");
}

TEST_CASE("a publisher without subscribers any more reports that") {
    Pair pair;
    const auto angles = must(pair.one.publisher("arm/angle"));
    auto subscriber = must(pair.two.subscribe("*/arm/*"));
    must(angles.wait_for_subscriber());
    subscriber.drop();
    until([&] { return !must(angles.has_subscribers()); });
}

TEST_CASE("dropping a publisher, or closing its robot, ends the wait") {
    Pair pair;
    auto angles = must(pair.one.publisher("arm/angle"));
    const auto speeds = must(pair.one.publisher("arm/speed"));
    const auto wait = [](const rect::Publisher& publisher) {
        return std::async(std::launch::async, [&] { return publisher.wait_for_subscriber(deadline); });
    };
    auto waiting = wait(angles);
    auto also_waiting = wait(speeds);
    angles.drop();
    const auto dropped = waiting.get().error().code;
    // The wait may begin after the drop.
    CHECK((dropped == rect::Code::closed || dropped == rect::Code::handle));
    must(pair.one.close());
    CHECK(also_waiting.get().error().code == rect::Code::closed);
    CHECK(must(pair.one.is_closed()));
    CHECK_FALSE(must(pair.two.is_closed()));
}

TEST_CASE("waits for a robot by name") {
    const auto endpoint = free_endpoint();
    const auto one = connect_without_router("wombat-1", endpoint, "");
    CHECK(one.wait_for_peer("wombat-2", 1ms).error().code == rect::Code::timed_out);
    CHECK(one.wait_for_peer("a b", 1ms).error().code == rect::Code::name);
    auto waiting = std::async(std::launch::async, [&] { return one.wait_for_peer("wombat-2"); });
    const auto two = connect_without_router("wombat-2", "", endpoint);
    must(waiting.get());
    must(two.wait_for_peer("wombat-1", deadline));
    CHECK(must(two.peers()).size() == 1);
}
