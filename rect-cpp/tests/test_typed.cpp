// Tests values that arrive as the type that a program states.
//
//     build/default/tests/rect_tests -# '[#test_typed]'
#include <nlohmann/json.hpp>
#include <map>
#include <optional>
#include <rect/nlohmann.hpp>
#include <string>
#include <thread>
#include <vector>

#include "pair.hpp"

namespace {

struct Cell {
    double volt;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Cell, volt)

struct Battery {
    double percent = 0;
    std::vector<Cell> cells;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE_WITH_DEFAULT(Battery, percent, cells)

struct Pose {
    int x;
    int y;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Pose, x, y)

struct Person {
    std::string name;
    int age;
    Pose home;
    std::vector<std::string> tags;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Person, name, age, home, tags)

std::string repeated(const std::string& text, int times) {
    std::string all;
    for (int n = 0; n < times; ++n) {
        all += text;
    }
    return all;
}

template <class T>
std::string problem(const std::string& json) {
    const auto value = rect::Payload::json(json).view().value<T>();
    return value ? "none" : value.error().text;
}

}  // namespace

TEST_CASE("the part of a value that does not fit is named") {
    CHECK(problem<Battery>(R"({"percent": 80, "cells": [{"volt": 3.6}], "new": 1})") == "none");
    CHECK(problem<Battery>("{}") == "none");
    CHECK(problem<Pose>(R"({"x": 1})") == "field y: expected a value, found no such field");
    CHECK(problem<std::vector<Pose>>(R"([{"x": 1, "y": 2}, {"y": null}])") == "field x: expected a value, found no such field");
    CHECK(problem<Battery>(R"({"percent": "full"})") == "field percent: expected a number, found the text 'full'");
    CHECK(problem<Battery>(R"({"cells": [{"volt": 1}, {"volt": [1, 2]}]})") ==
          "field cells[1].volt: expected a number, found a list of 2");
    CHECK(problem<std::vector<int>>(R"({"b": 1, "a": 2})") == "expected a list, found an object with the fields a, b");
    // Others are read before and after the one that does not fit, some with the same type.
    CHECK(problem<Person>(R"({"name": "arm", "age": "old", "home": {"x": 1, "y": 2}, "tags": ["a", "b"]})") ==
          "field age: expected a number, found the text 'old'");
    CHECK(problem<Person>(R"({"name": "arm", "age": 1, "home": {"x": 1, "y": 2}, "tags": ["a", 3]})") ==
          "field tags[1]: expected text, found the number 3");
    CHECK(problem<Person>(R"({"name": "arm", "age": 1, "home": {"x": "a", "y": "b"}, "tags": ["a", "b"]})") ==
          "field home.x: expected a number, found the text 'a'");
    CHECK(problem<Person>(R"({"name": "arm", "age": {"x": 1, "y": 2}, "home": {"x": 1, "y": 2}, "tags": []})") ==
          "field age: expected a number, found an object with the fields x, y");
    CHECK(problem<std::vector<int>>('[' + repeated("1,", 1000) + "\"x\"]") == "expected a number, found a list of 1001");
    CHECK(problem<bool>("null") == "expected true or false, found nothing (null)");
    CHECK(problem<bool>('"' + std::string(100'000, 'x') + '"').size() < 120);
    // A character that is cut, and bytes that are not text.
    std::string umlauts;
    for (int n = 0; n < 50; ++n) {
        umlauts += "\xc3\xa4";
    }
    CHECK_THAT(problem<bool>('"' + umlauts + '"'), ContainsSubstring("\xef\xbf\xbd..."));
    const auto cbor = rect::Payload("\x61\xff", "application/cbor").view().value<bool>();
    CHECK(cbor.error().text == "expected true or false, found the text '\xef\xbf\xbd'");
    // The keys of an object may look like the parts of an error.
    CHECK_THAT((problem<std::map<std::string, int>>(R"({"key 'a' not found": "b"})")), ContainsSubstring("found the text 'b'"));
}

TEST_CASE("values arrive as their type, and others with a problem") {
    Pair pair;
    const auto batteries = must(pair.two.subscribe<Battery>("wombat-1/battery"));
    const auto publisher = must(pair.one.publisher<Battery>("battery"));
    must(publisher.wait_for_subscriber(deadline));
    must(publisher.publish({80, {{3.6}}}));
    must(pair.one.publish("battery", nlohmann::json{{"percent", "full"}}));
    must(pair.one.publish("battery", "text"));
    must(pair.one.publish("battery", std::vector<std::uint8_t>{1, 2}));
    CHECK(must(must(batteries.next(deadline)).value()).cells.at(0).volt == 3.6);
    const auto message = must(batteries.next(deadline));
    CHECK(message.sender() == "wombat-1");
    CHECK(message.value().error().code == rect::Code::payload);
    CHECK(message.problem() == "field percent: expected a number, found the text 'full'");
    CHECK(must(batteries.next(deadline)).problem() == "expected an object, found the text 'text'");
    CHECK_THAT(std::string(must(batteries.next(deadline)).problem()), ContainsSubstring("JSON, CBOR or text in UTF-8 is required"));
    CHECK(must(pair.two.counters()).problems == 3);
}

TEST_CASE("callbacks, waits, requests and replies have types too") {
    Pair pair;
    Flag arrived;
    std::optional<rect::expected<Battery>> battery;
    const auto subscription =
        must(pair.two.subscribe<Battery>("wombat-1/battery", [&](const rect::MessageOf<Battery>& message) {
            if (!battery) {
                battery = message.value();
                arrived.set();
            }
        }));
    must(pair.one.wait_until_established(deadline));
    until([&] {
        must(pair.one.publish("battery", Battery{80, {}}));
        return arrived.wait(retry_interval);
    });
    CHECK(must(*battery).percent == 80);

    const auto service = must(pair.two.serve("pose", [](const rect::Request& request) -> rect::expected<nlohmann::json> {
        return must(request.payload.value<std::string>()) == "good" ? nlohmann::json{{"x", 1}, {"y", 2}} : nlohmann::json{{"x", 1}};
    }));
    auto reply = pair.one.request<Pose>("wombat-2", "pose", "good", deadline);
    until([&] {
        if (!reply) {
            reply = pair.one.request<Pose>("wombat-2", "pose", "good", deadline);
        }
        return reply.has_value();
    });
    CHECK(reply->value.y == 2);
    const auto bad = pair.one.request<Pose>("wombat-2", "pose", "bad", deadline);
    CHECK(bad.error().code == rect::Code::payload);
    CHECK(bad.error().text == "field y: expected a value, found no such field");
    const auto replies = must(pair.one.request_all<Pose>("pose", "good", deadline));
    CHECK(must(replies.next()).value.x == 1);
    CHECK(replies.next().error().code == rect::Code::end);

    const auto waited = [&] { return pair.two.wait_for_message<std::string>("wombat-1/text", retry_interval); };
    std::atomic<bool> done = false;
    std::thread publishing([&] {
        while (!done) {
            must(pair.one.publish("text", "hello"));
        }
    });
    auto text = waited();
    until([&] {
        if (!text) {
            text = waited();
        }
        return text.has_value();
    });
    done = true;
    publishing.join();
    CHECK(must(text->value()) == "hello");
}
