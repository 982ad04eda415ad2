// Tests handles that are dropped twice, dropped by several threads, used after being dropped, moved, or dropped during a wait.
//
//     build/default/tests/rect_tests -# '[#test_handles]'
#include <thread>
#include <vector>

#include "pair.hpp"

TEST_CASE("calls on a dropped handle fail, and so does dropping a copy of it") {
    rect::Options options;
    options.listen = {free_endpoint()};
    auto robot = must(rect::connect("wombat-1", options));
    rect_robot copy = robot.raw();
    robot.drop();
    robot.drop();
    rect_error error;
    CHECK(rect_drop(&copy.id, &error) == RECT_CODE_HANDLE);
    CHECK_THAT(error.text, ContainsSubstring("already dropped"));
    CHECK(copy.id == 0);
    CHECK(rect_drop(&copy.id, &error) == RECT_CODE_OK);

    CHECK(robot.name().error().code == rect::Code::handle);
    CHECK(robot.publish("n", "1").error().code == rect::Code::handle);
    CHECK(robot.subscribe("*/n").error().code == rect::Code::handle);
    CHECK(robot.peers().error().code == rect::Code::handle);
    CHECK(robot.counters().error().code == rect::Code::handle);
    CHECK(robot.close().error().code == rect::Code::handle);
    CHECK(rect::Subscriber().next(0ms).error().code == rect::Code::handle);
    CHECK(rect::Replies().next().error().code == rect::Code::handle);
    CHECK(rect::StreamSender().send("x").error().code == rect::Code::handle);
    CHECK(rect::Publisher().publish("x").error().code == rect::Code::handle);
    CHECK(rect::Publisher().wait_for_subscriber(0ms).error().code == rect::Code::handle);
    CHECK(robot.wait_for_peer("wombat-2", 0ms).error().code == rect::Code::handle);
    CHECK(robot.wait_until_established(0ms).error().code == rect::Code::handle);
    CHECK(rect::Watcher().next(0ms).error().code == rect::Code::handle);
    CHECK(rect::Transfer().wait(0ms).error().code == rect::Code::handle);
    CHECK(rect::Transfers().next(0ms).error().code == rect::Code::handle);
}

TEST_CASE("a handle of another kind is rejected") {
    Pair pair;
    const auto subscriber = must(pair.one.subscribe("*/n"));
    const rect_robot not_a_robot{subscriber.handle_id()};
    rect_names names;
    rect_error error;
    CHECK(rect_robot_peers(not_a_robot, &names, &error) == RECT_CODE_HANDLE);
    CHECK_THAT(error.text, ContainsSubstring("robot"));
    CHECK(must(subscriber.dropped()) == 0);
}

TEST_CASE("several threads can use and drop the same variable") {
    Pair pair;
    for (int round = 0; round < 20; ++round) {
        auto shared = must(pair.one.with_urgency(rect::Urgency::bulk));
        auto subscription = must(pair.one.subscribe("*/n", [](const rect::MessageView&) {}));
        std::vector<std::thread> threads;
        for (int n = 0; n < 4; ++n) {
            threads.emplace_back([&] {
                const auto published = shared.publish("n", "1");
                if (!published && published.error().code != rect::Code::handle) {
                    std::abort();
                }
                shared.drop();
                subscription.drop();
            });
        }
        for (auto& thread : threads) {
            thread.join();
        }
        CHECK(shared.handle_id() == 0);
        CHECK(subscription.handle_id() == 0);
    }
    must(pair.one.publish("n", "the session is still open"));
}

TEST_CASE("moving transfers ownership of the handle") {
    Pair pair;
    auto first = must(pair.one.subscribe("*/n"));
    const auto id = first.handle_id();
    auto second = std::move(first);
    CHECK(first.handle_id() == 0);  // NOLINT: the state after the move is what is tested
    CHECK(second.handle_id() == id);
    second = must(pair.one.subscribe("*/m"));
    rect_subscriber old{id};
    CHECK(rect_drop(&old.id, nullptr) == RECT_CODE_HANDLE);
    auto& self = second;
    second = std::move(self);
    CHECK(must(second.dropped()) == 0);
}

TEST_CASE("a waiting call returns when another thread drops the object or closes the session") {
    Pair pair;
    auto subscriber = must(pair.one.subscribe("*/never"));
    auto watch = must(pair.one.watch("wombat-2/never"));
    const auto other = must(pair.one.subscribe("*/never"));
    rect::Code codes[3] = {};
    std::thread first([&] { codes[0] = subscriber.next().error().code; });
    std::thread second([&] { codes[1] = watch.next().error().code; });
    std::thread third([&] { codes[2] = other.next().error().code; });
    subscriber.drop();
    watch.drop();
    first.join();
    second.join();
    must(pair.one.close());
    third.join();
    // The object may have been dropped before the thread called `next`.
    for (const auto code : {codes[0], codes[1]}) {
        CHECK((code == rect::Code::closed || code == rect::Code::handle));
    }
    CHECK(codes[2] == rect::Code::closed);
}

TEST_CASE("calls on a closed session fail") {
    Pair pair;
    must(pair.one.close());
    CHECK_FALSE(pair.one.publish("n", "1").has_value());
    CHECK_FALSE(pair.one.subscribe("*/n").has_value());
    must(pair.one.close());
}
