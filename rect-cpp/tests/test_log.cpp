// Tests the log of a program, the reading of logs, and alerts.
//
//     build/default/tests/rect_tests -# '[#test_log]'
#include <rect/nlohmann.hpp>
#include <string>
#include <thread>
#include <vector>

#include "pair.hpp"
#include "routers.hpp"

namespace {

using Lines = std::vector<rect::KeptLine>;

// Returns the lines of a robot in the order in which they were logged.
Lines read(const rect::Robot& robot, const char* name, const rect::LogOptions& options = {}) {
    const auto logs = must(robot.logs(name, options));
    Lines all;
    auto item = must(logs.next(deadline));
    for (; item.kind == rect::LogItem::Kind::lines; item = must(logs.next(deadline))) {
        CHECK(item.robot == name);
        CHECK_FALSE(item.is_new);
        all.insert(all.begin(), item.lines.begin(), item.lines.end());
    }
    CHECK(item.kind == rect::LogItem::Kind::complete);
    CHECK(item.robot.empty());
    CHECK(logs.next(deadline).error().code == rect::Code::end);
    return all;
}

// Reads until there are as many lines as expected, because the router gets them a moment after they were logged.
Lines read_when_logged(std::size_t count, const rect::Robot& robot, const char* name, const rect::LogOptions& options = {}) {
    Lines lines = read(robot, name, options);
    until([&] {
        if (lines.size() < count) {
            std::this_thread::sleep_for(retry_interval);
            lines = read(robot, name, options);
        }
        return lines.size() >= count;
    });
    CHECK(lines.size() == count);
    return lines;
}

std::vector<std::string> texts(const Lines& lines) {
    std::vector<std::string> all;
    for (const auto& line : lines) {
        all.push_back(line.text);
    }
    return all;
}

rect::Robot connect_arm() {
    const char* endpoint = std::getenv("RECT_ROUTER_1");
    rect::Options options;
    options.router = endpoint == nullptr ? "" : endpoint;
    options.program = "arm";
    return must(rect::connect("wombat-1", options));
}

}  // namespace

TEST_CASE("another robot reads a line with everything that belongs to it") {
    Pair pair;
    const auto before = std::chrono::system_clock::now() - 1s;
    pair.one.log(rect::Level::info, "ready");
    const auto line_of_call = __LINE__ - 1;
    rect::LogLine line{rect::Level::error, "the gripper is stuck\nat 12.5 degrees"};
    line.logger = "gripper";
    line.fields = R"({"angle": 12.5, "side": "left"})";
    line.file = "/home/kipr/gripper.py";
    line.line = 7;
    pair.one.log_line(line);
    const auto lines = read_when_logged(2, pair.two, "wombat-1");
    CHECK(lines[0].text == "ready");
    CHECK(lines[0].level == rect::Level::info);
    CHECK(lines[0].source == "test_log.cpp:" + std::to_string(line_of_call));
    CHECK(lines[0].logger.empty());
    CHECK(lines[0].fields.empty());
    CHECK(lines[0].at > before);
    CHECK(lines[0].at < std::chrono::system_clock::now() + 1s);
    CHECK(lines[0].number < lines[1].number);
    CHECK(lines[1].text == line.text);
    CHECK(lines[1].level == rect::Level::error);
    CHECK(lines[1].logger == "gripper");
    CHECK(lines[1].source == "gripper.py:7");
    CHECK(nlohmann::json::parse(lines[1].fields) == nlohmann::json::parse(line.fields));
}

TEST_CASE("lines are selected by level, number and program") {
    Pair pair;
    for (const auto level : {rect::Level::debug, rect::Level::info, rect::Level::warn, rect::Level::error}) {
        pair.one.log(level, "level " + std::to_string(static_cast<int>(level)));
    }
    const auto all = read_when_logged(4, pair.two, "wombat-1");
    CHECK(texts(all) == std::vector<std::string>{"level 0", "level 1", "level 2", "level 3"});
    rect::LogOptions options;
    options.level = rect::Level::warn;
    CHECK(texts(read(pair.two, "wombat-1", options)) == std::vector<std::string>{"level 2", "level 3"});
    options.last = 1;
    CHECK(texts(read(pair.two, "wombat-1", options)) == std::vector<std::string>{"level 3"});
    options.last = 0;
    CHECK(read(pair.two, "wombat-1", options).empty());
    options = {};
    options.program = all[0].program;
    CHECK(read(pair.two, "wombat-1", options).size() == 4);
    options.program = "another";
    CHECK(read(pair.two, "wombat-1", options).empty());
    // No item names a robot that does not answer.
    CHECK(read(pair.two, "wombat-7").empty());
    const auto everybody = must(pair.two.logs("*"));
    std::size_t count = 0;
    while (const auto item = everybody.next(deadline)) {
        count += item->lines.size();
    }
    CHECK(count == 4);
}

