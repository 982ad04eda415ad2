// Tests actions: their ends, feedback, cancel, and goals that others have started.
//
//     build/default/tests/rect_tests -# '[#test_actions]'
#include <algorithm>
#include <atomic>
#include <memory>
#include <mutex>
#include <rect/nlohmann.hpp>
#include <string>
#include <thread>
#include <vector>

#include "pair.hpp"

namespace {

// Starts a goal, repeatedly until the robot has discovered the action.
template <class T>
rect::ActionRun start(const rect::Robot& robot, const char* action, const T& goal, const rect::StartOptions& options = {}) {
    rect::expected<rect::ActionRun> run = robot.start("wombat-2", action, goal, options);
    until([&] {
        if (run || run.error().code != rect::Code::no_action) {
            return true;
        }
        run = robot.start("wombat-2", action, goal, options);
        return false;
    });
    return must(std::move(run));
}

// Waits until a goal is in a phase.
void wait_for(const rect::ActionRun& run, rect::Phase phase) {
    until([&] {
        const auto known = must(run.phase());
        if (known == phase) {
            return true;
        }
        INFO("it is " << rect::name(known));
        REQUIRE_FALSE(rect::is_end(known));
        (void)run.wait_for_change(retry_interval);
        return false;
    });
}

// Waits for the end of a goal that is not reached, and returns the reason.
std::string reason_of(const rect::ActionRun& run, rect::Phase phase) {
    const auto result = run.result(deadline);
    REQUIRE_FALSE(result.has_value());
    CHECK(result.error().code == rect::Code::goal);
    const auto status = must(run.status());
    CHECK(rect::name(status.phase) == std::string(rect::name(phase)));
    return status.reason;
}

// Digs until it is cancelled.
rect::expected<rect::Action> dig_forever(const rect::Robot& robot, const rect::ActionOptions& options = {}) {
    return robot.action("dig", [](rect::Goal& goal) { goal.sleep(rect::forever); }, options);
}

}  // namespace

TEST_CASE("a goal is carried out, and its client receives feedback and the result") {
    Pair pair;
    Flag received;
    const auto action = must(pair.two.action("dig", [&](rect::Goal& goal) {
        const auto depth = must(goal.payload.value<int>());
        must(goal.feedback("digging", 0.25));
        received.wait();
        must(goal.progress(0.75));
        return std::vector<std::string>{std::string(goal.by()), std::to_string(depth) + " cm"};
    }));
    const auto run = start(pair.one, "dig", 3);
    std::mutex mutex;
    std::vector<std::string> news;
    const auto feedback = must(run.on_feedback([&](const rect::FeedbackView& feedback) {
        const auto text = feedback.value.text();
        const std::lock_guard<std::mutex> lock(mutex);
        news.push_back((text ? std::string(*text) : "-") + " " + std::to_string(feedback.progress.value_or(-1)));
        received.set();
    }));
    const auto result = must(run.result<std::vector<std::string>>(deadline));
    CHECK_THAT(result[0], ContainsSubstring("wombat-1"));
    CHECK(result[1] == "3 cm");
    CHECK(news.at(0) == "digging 0.250000");
    const auto status = must(run.status());
    CHECK(status.phase == rect::Phase::done);
    CHECK(status.robot == "wombat-2");
    CHECK(status.action == "dig");
    CHECK(status.id.size() == 16);
    CHECK(status.reason.empty());
    CHECK_FALSE(status.unreachable_for);
    CHECK_FALSE(rect::is_end(rect::Phase::cancelling));
    until([&] {
        const auto changed = run.wait_for_change(deadline);
        return !changed && changed.error().code == rect::Code::end;
    });
}

TEST_CASE("feedback is sent as often as the client asks") {
    Pair pair;
    Flag received;
    const auto action = must(pair.two.action("dig", [&](rect::Goal& goal) {
        must(goal.progress(0.1));
        received.wait();
        must(goal.progress(0.2));
        // Long enough for the default rate, and short beside the pause of 10 s that the client asks for.
        goal.sleep(1s);
    }));
    rect::StartOptions rarely;
    rarely.feedback_per_s = 0.1;
    const auto run = start(pair.one, "dig", "", rarely);
    until([&] { return must(run.status()).progress == 0.1; });
    received.set();
    (void)must(run.result(deadline));
    CHECK(must(run.status()).progress == 0.1);
}

TEST_CASE("text, and nothing, are results, too") {
    Pair pair;
    const auto text = must(pair.two.action("text", [](rect::Goal& goal) {
        CHECK(goal.payload.bytes().empty());
        CHECK(must(goal.cancel_reason()).empty());
        return "dug";
    }));
    const auto nothing = must(pair.two.action("nothing", [](rect::Goal&) {}));
    const auto dug = must(start(pair.one, "text", "").result(deadline));
    CHECK(must(dug.view().text()) == "dug");
    const auto none = must(start(pair.one, "nothing", "").result<nlohmann::json>(deadline));
    CHECK(none.is_null());
}

