// Runs the behaviour scenarios of tests/conformance/behaviour/two_robots.json, which Rust and Python run, too. Those with routers
// need run_with_routers.py.
//
//     build/default/tests/rect_tests -# '[#test_behaviour]'
//     python tests/run_with_routers.py build/default/tests/rect_tests '[.routers]'
#include <algorithm>
#include <chrono>
#include <fstream>
#include <functional>
#include <thread>
#include <utility>

#include "program.hpp"
#include "routers.hpp"

namespace {

using Json = nlohmann::json;

Json document() {
    std::ifstream stream(std::string(RECT_VECTORS) + "/behaviour/two_robots.json");
    return Json::parse(stream);
}

bool contains(const Json& names, const std::string& name) {
    return std::find(names.begin(), names.end(), name) != names.end();
}

// Checks that a call failed as the scenario expects.
void check_error(const rect::Error& error, const Json& expected) {
    INFO(error.text);
    REQUIRE(expected.is_object());
    REQUIRE(kind(error.code) == expected.value("error", "none"));
    for (const auto& part : expected.value("text", Json::array())) {
        CHECK_THAT(error.text, ContainsSubstring(part.get<std::string>()));
    }
    if (expected.contains("payload")) {
        // C and C++ programs receive the error of a service as text, after the name of the robot.
        CHECK_THAT(error.text, Catch::Matchers::EndsWith(" replied with an error: " + expected["payload"].get<std::string>()));
    }
}

// Returns whether an error is the one that the scenario expects.
bool is_expected(const rect::expected<Json>& outcome, const Json& expected) {
    const auto parts = expected.value("text", Json::array());
    return !outcome && kind(outcome.error().code) == expected["error"] && std::all_of(parts.begin(), parts.end(), [&](const Json& part) {
        return outcome.error().text.find(part.get<std::string>()) != std::string::npos;
    });
}

// Performs a call. One that fails because a robot or service is missing is repeated until it fails as expected: if the router answers
// too late, on a busy computer, the error names no reachable robots, and a message is sent in any case.
rect::expected<Json> call(Program& program, const Json& step) {
    auto outcome = program.call(step["do"]);
    const auto& expected = step["expect"];
    const auto error = expected.is_object() ? expected.value("error", std::string()) : std::string();
    const auto end = std::chrono::steady_clock::now() + deadline;
    while ((error == "not_reachable" || error == "no_service") && !is_expected(outcome, expected) &&
           std::chrono::steady_clock::now() < end) {
        std::this_thread::sleep_for(retry_interval);
        outcome = program.call(step["do"]);
    }
    return outcome;
}

void run(const Json& scenario, const Json& dictionaries, rect::Robot one, rect::Robot two) {
    Program first(std::move(one), dictionaries);
    Program second(std::move(two), dictionaries);
    for (const auto& step : scenario["steps"]) {
        INFO(scenario["about"] << ": " << step["robot"] << " " << step["do"]);
        auto& program = step["robot"] == "one" ? first : second;
        const auto outcome = call(program, step);
        if (outcome) {
            REQUIRE(*outcome == step["expect"]);
        } else {
            check_error(outcome.error(), step["expect"]);
        }
    }
}

// Runs the scenarios of a network, each with two robots that `connect` returns.
void run_all(const std::string& network, const std::function<std::pair<rect::Robot, rect::Robot>()>& connect) {
    const auto all = document();
    for (const auto& scenario : all["scenarios"]) {
        if (contains(scenario["networks"], network) && contains(scenario.value("languages", Json{"cpp"}), "cpp")) {
            auto robots = connect();
            run(scenario, all["dictionaries"], std::move(robots.first), std::move(robots.second));
        }
    }
}

}  // namespace

TEST_CASE("linked programs behave as the scenarios state") {
    run_all("link", [] {
        const auto endpoint = free_endpoint();
        auto one = connect_without_router("wombat-1", endpoint, "");
        return std::make_pair(std::move(one), connect_without_router("wombat-2", "", endpoint));
    });
}

TEST_CASE("programs at routers behave as the scenarios state", "[.routers]") {
    run_all("routers", [] {
        Routers routers;
        return std::make_pair(std::move(routers.one), std::move(routers.two));
    });
}