TEST_CASE("new lines follow until the reader is dropped") {
    Pair pair;
    rect::LogOptions options;
    options.last = 0;
    options.follow = true;
    auto logs = must(pair.two.logs("wombat-1", options));
    int count = 0;
    until([&] {
        pair.one.log(rect::Level::warn, "line " + std::to_string(++count));
        const auto item = logs.next(retry_interval);
        if (!item) {
            CHECK(item.error().code == rect::Code::timed_out);
            return false;
        }
        CHECK(item->robot == (item->kind == rect::LogItem::Kind::complete ? "" : "wombat-1"));
        return item->is_new && !item->lines.empty();
    });
    rect::Code code{};
    std::thread waiting([&] {
        auto item = logs.next();
        while (item) {
            item = logs.next();
        }
        code = item.error().code;
    });
    logs.drop();
    waiting.join();
    // The object may have been dropped before the thread called `next`.
    CHECK((code == rect::Code::closed || code == rect::Code::handle));
    CHECK(logs.next(0ms).error().code == rect::Code::handle);
    const auto following = must(pair.two.logs("wombat-1", options));
    must(pair.two.close());
    auto last = following.next(deadline);
    while (last) {
        last = following.next(deadline);
    }
    CHECK(last.error().code == rect::Code::end);
}

TEST_CASE("a private line is read on its own robot only") {
    Pair pair;
    rect::LogLine line{rect::Level::info, "the password is secret"};
    line.is_private = true;
    pair.one.log_line(line);
    pair.one.log(rect::Level::info, "public");
    CHECK(texts(read_when_logged(2, pair.one, "wombat-1")) == std::vector<std::string>{line.text, "public"});
    CHECK(texts(read_when_logged(1, pair.two, "wombat-1")) == std::vector<std::string>{"public"});
}

