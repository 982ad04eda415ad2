// Tests invalid arguments: NULL, wrong lengths, text that is not UTF-8, numbers out of range. Each error names the argument.
//
//     build/default/tests/rect_tests -# '[#test_bad_input]'
#include <cstring>
#include <limits>
#include <string>

#include "pair.hpp"

namespace {

// A robot without peers, which exists until the end of the test.
struct Alone {
    rect::Robot robot = connect_without_router("wombat-1", free_endpoint(), "");

    rect_robot operator()() const { return robot.raw(); }
};

// Checks that a call failed because of an argument, and returns the text of the error.
std::string argument_error(rect_code code, const rect_error& error) {
    CHECK(code == RECT_CODE_ARGUMENT);
    CHECK(error.code == code);
    return error.text;
}

const rect_payload hello = rect_payload_text("hello");

}  // namespace

TEST_CASE("NULL is rejected with an error that names the argument") {
    const Alone alone;
    rect_error error;
    rect_robot robot;
    CHECK_THAT(argument_error(rect_connect(nullptr, nullptr, &robot, &error), error), ContainsSubstring("name is NULL"));
    CHECK_THAT(argument_error(rect_connect("wombat-1", nullptr, nullptr, &error), error),
               ContainsSubstring("robot is NULL"));
    CHECK_THAT(argument_error(rect_robot_publish(alone(), nullptr, &hello, &error), error),
               ContainsSubstring("topic is NULL"));
    CHECK_THAT(argument_error(rect_robot_publish(alone(), "n", nullptr, &error), error),
               ContainsSubstring("payload is NULL"));
    CHECK_THAT(argument_error(rect_robot_subscribe(alone(), "*/n", nullptr, nullptr, &error), error),
               ContainsSubstring("subscriber is NULL"));
    rect_subscription subscription;
    CHECK_THAT(argument_error(rect_robot_on_message(alone(), "*/n", nullptr, nullptr, nullptr, nullptr, &subscription, &error), error),
               ContainsSubstring("callback is NULL"));
    rect_service service;
    CHECK_THAT(argument_error(rect_robot_serve(alone(), "s", nullptr, nullptr, nullptr, nullptr, &service, &error), error),
               ContainsSubstring("callback is NULL"));
    CHECK_THAT(argument_error(rect_robot_counters(alone(), nullptr, &error), error), ContainsSubstring("counters is NULL"));
    CHECK_THAT(argument_error(rect_robot_add_connection(alone(), nullptr, nullptr, &error), error),
               ContainsSubstring("connection is NULL"));
    CHECK_THAT(argument_error(rect_drop(nullptr, &error), error), ContainsSubstring("id is NULL"));
    // The pointer to the error may be NULL, too.
    CHECK(rect_robot_publish(alone(), nullptr, nullptr, nullptr) == RECT_CODE_ARGUMENT);
}

TEST_CASE("impossible lengths are rejected") {
    const Alone alone;
    rect_error error;
    const rect_payload none{nullptr, 5, {nullptr, 0}};
    CHECK_THAT(argument_error(rect_robot_publish(alone(), "n", &none, &error), error),
               ContainsSubstring("payload.data is NULL, but its length is 5"));
    const rect_payload huge{"x", std::numeric_limits<std::size_t>::max(), {nullptr, 0}};
    CHECK_THAT(argument_error(rect_robot_publish(alone(), "n", &huge, &error), error), ContainsSubstring("is impossible"));
    const rect_payload no_encoding{"x", 1, {nullptr, 3}};
    CHECK_THAT(argument_error(rect_robot_publish(alone(), "n", &no_encoding, &error), error),
               ContainsSubstring("payload.encoding is NULL"));
    const std::string long_encoding(201, 'a');
    CHECK(rect::PayloadView({}, long_encoding).encoding().size() == 201);
    CHECK(must(rect::connect("w", [] { rect::Options o; o.listen = {free_endpoint()}; return o; }()))
              .publish("n", rect::PayloadView({}, long_encoding)).error().code == rect::Code::argument);
    const rect_payload empty{nullptr, 0, {nullptr, 0}};
    CHECK(rect_robot_publish(alone(), "n", &empty, &error) == RECT_CODE_OK);
    CHECK(rect_payload_text(nullptr).len == 0);
}

