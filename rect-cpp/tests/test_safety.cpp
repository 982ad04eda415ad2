// Tests the dead man's switch, and the stop of a fleet.
//
//     build/default/tests/rect_tests -# '[#test_safety]'
#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <rect/nlohmann.hpp>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "pair.hpp"

namespace {

// Records the commands of a robot, and the reasons for which it has lost its commander.
class Motors {
public:
    rect::Deadman follow(const rect::Robot& robot, std::chrono::milliseconds within) {
        auto deadman = must(robot.deadman<double>(
            "wombat-1/drive", within, [this](double speed) { add("drive " + nlohmann::json(speed).dump()); },
            [this](std::string_view reason) { add("lost: " + std::string(reason)); }));
        must(robot.wait_until_established(deadline));
        return deadman;
    }

    // Waits for something that the robot does next, and forgets what it did before.
    void wait_for(const std::string& expected) {
        std::unique_lock<std::mutex> lock(mutex_);
        const bool is_done = added_.wait_for(lock, deadline, [&] {
            const auto found = std::find_if(all_.begin(), all_.end(), [&](const auto& entry) {
                return entry.find(expected) != std::string::npos;
            });
            if (found == all_.end()) {
                return false;
            }
            all_.erase(all_.begin(), found + 1);
            return true;
        });
        INFO("no " << expected);
        REQUIRE(is_done);
    }

    std::vector<std::string> all() {
        const std::lock_guard<std::mutex> lock(mutex_);
        return all_;
    }

private:
    void add(std::string entry) {
        const std::lock_guard<std::mutex> lock(mutex_);
        all_.push_back(std::move(entry));
        added_.notify_all();
    }

    std::mutex mutex_;
    std::condition_variable added_;
    std::vector<std::string> all_;
};

void wait_until(const rect::FleetStop& stop, bool is_stopped) {
    until([&] {
        const auto changed = stop.wait_for_change(retry_interval);
        CHECK((changed || changed.error().code == rect::Code::timed_out));
        return must(stop.is_stopped()) == is_stopped;
    });
}

}  // namespace

TEST_CASE("a robot follows while commands arrive") {
    Pair pair;
    Motors motors;
    auto deadman = motors.follow(pair.two, 1s);
    motors.wait_for("lost: no command has arrived yet");
    // Neither a retained message nor one that does not fit is a sign of life.
    must(must(pair.one.retained()).publish("drive", 9));
    must(pair.one.publish("drive", "fast"));
    must(pair.one.publish("drive", 0.5));
    motors.wait_for("drive 0.5");
    CHECK(must(deadman.is_following()));
    motors.wait_for("lost: no command of wombat-1 for 1 s");
    CHECK_FALSE(must(deadman.is_following()));
    CHECK(must(pair.two.counters()).problems == 1);
    must(pair.one.publish("drive", 0.7));
    motors.wait_for("drive 0.7");
    deadman.drop();
    const auto all = motors.all();
    REQUIRE_FALSE(all.empty());
    CHECK(all.back() == "lost: the dead man's switch has ended");
    CHECK(deadman.is_following().error().code == rect::Code::handle);
}

TEST_CASE("a command that hangs does not delay the loss") {
    Pair pair;
    std::atomic<int> lost{0};
    Flag begun;
    Flag returns;
    auto deadman = must(pair.two.deadman<double>(
        "wombat-1/drive", 200ms,
        [&](double) {
            begun.set();
            returns.wait();
        },
        [&](std::string_view) { ++lost; }));
    must(pair.two.wait_until_established(deadline));
    until([&] { return lost == 1; });
    must(pair.one.publish("drive", 0.5));
    CHECK(begun.wait());
    until([&] { return lost == 2; });
    CHECK_FALSE(must(deadman.is_following()));
    // The command may have started the motors before it returns.
    returns.set();
    until([&] { return lost == 3; });
    deadman.drop();
    CHECK(lost == 4);
}

TEST_CASE("a robot that cannot be reached any more has lost command") {
    Pair pair;
    Motors motors;
    const auto deadman = motors.follow(pair.two, 60s);
    must(pair.one.publish("drive", 0.5));
    motors.wait_for("drive 0.5");
    pair.one.drop();
    motors.wait_for("lost: ");
}