TEST_CASE("a line is not lost because of what it contains") {
    Pair pair;
    CHECK(rect_robot_log(pair.one.raw(), RECT_LEVEL_INFO, "\xff is not UTF-8") == RECT_CODE_OK);
    pair.one.log(rect::Level::info, std::string_view("zero\0byte", 9));
    pair.one.log(rect::Level::info, "\x1b[31mred\x1b[0m\x07");
    pair.one.log(rect::Level::info, std::string(1 << 20, 'x'));
    rect::LogLine line{rect::Level::info, "invalid fields"};
    line.fields = "{\"angle\": nan}";
    pair.one.log_line(line);
    pair.one.log(rect::Level::info, "");
    const auto lines = read_when_logged(6, pair.two, "wombat-1");
    CHECK(lines[0].text == "\xef\xbf\xbd is not UTF-8");
    CHECK(lines[1].text == "zero byte");
    CHECK(lines[2].text == "red\xef\xbf\xbd");
    CHECK(lines[3].text.size() < 10'000);
    CHECK_THAT(lines[3].text, ContainsSubstring(" bytes)"));
    CHECK(nlohmann::json::parse(lines[4].fields) == nlohmann::json{{"fields", line.fields}});
    CHECK(lines[5].text.empty());
}

TEST_CASE("several threads log at a time") {
    Pair pair;
    std::vector<std::thread> threads;
    for (int n = 0; n < 4; ++n) {
        threads.emplace_back([&, n] {
            for (int count = 0; count < 100; ++count) {
                pair.one.log(rect::Level::debug, std::to_string(n));
            }
        });
    }
    for (auto& thread : threads) {
        thread.join();
    }
    rect::LogOptions options;
    options.last = 1000;
    read_when_logged(400, pair.two, "wombat-1", options);
}

TEST_CASE("invalid arguments of logs and alerts are refused") {
    Pair pair;
    const auto robot = pair.one.raw();
    rect_error error;
    CHECK(rect_robot_log(robot, RECT_LEVEL_INFO, nullptr) == RECT_CODE_ARGUMENT);
    CHECK(rect_robot_log(robot, 4, "text") == RECT_CODE_ARGUMENT);
    CHECK(rect_robot_log({0}, RECT_LEVEL_INFO, "text") == RECT_CODE_HANDLE);
    CHECK(rect_robot_log_line(robot, nullptr) == RECT_CODE_ARGUMENT);
    rect_log_line line{};
    CHECK(rect_robot_log_line(robot, &line) == RECT_CODE_ARGUMENT);
    line.text = "only a text";
    CHECK(rect_robot_log_line(robot, &line) == RECT_CODE_OK);
    line.level = 99;
    CHECK(rect_robot_log_line(robot, &line) == RECT_CODE_ARGUMENT);
    CHECK(rect_robot_logs(robot, "wombat-2", nullptr, nullptr, &error) == RECT_CODE_ARGUMENT);
    rect_logs logs;
    CHECK(rect_robot_logs(robot, nullptr, nullptr, &logs, &error) == RECT_CODE_ARGUMENT);
    rect_log_options options{};
    options.level = 4;
    CHECK(rect_robot_logs(robot, "wombat-2", &options, &logs, &error) == RECT_CODE_ARGUMENT);
    CHECK_THAT(error.text, ContainsSubstring("options.level is 4, but must be 0 to 3"));
    options = {};
    options.program = "a b";
    CHECK(rect_robot_logs(robot, "wombat-2", &options, &logs, &error) == RECT_CODE_NAME);
    CHECK(rect_logs_next({0}, 0, nullptr, &error) == RECT_CODE_ARGUMENT);
    CHECK(pair.one.logs("a b").error().code == rect::Code::name);
    CHECK(rect_robot_alert(robot, RECT_LEVEL_WARN, nullptr, &error) == RECT_CODE_ARGUMENT);
    CHECK_THAT(error.text, ContainsSubstring("text is NULL"));
    CHECK(rect_robot_alert_named(robot, nullptr, RECT_LEVEL_WARN, "low", &error) == RECT_CODE_ARGUMENT);
    CHECK_THAT(error.text, ContainsSubstring("name is NULL"));
    CHECK(rect_robot_alert(robot, 4, "low", &error) == RECT_CODE_ARGUMENT);
    CHECK(rect_robot_alert(robot, RECT_LEVEL_WARN, "\xff", &error) == RECT_CODE_ARGUMENT);
    CHECK(rect_robot_clear_alert(robot, nullptr, &error) == RECT_CODE_ARGUMENT);
    CHECK(pair.one.alert(rect::Level::warn, "?!").error().code == rect::Code::topic);
    CHECK(pair.one.clear_alert("?!").error().code == rect::Code::topic);
    CHECK(pair.one.alert(rect::Level::warn, std::string("a\0b", 3)).error().code == rect::Code::argument);
}

TEST_CASE("a program can log after its session was closed or dropped") {
    Pair pair;
    pair.one.log(rect::Level::info, "before");
    must(pair.one.close());
    pair.one.log(rect::Level::info, "after");
    CHECK(rect_robot_log(pair.one.raw(), RECT_LEVEL_INFO, "after") == RECT_CODE_OK);
    CHECK_FALSE(pair.one.logs("wombat-2").has_value());
    CHECK_FALSE(pair.one.alert(rect::Level::warn, "low").has_value());
    pair.one.drop();
    pair.one.log(rect::Level::info, "after");
    CHECK(pair.one.logs("wombat-2").error().code == rect::Code::handle);
    CHECK(pair.one.alert(rect::Level::warn, "low").error().code == rect::Code::handle);
    CHECK(pair.one.clear_alert("low").error().code == rect::Code::handle);
}

TEST_CASE("an alert is a retained message until it is cleared") {
    Pair pair;
    must(pair.one.alert(rect::Level::warn, "battery low"));
    const auto alerts = must(pair.two.subscribe<nlohmann::json>("*/alerts/*"));
    const auto next = [&] { return must(alerts.next(deadline)); };
    const auto first = next();
    CHECK(first.topic() == "alerts/battery-low");
    CHECK(first.retained().has_value());
    CHECK(must(first.value()).at("text") == "battery low");
    CHECK(must(first.value()).at("level") == "warn");
    must(pair.one.alert_named("battery low", rect::Level::error, "battery at 3 %"));
    const auto second = next();
    CHECK(second.topic() == "alerts/battery-low");
    CHECK(must(second.value()).at("text") == "battery at 3 %");
    CHECK(must(second.value()).at("level") == "error");
    must(pair.one.clear_alert("battery low"));
    CHECK(next().retained()->is_forgotten);
    must(pair.one.clear_alert("never raised"));
}

TEST_CASE("the lines and alerts of a program are read over Bluetooth after it has ended", "[.routers]") {
    Routers routers;
    {
        const auto arm = connect_arm();
        for (int n = 1; n <= 50; ++n) {
            arm.log(rect::Level::error, "line " + std::to_string(n));
        }
        must(arm.alert(rect::Level::error, "the arm is stuck"));
        arm.log(rect::Level::error, "the last words");
    }
    rect::LogOptions options;
    options.program = "arm";
    const auto lines = read_when_logged(51, routers.two, "wombat-1", options);
    CHECK(lines[0].program == "arm");
    CHECK(lines[0].text == "line 1");
    CHECK(lines[50].text == "the last words");
    const auto alerts = must(routers.two.subscribe<nlohmann::json>("*/alerts/*"));
    const auto alert = must(alerts.next(deadline));
    CHECK(alert.sender() == "wombat-1");
    CHECK(must(alert.value()).at("program") == "arm");
    must(routers.one.clear_alert("the arm is stuck"));
    until([&] { return must(alerts.next(deadline)).retained()->is_forgotten; });
}

TEST_CASE("new lines are followed over Bluetooth", "[.routers]") {
    Routers routers;
    rect::LogOptions options;
    options.program = "arm";
    options.last = 0;
    options.follow = true;
    const auto logs = must(routers.two.logs("*", options));
    const auto arm = connect_arm();
    until([&] {
        arm.log(rect::Level::info, "ready");
        const auto item = logs.next(retry_interval);
        return item && item->is_new && !item->lines.empty() && item->lines[0].text == "ready";
    });
}
