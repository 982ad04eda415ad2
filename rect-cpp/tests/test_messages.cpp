// Messages: said to all and to one, heard by a subscriber, a callback, or just the next one.
#include <atomic>
#include <thread>

#include "pair.hpp"

TEST_CASE("what one says, the other hears, with all that goes with it") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("*/arm/*"));
    const auto message = pair.heard(subscriber, "arm/angle", "12.5");
    CHECK(message->from() == "wombat-1");
    CHECK(message->to().empty());
    CHECK(message->topic() == "arm/angle");
    CHECK(must(message->payload.text()) == "12.5");
    CHECK(message->payload.encoding() == "text/plain");
    CHECK(message->urgency() == rect::Urgency::normal);
    CHECK(message->sequence().has_value());
    REQUIRE(message->sent().has_value());
    CHECK(std::chrono::system_clock::now() - *message->sent() < deadline);
    CHECK(message->missed() == 0);
    CHECK_FALSE(message->late());
    CHECK(message->flaw().empty());
    CHECK(must(subscriber.dropped()) == 0);
}

TEST_CASE("what is sent to one robot says so, and how urgent it is") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("wombat-1/stop"));
    const auto urgent = must(pair.one.with(rect::Urgency::urgent));
    rect::expected<rect::Message> message = subscriber.next(0ms);
    until([&] {
        must(urgent.send("wombat-2", "stop", "now"));
        must(urgent.send("wombat-3", "stop", "not you"));
        message = subscriber.next(patience);
        return message.has_value();
    });
    CHECK((*message)->to() == "wombat-2");
    CHECK((*message)->urgency() == rect::Urgency::urgent);
    CHECK(must((*message)->payload.text()) == "now");
}

TEST_CASE("a callback is called for each message, on a thread of its own, and may speak") {
    Pair pair;
    Flag answered;
    const auto here = std::this_thread::get_id();
    const auto answers = must(pair.one.subscribe("wombat-2/echo", [&](const rect::MessageView& message) {
        if (message.payload.text().value_or("") == "hello, wombat-1") {
            answered.set();
        }
    }));
    const auto echo = must(pair.two.subscribe("wombat-1/greeting", [&](const rect::MessageView& message) {
        if (std::this_thread::get_id() != here) {
            must(pair.two.publish("echo", "hello, " + std::string(message.from())));
        }
    }));
    until([&] {
        must(pair.one.publish("greeting", "hello"));
        return answered.wait(patience);
    });
}

TEST_CASE("the next message about a topic is waited for") {
    Pair pair;
    std::atomic<bool> is_heard{false};
    std::thread speaking([&] {
        while (!is_heard) {
            must(pair.one.publish("battery", "7.2"));
            std::this_thread::sleep_for(5ms);
        }
    });
    const auto message = pair.two.listen("wombat-1", "battery", deadline);
    is_heard = true;
    speaking.join();
    REQUIRE(message.has_value());
    CHECK((*message)->topic() == "battery");
    const auto none = pair.two.listen("wombat-1", "battery", 10ms);
    REQUIRE_FALSE(none.has_value());
    CHECK(none.error().code == rect::Code::timed_out);
}

TEST_CASE("a full queue drops as it was told, and counts") {
    Pair pair;
    const auto newest = must(pair.two.subscribe("wombat-1/n", {1, rect::WhenFull::newest_wins}));
    const auto oldest = must(pair.two.subscribe("wombat-1/n", {1, rect::WhenFull::oldest_wins}));
    int n = 0;
    until([&] {
        must(pair.one.publish("n", std::to_string(n++)));
        return must(newest.dropped()) >= 3 && must(oldest.dropped()) >= 3;
    });
    const auto last = std::stoi(std::string(must(must(newest.next(deadline))->payload.text())));
    const auto first = std::stoi(std::string(must(must(oldest.next(deadline))->payload.text())));
    CHECK(first + 3 <= last);
}

TEST_CASE("counters count, and peers and events tell who is there") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("*/n"));
    pair.heard(subscriber, "n", "12345");
    const auto said = must(pair.one.counters());
    const auto heard = must(pair.two.counters());
    CHECK(said.sent >= 1);
    CHECK(said.sent_bytes == said.sent * 5);
    CHECK(heard.received >= 1);
    CHECK(heard.missed == 0);
    CHECK(must(pair.one.peers()) == std::vector<std::string>{"wombat-2"});
    CHECK(must(pair.one.name()) == "wombat-1");

    Flag up;
    Flag down;
    const auto state = must(pair.one.on_state([&](const rect::Event& event) {
        if (event.robot() == "wombat-2") {
            (event.kind() == rect::Event::Kind::peer_up ? up : down).set();
        }
    }));
    CHECK(up.wait());
    must(pair.two.close());
    CHECK(down.wait());
}

TEST_CASE("a dictionary makes small messages smaller, and is fetched by who hears them") {
    Pair pair;
    std::vector<std::string> samples;
    for (int n = 0; n < 2000; ++n) {
        samples.push_back(R"({"angle_deg":)" + std::to_string(n * 7 % 360) + R"(,"battery_volt":7.2,"moving":true})");
    }
    const auto dictionary = must(rect::Dictionary::train(samples, 4096));
    const auto packed = must(pair.one.packed_with(dictionary));
    const auto subscriber = must(pair.two.subscribe("wombat-1/telemetry"));
    rect::expected<rect::Message> message = subscriber.next(0ms);
    until([&] {
        must(packed.publish("telemetry", rect::Payload::json(samples[7])));
        message = subscriber.next(1s);
        return message.has_value() && (*message)->flaw().empty();
    });
    CHECK(must((*message)->payload.text()) == samples[7]);
    const auto counters = must(pair.one.counters());
    CHECK(counters.sent_bytes / counters.sent < samples[7].size() / 2);
}

TEST_CASE("a codec is for all that a robot says") {
    Pair pair;
    const auto packed = must(pair.one.encoded("zstd:9"));
    const auto subscriber = must(pair.two.subscribe("wombat-1/log"));
    const std::string text(10'000, 'x');
    rect::expected<rect::Message> message = subscriber.next(0ms);
    until([&] {
        must(packed.publish("log", text));
        message = subscriber.next(patience);
        return message.has_value();
    });
    CHECK(must((*message)->payload.text()) == text);
    CHECK(must(pair.one.counters()).sent_bytes < 1000 * must(pair.one.counters()).sent);
    CHECK(pair.one.encoded("gzip").error().code == rect::Code::codec);
}
