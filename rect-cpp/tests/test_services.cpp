// Tests services: requests, replies, refusals, and exceptions of service functions.
//
//     build/default/tests/rect_tests -# '[#test_services]'
#include <atomic>
#include <thread>

#include "pair.hpp"

namespace {

// Sends a request, repeatedly until the robot has discovered the service, and returns the reply.
rect::expected<rect::Reply> request_when_available(const rect::Robot& robot, const char* topic, const char* value) {
    rect::expected<rect::Reply> reply = robot.request("wombat-2", topic, value, deadline);
    until([&] {
        if (reply || reply.error().code != rect::Code::no_service) {
            return true;
        }
        reply = robot.request("wombat-2", topic, value, deadline);
        return false;
    });
    return reply;
}

}  // namespace

TEST_CASE("a service replies to requests of one robot and of all") {
    Pair pair;
    const auto service = must(pair.two.serve("double", [](const rect::Request& request) {
        const auto doubled = std::to_string(2 * std::stoi(std::string(request.payload.text().value())));
        return doubled + (request.remaining() > 0ms ? " for " : " too late for ") + std::string(request.sender());
    }));
    const auto reply = must(request_when_available(pair.one, "double", "21"));
    CHECK(reply.sender() == "wombat-2");
    CHECK(must(reply.payload.text()) == "42 for wombat-1");

    const auto replies = must(pair.one.request_all("double", "4", deadline));
    CHECK(must(must(replies.next()).payload.text()) == "8 for wombat-1");
    CHECK(replies.next().error().code == rect::Code::end);
}

TEST_CASE("each robot that serves a topic has an outcome") {
    Pair pair;
    // A program that begins meanwhile may have carried the request out.
    until([&] { return pair.one.gather("cell", "", 2s).error().code == rect::Code::no_service; });
    CHECK_THAT(pair.one.gather("cell", "", 2s).error().text, ContainsSubstring("no program of the fleet serves cell"));
    rect::ServiceOptions options;
    options.about = "the voltage of a cell";
    const auto service = must(pair.two.serve("cell", [](const rect::Request& request) -> std::string {
        if (request.payload.text().value() == "stuck") {
            throw rect::Refusal("the arm is stuck");
        }
        return "7.2 V";
    }, options));
    must(request_when_available(pair.one, "cell", ""));
    // A program announces at most once a second that its services have changed.
    until([&] { return must(pair.one.services("wombat-2")).size() == 1; });
    const auto services = must(pair.one.services("wombat-2"));
    CHECK(services[0].topic == "cell");
    CHECK(services[0].about == "the voltage of a cell");
    CHECK_FALSE(services[0].several);
    const auto replied = must(pair.one.gather("cell", "", deadline));
    REQUIRE(replied.outcomes().size() == 1);
    CHECK(replied.outcomes()[0].robot == "wombat-2");
    CHECK(must(must(replied.outcomes()[0].reply).text()) == "7.2 V");
    const auto refused = must(pair.one.gather("cell", "stuck", deadline));
    REQUIRE(refused.outcomes().size() == 1);
    CHECK(refused.outcomes()[0].reply.error().code == rect::Code::service);
    CHECK_FALSE(refused.outcomes()[0].is_missing);
}

TEST_CASE("a stream of replies ends after the last one") {
    Pair pair;
    const auto service = must(pair.two.serve("scan", [](const rect::Request& request) {
        request.reply("1").value();
        request.reply("2").value();
        return "3";
    }));
    CHECK(must(must(request_when_available(pair.one, "scan", "")).payload.text()) == "1");
    const auto replies = must(pair.one.request_stream("wombat-2", "scan", "", deadline));
    for (const auto* expected : {"1", "2", "3"}) {
        CHECK(must(must(replies.next()).payload.text()) == expected);
    }
    CHECK(replies.next().error().code == rect::Code::end);
}

TEST_CASE("a service learns that nobody waits") {
    Pair pair;
    std::atomic<bool> is_waited_for{false}, has_learnt{false};
    const auto service = must(pair.two.serve("long", [&](const rect::Request& request) {
        if (request.payload.text().value() == "wait") {
            is_waited_for = request.is_wanted();
            while (request.is_wanted()) {
                std::this_thread::sleep_for(1ms);
            }
            has_learnt = request.remaining() > 0ms;
        }
        return "done";
    }));
    must(request_when_available(pair.one, "long", ""));
    {
        const auto replies = must(pair.one.request_stream("wombat-2", "long", "wait", deadline));
        until([&] { return is_waited_for.load(); });
    }
    until([&] { return has_learnt.load(); });
}

TEST_CASE("a refusal, thrown or returned, is reported to the sender of the request") {
    Pair pair;
    const auto thrower = must(pair.two.serve("thrower", [](const rect::Request&) -> std::string {
        throw rect::Refusal("there are the cells 1 and 2");
    }));
    const auto returner = must(pair.two.serve("returner", [](const rect::Request&) {
        return rect::expected<std::string, rect::Refusal>(rect::unexpected<rect::Refusal>(rect::Refusal("not now")));
    }));
    const auto thrown = request_when_available(pair.one, "thrower", "");
    REQUIRE_FALSE(thrown.has_value());
    CHECK(thrown.error().code == rect::Code::service);
    CHECK_THAT(thrown.error().text, ContainsSubstring("wombat-2") &&
                                        ContainsSubstring("there are the cells 1 and 2"));
    const auto returned = request_when_available(pair.one, "returner", "");
    REQUIRE_FALSE(returned.has_value());
    CHECK_THAT(returned.error().text, ContainsSubstring("not now"));
}