TEST_CASE("a large result arrives, and one that is too large is a failure") {
    Pair pair;
    const auto action = must(pair.two.action("map", [](rect::Goal& goal) {
        return std::string(static_cast<std::size_t>(must(goal.payload.value<int>())), 'x');
    }));
    const auto large = start(pair.one, "map", 10'000'000);
    CHECK(must(large.result<std::string>(deadline)) == std::string(10'000'000, 'x'));
    const auto too_large = start(pair.one, "map", 17'000'000);
    CHECK_THAT(reason_of(too_large, rect::Phase::failed), ContainsSubstring("send it as a transfer"));
}

TEST_CASE("exceptions and errors of the function are failures") {
    Pair pair;
    const auto action = must(pair.two.action("dig", [](rect::Goal& goal) -> rect::expected<int> {
        const auto how = must(goal.payload.text());
        if (how == "throw") {
            throw std::runtime_error("the shovel broke");
        }
        if (how == "other") {
            throw 1;
        }
        return rect::unexpected<rect::Error>(rect::Error{rect::Code::other, "there is rock"});
    }));
    CHECK(reason_of(start(pair.one, "dig", "throw"), rect::Phase::failed) == "the shovel broke");
    CHECK(reason_of(start(pair.one, "dig", "other"), rect::Phase::failed) == "an exception that is not a std::exception");
    const auto run = start(pair.one, "dig", "return");
    CHECK_THAT(run.result(deadline).error().text, ContainsSubstring("failed: there is rock"));
}

TEST_CASE("a goal is cancelled, and the wait for its end has a limit") {
    Pair pair;
    const auto action = must(dig_forever(pair.two));
    const auto run = start(pair.one, "dig", "");
    wait_for(run, rect::Phase::running);
    const auto waited = run.result(retry_interval);
    CHECK(waited.error().code == rect::Code::timed_out);
    CHECK_THAT(waited.error().text, ContainsSubstring("running"));
    must(run.cancel());
    CHECK_THAT(reason_of(run, rect::Phase::cancelled), ContainsSubstring("wombat-1"));
    must(run.cancel());
}

TEST_CASE("a newer goal preempts an older one") {
    Pair pair;
    const auto action = must(pair.two.action("dig", [](rect::Goal& goal) {
        while (must(goal.payload.value<int>()) == 1 && !goal.is_cancelled()) {
            std::this_thread::sleep_for(1ms);
        }
        return "cancelled: " + must(goal.cancel_reason());
    }));
    const auto first = start(pair.one, "dig", 1);
    wait_for(first, rect::Phase::running);
    const auto second = start(pair.one, "dig", 2);
    CHECK_THAT(reason_of(first, rect::Phase::preempted), ContainsSubstring("newer goal"));
    CHECK(must(second.result<std::string>(deadline)) == "cancelled: ");
}

TEST_CASE("a busy action refuses a goal, and a repeated start is the same goal") {
    Pair pair;
    rect::ActionOptions options;
    options.about = "digs a hole";
    options.refuse_when_busy = true;
    options.lost_after = rect::forever;
    const auto action = must(dig_forever(pair.two, options));
    rect::StartOptions named;
    named.id = "hole";
    const auto run = start(pair.one, "dig", "", named);
    const auto again = start(pair.one, "dig", "", named);
    CHECK_THAT(reason_of(start(pair.one, "dig", ""), rect::Phase::refused), ContainsSubstring("busy"));
    CHECK_FALSE(rect::is_end(must(again.phase())));
    must(again.cancel());
    (void)reason_of(run, rect::Phase::cancelled);
    (void)reason_of(again, rect::Phase::cancelled);
}