TEST_CASE("a stop holds until it is released and the stick is neutral") {
    Pair pair;
    Motors motors;
    const auto deadman = motors.follow(pair.two, 60s);
    const auto stop = must(pair.one.fleet_stop());
    must(pair.one.publish("drive", 0.5));
    motors.wait_for("drive 0.5");
    CHECK(must(stop.confirmation("wombat-7")) == rect::Confirmation::none);
    CHECK(stop.confirmation("a b").error().code == rect::Code::name);
    const auto before = std::chrono::system_clock::now() - 1s;
    must(stop.press("smoke"));
    motors.wait_for("lost: stopped by wombat-1");
    const auto pressed = must(stop.pressed());
    REQUIRE(pressed.size() == 1);
    CHECK(pressed[0].reason == "smoke");
    CHECK_THAT(pressed[0].by, ContainsSubstring("wombat-1"));
    CHECK(pressed[0].in_words == "stopped by " + pressed[0].by + ": smoke");
    CHECK(pressed[0].at > before);
    until([&] {
        (void)stop.wait_for_change(retry_interval);
        return must(stop.confirmation("wombat-2")) == rect::Confirmation::confirmed;
    });
    must(pair.one.publish("drive", 0));
    must(pair.one.publish("drive", 0.6));
    // The robot releases it itself, and the other one learns of that.
    const auto own = must(pair.two.fleet_stop());
    CHECK(must(own.is_stopped()));
    std::this_thread::sleep_for(100ms);
    must(own.release());
    wait_until(stop, false);
    CHECK(must(stop.pressed()).empty());
    for (const double speed : {0.8, 0.0, 0.9}) {
        must(pair.one.publish("drive", speed));
    }
    motors.wait_for("drive 0.0");
    motors.wait_for("drive 0.9");
    CHECK(motors.all().empty());
}

TEST_CASE("a robot that comes later is stopped") {
    const auto endpoint = free_endpoint();
    const auto one = connect_without_router("wombat-1", endpoint, "");
    const auto stop = must(one.fleet_stop());
    must(stop.press());
    const auto two = connect_without_router("wombat-2", "", endpoint);
    Motors motors;
    const auto deadman = motors.follow(two, 60s);
    wait_until(must(two.fleet_stop()), true);
    must(one.wait_for_peer("wombat-2", deadline));
    must(one.publish("drive", 0.5));
    std::this_thread::sleep_for(100ms);
    CHECK(motors.all() == std::vector<std::string>{"lost: no command has arrived yet"});
    must(one.close());
    auto changed = stop.wait_for_change(deadline);
    while (changed) {
        changed = stop.wait_for_change(deadline);
    }
    CHECK(changed.error().code == rect::Code::closed);
}

TEST_CASE("invalid arguments of a switch are refused, and its functions are released") {
    Pair pair;
    const auto count = std::make_shared<int>(0);
    const auto on_command = [count](const rect::MessageView&) {};
    const auto on_lost = [](std::string_view) {};
    CHECK(pair.one.deadman("wombat-1/drive", 1ms, on_command, on_lost).error().code == rect::Code::option);
    CHECK(pair.one.deadman("not a pattern", 1s, on_command, on_lost).error().code == rect::Code::topic);
    CHECK(rect::Robot().deadman("wombat-1/drive", 1s, on_command, on_lost).error().code == rect::Code::handle);
    CHECK(count.use_count() == 2);
    {
        const auto deadman = must(pair.one.deadman("wombat-1/drive", 1s, on_command, on_lost));
        CHECK(count.use_count() == 3);
    }
    CHECK(count.use_count() == 2);
}

TEST_CASE("a function can end its own switch, and the loss follows") {
    static std::atomic<int> reported{0};
    reported = 0;
    rect::on_callback_error([](const char*) noexcept { ++reported; });
    Pair pair;
    rect::Deadman deadman;
    Flag ready;
    Flag ended;
    deadman = must(pair.two.deadman(
        "wombat-1/drive", 60s,
        [&](const rect::MessageView&) {
            ready.wait();
            deadman.drop();
            throw std::runtime_error("test");
        },
        [&](std::string_view reason) {
            if (reason == "the dead man's switch has ended") {
                ended.set();
            }
        }));
    ready.set();
    must(pair.two.wait_until_established(deadline));
    must(pair.one.publish("drive", 0.5));
    REQUIRE(ended.wait());
    // The loss does not wait for the function.
    until([] { return reported == 1; });
    rect::on_callback_error(nullptr);
}
