// Tests callbacks: exceptions, ending subscriptions, and releasing captured objects.
//
//     build/default/tests/rect_tests -# '[#test_callbacks]'
#include <atomic>
#include <memory>
#include <thread>

#include "pair.hpp"

TEST_CASE("exceptions of a callback are reported and do not stop further calls") {
    static std::atomic<int> reported{0};
    reported = 0;
    rect::on_callback_error([](const char*) noexcept { ++reported; });
    Pair pair;
    std::atomic<int> called{0};
    const auto subscription = must(pair.two.subscribe("wombat-1/n", [&](const rect::MessageView&) {
        if (++called % 2 == 0) {
            throw 7;
        }
        throw std::runtime_error("test");
    }));
    until([&] {
        must(pair.one.publish("n", "1"));
        std::this_thread::sleep_for(1ms);
        return reported >= 4;
    });
    rect::on_callback_error(nullptr);
    CHECK(called >= 4);
}

TEST_CASE("a callback can end its own subscription and is not called again") {
    Pair pair;
    std::atomic<int> called{0};
    rect::Subscription subscription;
    Flag ready;
    Flag ended;
    subscription = must(pair.two.subscribe("wombat-1/n", [&](const rect::MessageView&) {
        ready.wait();
        ++called;
        subscription.drop();
        ended.set();
    }));
    ready.set();
    until([&] {
        must(pair.one.publish("n", "1"));
        return ended.wait(retry_interval);
    });
    // Later messages are received by another subscriber, but not by the callback.
    const auto other = must(pair.two.subscribe("wombat-1/n"));
    pair.publish_until_received(other, "n", "2");
    CHECK(called == 1);
    CHECK(subscription.handle_id() == 0);
}

TEST_CASE("no callback runs after its subscription has ended") {
    Pair pair;
    for (int round = 0; round < 20; ++round) {
        auto counter = std::make_unique<std::atomic<int>>(0);
        Flag called;
        auto subscription = must(pair.one.subscribe("wombat-1/n", [&, count = counter.get()](const rect::MessageView&) {
            ++*count;
            called.set();
        }));
        std::thread publisher([&] {
            for (int n = 0; n < 50; ++n) {
                must(pair.one.publish("n", "1"));
            }
        });
        CHECK(called.wait());
        subscription.drop();
        counter.reset();
        publisher.join();
    }
}

TEST_CASE("objects captured by a callback are released exactly once") {
    Pair pair;
    const auto count = std::make_shared<int>(0);
    const auto callback = [count](const auto&) {};
    {
        auto subscription = must(pair.one.subscribe("*/n", [count](const rect::MessageView&) {}));
        CHECK(count.use_count() == 3);
        subscription.drop();
        CHECK(count.use_count() == 2);
    }
    CHECK_FALSE(pair.one.subscribe("not a pattern", [count](const rect::MessageView&) {}).has_value());
    CHECK_FALSE(pair.one.serve("**", [count](const rect::Request&) { return ""; }).has_value());
    CHECK_FALSE(rect::Robot().on_event([count](const rect::Event&) {}).has_value());
    CHECK(count.use_count() == 2);
    {
        const auto service = must(pair.one.serve("s", [count](const rect::Request&) { return ""; }));
        const auto subscription = must(pair.one.on_event([count](const rect::Event&) {}));
        CHECK(count.use_count() == 4);
    }
    CHECK(count.use_count() == 2);
}

TEST_CASE("a robot can be dropped before its subscriptions and in a callback") {
    auto pair = std::make_unique<Pair>();
    Flag dropped;
    auto subscription = must(pair->one.subscribe("*/n", [&](const rect::MessageView&) {
        pair->two.drop();
        pair->one.drop();
        dropped.set();
    }));
    must(pair->one.publish("n", "1"));
    REQUIRE(dropped.wait());
    CHECK(pair->one.publish("n", "1").error().code == rect::Code::handle);
    pair.reset();
}

TEST_CASE("a service's function can drop the last robot handle") {
    Pair pair;
    Flag dropped;
    const auto service = must(pair.two.serve("leave", [&](const rect::Request&) {
        pair.two.drop();
        dropped.set();
        return "gone";
    }));
    until([&] {
        const auto reply = pair.one.request("wombat-2", "leave", "", 1s);
        return dropped.wait(retry_interval);
    });
}
