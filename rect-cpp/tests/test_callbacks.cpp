// Callbacks: what they throw, how they end, and what is released when.
#include <atomic>
#include <memory>
#include <thread>

#include "pair.hpp"

TEST_CASE("what a callback throws is reported, and it is called for the next message") {
    static std::atomic<int> reported{0};
    reported = 0;
    rect::on_callback_error([](const char*) noexcept { ++reported; });
    Pair pair;
    std::atomic<int> called{0};
    const auto subscription = must(pair.two.subscribe("wombat-1/n", [&](const rect::MessageView&) {
        if (++called % 2 == 0) {
            throw 7;
        }
        throw std::runtime_error("no");
    }));
    until([&] {
        must(pair.one.publish("n", "1"));
        std::this_thread::sleep_for(1ms);
        return reported >= 4;
    });
    rect::on_callback_error(nullptr);
    CHECK(called >= 4);
}

TEST_CASE("a callback may end its own subscription, and is not called again") {
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
        return ended.wait(patience);
    });
    // Later ones are heard by another, and not by it.
    const auto other = must(pair.two.subscribe("wombat-1/n"));
    pair.heard(other, "n", "2");
    CHECK(called == 1);
    CHECK(subscription.id() == 0);
}

TEST_CASE("no callback runs any more once its subscription has ended") {
    Pair pair;
    for (int round = 0; round < 20; ++round) {
        auto is_there = std::make_unique<std::atomic<int>>(0);
        Flag called;
        auto subscription = must(pair.one.subscribe("wombat-1/n", [&, there = is_there.get()](const rect::MessageView&) {
            ++*there;
            called.set();
        }));
        std::thread speaking([&] {
            for (int n = 0; n < 50; ++n) {
                must(pair.one.publish("n", "1"));
            }
        });
        CHECK(called.wait());
        subscription.drop();
        is_there.reset();
        speaking.join();
    }
}

TEST_CASE("what a callback has is released once, in every case") {
    Pair pair;
    const auto count = std::make_shared<int>(0);
    const auto callback = [count](const auto&) {};
    {
        auto subscription = must(pair.one.subscribe("*/n", [count](const rect::MessageView&) {}));
        CHECK(count.use_count() == 3);
        subscription.drop();
        CHECK(count.use_count() == 2);
    }
    CHECK_FALSE(pair.one.subscribe("no pattern", [count](const rect::MessageView&) {}).has_value());
    CHECK_FALSE(pair.one.serve("**", [count](const rect::Request&) { return ""; }).has_value());
    CHECK_FALSE(rect::Robot().on_state([count](const rect::Event&) {}).has_value());
    CHECK(count.use_count() == 2);
    {
        const auto service = must(pair.one.serve("s", [count](const rect::Request&) { return ""; }));
        const auto state = must(pair.one.on_state([count](const rect::Event&) {}));
        CHECK(count.use_count() == 4);
    }
    CHECK(count.use_count() == 2);
}

TEST_CASE("a robot may be dropped before its subscriptions, and in a callback") {
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

TEST_CASE("the last robot may be dropped by a service's function") {
    Pair pair;
    Flag dropped;
    const auto service = must(pair.two.serve("leave", [&](const rect::Request&) {
        pair.two.drop();
        dropped.set();
        return "gone";
    }));
    until([&] {
        const auto reply = pair.one.request("wombat-2", "leave", "", 1s);
        return dropped.wait(patience);
    });
}