TEST_CASE("text that is not UTF-8 is rejected with the offset of the invalid byte") {
    const Alone alone;
    rect_error error;
    CHECK_THAT(argument_error(rect_robot_publish(alone(), "a\xff", &hello, &error), error),
               ContainsSubstring("topic is not UTF-8: the byte at offset 1"));
    const auto payload = rect_payload_json("{\"a\": \"\xc3\x28\"}");
    CHECK_THAT(argument_error(rect_robot_publish(alone(), "n", &payload, &error), error),
               ContainsSubstring("payload.data is not UTF-8"));
    rect_options options{};
    options.fleet = "\x80";
    rect_robot robot;
    CHECK_THAT(argument_error(rect_connect("wombat-1", &options, &robot, &error), error),
               ContainsSubstring("options.fleet is not UTF-8"));
    const auto robot_cpp = connect_without_router("wombat-2", free_endpoint(), "");
    CHECK(robot_cpp.publish(std::string("a\0b", 3), "1").error().code == rect::Code::argument);
    CHECK(robot_cpp.publish(std::string_view("a\0b", 3), "1").error().code == rect::Code::argument);
}

TEST_CASE("invalid names, topics, patterns, codecs and dictionaries are rejected") {
    const auto robot = connect_without_router("wombat-1", free_endpoint(), "");
    CHECK(rect::connect("hci0").error().code == rect::Code::name);
    CHECK(robot.publish("a/*", "1").error().code == rect::Code::topic);
    CHECK(robot.send("a b", "n", "1").error().code == rect::Code::name);
    CHECK(robot.subscribe("n").error().code == rect::Code::topic);
    CHECK(robot.subscribe("hci0/n").error().code == rect::Code::name);
    CHECK(robot.with_codec("zstd:99").error().code == rect::Code::codec);
    CHECK(rect::Dictionary::train({"a", "b"}, 4096).error().code == rect::Code::dictionary);
    CHECK(rect::Dictionary::read({}).error().code == rect::Code::dictionary);
}

TEST_CASE("numbers out of range are rejected") {
    const Alone alone;
    rect_error error;
    rect_robot derived;
    CHECK_THAT(argument_error(rect_robot_with_urgency(alone(), 3, &derived, &error), error),
               ContainsSubstring("urgency is 3, but must be 0 to 2"));
    rect_subscribe_options options{};
    options.queue.when_full = 7;
    rect_subscriber subscriber;
    CHECK_THAT(argument_error(rect_robot_subscribe(alone(), "*/n", &options, &subscriber, &error), error),
               ContainsSubstring("when_full is 7"));
    options = {};
    options.max_hz = -1;
    CHECK(rect_robot_subscribe(alone(), "*/n", &options, &subscriber, &error) == RECT_CODE_OPTION);
    rect_buffer buffer;
    CHECK_THAT(argument_error(rect_picture_payload(1, 1, 9, "x", 1, &buffer, &error), error),
               ContainsSubstring("format is 9"));
    CHECK(rect_picture_payload(4, 4, RECT_FORMAT_RGB8, "x", 1, &buffer, &error) == RECT_CODE_CODEC);
}

TEST_CASE("topics with terminal control or bidirectional characters are rejected with the character") {
    const Alone alone;
    for (const auto* topic : {"a\x1b[2Jb", "a\nb", "a\xc2\x9b" "b", "a\xe2\x80\xae" "b"}) {
        const auto error = alone.robot.publish(topic, "x").error();
        CHECK(error.code == rect::Code::topic);
        CHECK_THAT(error.text, ContainsSubstring("the character U+"));
    }
}

TEST_CASE("invalid options for connecting are rejected") {
    rect::Options options;
    options.router = "tcp/127.0.0.1:1";
    options.timeout = 50ms;
    const auto no_router = rect::connect("wombat-1", options);
    REQUIRE_FALSE(no_router.has_value());
    CHECK(no_router.error().code == rect::Code::no_router);
    CHECK_THAT(no_router.error().text, ContainsSubstring("rect-router"));
    options = {};
    options.listen = {"carrier-pigeon/roof"};
    const auto no_protocol = rect::connect("wombat-1", options).error();
    CHECK(no_protocol.code == rect::Code::option);
    REQUIRE(no_protocol.causes.size() > 0);
    CHECK_THAT(no_protocol.causes[0], ContainsSubstring("carrier-pigeon"));
    try {
        must(rect::connect("wombat-1", options));
        FAIL("no exception");
    } catch (const rect::Exception& exception) {
        CHECK(exception.causes() == no_protocol.causes);
    }
    options = {};
    options.zenoh = {{"transport/unicast/max_links", "{"}};
    CHECK(rect::connect("wombat-1", options).error().code == rect::Code::argument);
    options.zenoh = {{"no/such/setting", "1"}};
    CHECK(rect::connect("wombat-1", options).error().code == rect::Code::option);
}

TEST_CASE("adding or querying connections without a router fails") {
    const auto robot = connect_without_router("wombat-1", free_endpoint(), "");
    rect::NamedConnection connection{"base", "tcp", "192.168.125.2"};
    connection.options = "[]";
    CHECK(robot.add_connection(connection).error().code == rect::Code::argument);
    CHECK(robot.connections().error().code == rect::Code::no_service);
}