TEST_CASE("goals of others are listed, found and cancelled") {
    Pair pair;
    const auto action = must(dig_forever(pair.two));
    rect::StartOptions named;
    named.id = "hole";
    const auto before = std::chrono::system_clock::now() - 1s;
    const auto run = start(pair.one, "dig", 3, named);
    wait_for(run, rect::Phase::running);
    CHECK(pair.one.find("wombat-2", "dig", "other").error().code == rect::Code::no_goal);
    const auto found = must(pair.two.find("wombat-2", "dig", "hole"));
    CHECK(must(found.id()) == "hole");
    must(found.cancel());
    CHECK_THAT(reason_of(run, rect::Phase::cancelled), ContainsSubstring("wombat-2"));
    for (const auto* robot : {"*", "wombat-2"}) {
        const auto goals = must(pair.one.goals(robot));
        REQUIRE(goals.size() == 1);
        CHECK(goals[0].robot == "wombat-2");
        CHECK(goals[0].action == "dig");
        CHECK(goals[0].id == "hole");
        CHECK(goals[0].phase == rect::Phase::cancelled);
        CHECK_THAT(goals[0].by, ContainsSubstring("wombat-1"));
        CHECK(goals[0].began > before);
        CHECK(goals[0].ended.has_value());
        CHECK(must(goals[0].goal.view().value<int>()) == 3);
        CHECK_FALSE(goals[0].result.has_value());
        until([&] { return must(pair.one.goals(robot))[0].age > goals[0].age; });
    }
    CHECK(must(pair.one.goals("wombat-1")).empty());
}

TEST_CASE("invalid actions and goals are errors, and functions are released") {
    Pair pair;
    const auto count = std::make_shared<int>(0);
    const auto function = [count](rect::Goal&) {};
    CHECK(pair.two.action("not a name", function).error().code == rect::Code::action);
    CHECK(rect::Robot().action("dig", function).error().code == rect::Code::handle);
    CHECK(count.use_count() == 2);
    auto action = must(pair.two.action("dig", function));
    CHECK(pair.two.action("dig", function).error().code == rect::Code::service_refused);
    const auto unknown = pair.one.start("wombat-2", "fly");
    CHECK(unknown.error().code == rect::Code::no_action);
    CHECK_THAT(unknown.error().text, ContainsSubstring("fly"));
    (void)must(start(pair.one, "dig", "").result(deadline));
    rect::StartOptions wrong;
    wrong.id = "not an id";
    CHECK(pair.one.start("wombat-2", "dig", "", wrong).error().code == rect::Code::action);
    CHECK(pair.one.start("wombat-2", "dig", std::string(50000, 'x')).error().code == rect::Code::action);
    CHECK(pair.one.goals("not a name").error().code == rect::Code::name);
    action.drop();
    CHECK(rect::ActionRun().status().error().code == rect::Code::handle);
    CHECK(rect::ActionRun().result(0ms).error().code == rect::Code::handle);
    until([&] { return count.use_count() == 2; });
}

TEST_CASE("the end of an action cancels its goal, and waits for the function") {
    Pair pair;
    std::atomic<bool> has_ended{false};
    Flag began;
    rect::Action action;
    action = must(pair.two.action("dig", [&](rect::Goal& goal) {
        began.set();
        try {
            goal.sleep(rect::forever);
        } catch (const rect::Cancelled& cancelled) {
            std::this_thread::sleep_for(10ms);
            has_ended = true;
            throw;
        }
    }));
    const auto run = start(pair.one, "dig", "");
    began.wait();
    action.drop();
    CHECK(has_ended);
    (void)reason_of(run, rect::Phase::cancelled);
}

TEST_CASE("a function can end its own action") {
    Pair pair;
    Flag ready;
    rect::Action action;
    action = must(pair.two.action("dig", [&](rect::Goal& goal) {
        ready.wait();
        action.drop();
        goal.sleep(deadline);
    }));
    const auto run = start(pair.one, "dig", "");
    ready.set();
    (void)reason_of(run, rect::Phase::cancelled);
}

TEST_CASE("the stop of the fleet cancels goals, and refuses new ones") {
    Pair pair;
    const auto action = must(dig_forever(pair.two));
    const auto run = start(pair.one, "dig", "");
    wait_for(run, rect::Phase::running);
    const auto stop = must(pair.one.fleet_stop());
    must(stop.press("smoke"));
    CHECK_THAT(reason_of(run, rect::Phase::cancelled), ContainsSubstring("smoke"));
    CHECK_THAT(reason_of(start(pair.one, "dig", ""), rect::Phase::refused), ContainsSubstring("smoke"));
    must(stop.release());
}

TEST_CASE("a wait for an end ends with the handle, and with the session") {
    Pair pair;
    const auto action = must(dig_forever(pair.two));
    auto dropped = start(pair.one, "dig", "");
    const auto kept = must(pair.one.find("wombat-2", "dig", must(dropped.id())));
    std::thread dropping([&] {
        std::this_thread::sleep_for(retry_interval);
        dropped.drop();
    });
    CHECK(dropped.result().error().code == rect::Code::closed);
    dropping.join();
    std::thread closing([&] {
        std::this_thread::sleep_for(retry_interval);
        must(pair.one.close());
    });
    CHECK(kept.result().error().code == rect::Code::closed);
    closing.join();
    // The function ends with its session.
    must(pair.two.close());
}