TEST_CASE("an exception in a service is reported locally and answered with an internal error") {
    static std::atomic<int> reported{0};
    rect::on_callback_error([](const char* what) noexcept { reported += std::string_view(what) == "oops"; });
    Pair pair;
    const auto service = must(pair.two.serve("oops", [](const rect::Request&) -> std::string {
        throw std::runtime_error("oops");
    }));
    const auto reply = request_when_available(pair.one, "oops", "");
    rect::on_callback_error(nullptr);
    REQUIRE_FALSE(reply.has_value());
    CHECK(reply.error().code == rect::Code::service);
    CHECK(reported == 1);
}

TEST_CASE("a request to an unknown robot fails with an error that lists the reachable robots") {
    Pair pair;
    const auto reply = pair.one.request("wombat-7", "double", "21", 2s);
    REQUIRE_FALSE(reply.has_value());
    CHECK(reply.error().code == rect::Code::no_service);
    CHECK_THAT(reply.error().text, ContainsSubstring("wombat-2"));
}

TEST_CASE("a request whose program ends may have been carried out") {
    Pair pair;
    Flag began;
    Flag go;
    const auto service = must(pair.two.serve("slow", [&](const rect::Request& request) {
        if (request.payload.text().value() == "wait") {
            began.set();
            go.wait();
        }
        return "done";
    }));
    must(request_when_available(pair.one, "slow", "ready?"));
    rect::expected<rect::Reply> reply = rect::unexpected<rect::Error>(rect::Error{rect::Code::other, ""});
    std::thread asking([&] { reply = pair.one.request("wombat-2", "slow", "wait", deadline); });
    REQUIRE(began.wait());
    must(pair.two.close());
    asking.join();
    go.set();
    REQUIRE_FALSE(reply.has_value());
    CHECK(reply.error().code == rect::Code::interrupted);
}

TEST_CASE("a request that is repeated is carried out once, and not by a program that was restarted") {
    const std::string endpoint = free_endpoint();
    const rect::Robot one = connect_without_router("wombat-1", endpoint, "");
    const auto retrying = must(one.retrying());
    std::atomic<int> count{0};
    Flag began;
    Flag go;
    const auto grab = [&](const rect::Request& request) {
        ++count;
        if (request.payload.text().value() == "wait") {
            began.set();
            go.wait();
        }
        return "done";
    };
    rect::expected<rect::Reply> reply = rect::unexpected<rect::Error>(rect::Error{rect::Code::other, ""});
    std::thread asking;
    {
        const rect::Robot two = connect_without_router("wombat-2", "", endpoint);
        const auto service = must(two.serve("grab", grab));
        must(request_when_available(retrying, "grab", "ready?"));
        asking = std::thread([&] { reply = retrying.request("wombat-2", "grab", "wait", deadline); });
        REQUIRE(began.wait());
        must(two.close());
        go.set();
    }
    const int carried_out = count;
    const rect::Robot two = connect_without_router("wombat-2", "", endpoint);
    const auto service = must(two.serve("grab", grab));
    asking.join();
    REQUIRE_FALSE(reply.has_value());
    CHECK(reply.error().code == rect::Code::interrupted);
    CHECK(count == carried_out);
    CHECK(must(must(request_when_available(retrying, "grab", "again")).payload.text()) == "done");
    CHECK(retrying.request("wombat-2", "grab", "", 601s).error().code == rect::Code::option);
}

TEST_CASE("a slow service times out, and dropping it waits for the call in progress") {
    Pair pair;
    Flag began;
    Flag go;
    std::atomic<bool> is_finished{false};
    auto service = must(pair.two.serve("slow", [&](const rect::Request& request) {
        if (request.payload.text().value() == "wait") {
            began.set();
            go.wait();
            is_finished = true;
        }
        return "done";
    }));
    must(request_when_available(pair.one, "slow", "ready?"));
    CHECK(pair.one.request("wombat-2", "slow", "wait", 50ms).error().code == rect::Code::timed_out);
    REQUIRE(began.wait());
    std::thread going([&] { go.set(); });
    service.drop();
    CHECK(is_finished);
    going.join();
}

TEST_CASE("a service can send requests and end itself") {
    Pair pair;
    const auto inner = must(pair.one.serve("inner", [](const rect::Request&) { return "deep"; }));
    rect::Service outer;
    Flag ended;
    outer = must(pair.two.serve("outer", [&](const rect::Request&) {
        const auto reply = pair.two.request("wombat-1", "inner", "", deadline);
        if (reply) {
            outer.drop();
            ended.set();
        }
        return reply ? std::string(reply->payload.text().value()) : reply.error().text;
    }));
    // The reply of a service that has ended is not sent.
    until([&] {
        const auto reply = pair.one.request("wombat-2", "outer", "", deadline);
        return !reply && ended.wait(retry_interval);
    });
    CHECK(outer.handle_id() == 0);
}

TEST_CASE("a second service of a topic is refused, unless both allow it") {
    Pair pair;
    const auto answer = [](const rect::Request&) { return "done"; };
    const auto first = must(pair.two.serve("grab", answer, {"closes the gripper"}));
    const auto refused = pair.two.serve("grab", answer);
    REQUIRE_FALSE(refused.has_value());
    CHECK(refused.error().code == rect::Code::service_refused);
    const auto catalogue = must(pair.two.query_registry("catalogue"));
    CHECK_THAT(catalogue, ContainsSubstring("closes the gripper"));
    const auto look = must(pair.two.serve("look", answer, {"", true}));
    CHECK(pair.two.serve("look", answer, {"", true}).has_value());
}
