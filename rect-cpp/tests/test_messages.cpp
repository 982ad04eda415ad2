// Tests messages: published and sent, received by a subscriber, by a callback, or by waiting for one.
//
//     build/default/tests/rect_tests -# '[#test_messages]'
#include <atomic>
#include <thread>

#include "pair.hpp"

TEST_CASE("a published message is received with its metadata") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("*/arm/*"));
    const auto message = pair.publish_until_received(subscriber, "arm/angle", "12.5");
    CHECK(message.sender() == "wombat-1");
    CHECK(message.recipient().empty());
    CHECK(message.topic() == "arm/angle");
    CHECK(must(message.payload.text()) == "12.5");
    CHECK(message.payload.encoding() == "text/plain");
    CHECK(message.urgency() == rect::Urgency::normal);
    CHECK(message.sequence().has_value());
    REQUIRE(message.sent_at().has_value());
    CHECK(std::chrono::system_clock::now() - *message.sent_at() < deadline);
    CHECK(message.missed() == 0);
    CHECK_FALSE(message.late());
    CHECK(message.problem().empty());
    CHECK(must(subscriber.dropped()) == 0);
    const auto counts = must(subscriber.counts_by_sender());
    REQUIRE(counts.size() == 1);
    CHECK(counts.at("wombat-1").received > 0);
    CHECK(counts.at("wombat-1").missed == 0);
    CHECK(must(pair.two.fleet()) == "rect");
}

TEST_CASE("a message sent to one robot has its recipient and urgency") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("wombat-1/stop"));
    const auto urgent = must(pair.one.with_urgency(rect::Urgency::urgent));
    rect::expected<rect::Message> message = subscriber.next(0ms);
    until([&] {
        must(urgent.send("wombat-2", "stop", "now"));
        message = subscriber.next(retry_interval);
        return message.has_value();
    });
    CHECK(message->recipient() == "wombat-2");
    CHECK(message->urgency() == rect::Urgency::urgent);
    CHECK(must(message->payload.text()) == "now");
}

TEST_CASE("a message to a robot that is not reachable is an error that lists the reachable ones") {
    Pair pair;
    must(pair.one.send("wombat-1", "stop", "to itself"));
    for (int n = 0; n < 2; ++n) {
        const auto sent = pair.one.send("wmbat-2", "stop", "now");
        REQUIRE_FALSE(sent.has_value());
        CHECK(sent.error().code == rect::Code::not_reachable);
        CHECK(sent.error().text == "wmbat-2 is not reachable; did you mean wombat-2? (reachable robots: wombat-2)");
    }
    must(pair.one.send("wombat-2", "stop", "now"));
    must(pair.two.close());
    until([&] {
        const auto sent = pair.one.send("wombat-2", "stop", "now");
        return !sent && sent.error().code == rect::Code::not_reachable;
    });
    pair.two = connect_without_router("wombat-2", "", pair.endpoint);
    until([&] { return pair.one.send("wombat-2", "stop", "now").has_value(); });
}

TEST_CASE("a message that is read too late has expired") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("wombat-1/drive"));
    const auto fresh = pair.publish_until_received(subscriber, "drive", "fresh");
    CHECK_FALSE(fresh.expires_in().has_value());
    const auto steering = must(pair.one.expires_after(1ms));
    const auto careful = must(pair.one.expires_after(60s));
    must(steering.publish("drive", "old"));
    must(careful.publish("drive", "new"));
    std::this_thread::sleep_for(300ms);
    auto message = must(subscriber.next(deadline));
    while (must(message.payload.text()) == "fresh") {
        message = must(subscriber.next(deadline));
    }
    CHECK(must(message.payload.text()) == "new");
    REQUIRE(message.expires_in().has_value());
    CHECK(*message.expires_in() <= 60s);
    CHECK(must(pair.two.counters()).expired == 1);
}

TEST_CASE("a callback runs on a thread of its own and can publish") {
    Pair pair;
    Flag received;
    const auto here = std::this_thread::get_id();
    const auto echoes = must(pair.one.subscribe("wombat-2/echo", [&](const rect::MessageView& message) {
        if (message.payload.text().value_or("") == "hello, wombat-1") {
            received.set();
        }
    }));
    const auto echo = must(pair.two.subscribe("wombat-1/greeting", [&](const rect::MessageView& message) {
        if (std::this_thread::get_id() != here) {
            must(pair.two.publish("echo", "hello, " + std::string(message.sender())));
        }
    }));
    until([&] {
        must(pair.one.publish("greeting", "hello"));
        return received.wait(retry_interval);
    });
}

TEST_CASE("wait_for_message returns the next message on a topic") {
    Pair pair;
    std::atomic<bool> is_received{false};
    std::thread publisher([&] {
        while (!is_received) {
            must(pair.one.publish("battery", "7.2"));
            std::this_thread::sleep_for(5ms);
        }
    });
    const auto message = pair.two.wait_for_message("wombat-1/battery", deadline);
    is_received = true;
    publisher.join();
    REQUIRE(message.has_value());
    CHECK(message->topic() == "battery");
    const auto none = pair.two.wait_for_message("wombat-1/battery", 10ms);
    REQUIRE_FALSE(none.has_value());
    CHECK(none.error().code == rect::Code::timed_out);
}

TEST_CASE("a full queue drops according to its options and counts the dropped messages") {
    Pair pair;
    const auto keeps_newest = must(pair.two.subscribe("wombat-1/n", {1, rect::WhenFull::drop_oldest}));
    const auto keeps_oldest = must(pair.two.subscribe("wombat-1/n", {1, rect::WhenFull::drop_newest}));
    int n = 0;
    until([&] {
        must(pair.one.publish("n", std::to_string(n++)));
        return must(keeps_newest.dropped()) >= 3 && must(keeps_oldest.dropped()) >= 3;
    });
    const auto last = std::stoi(std::string(must(must(keeps_newest.next(deadline)).payload.text())));
    const auto first = std::stoi(std::string(must(must(keeps_oldest.next(deadline)).payload.text())));
    CHECK(first + 3 <= last);
}

TEST_CASE("a subscription that asks for fewer messages skips the others and receives the last one") {
    Pair pair;
    rect::SubscribeOptions options;
    options.max_hz = 20;
    const auto throttled = must(pair.two.subscribe("wombat-1/pose", options));
    until([&] {
        must(pair.one.publish("pose", "0"));
        return throttled.next(20ms).has_value();
    });
    for (int n = 1; n <= 200; ++n) {
        must(pair.one.publish("pose", std::to_string(n)));
    }
    std::uint64_t received = 0;
    std::uint64_t skipped = 0;
    for (std::string value; value != "200"; ++received) {
        const auto message = must(throttled.next(deadline));
        value = must(message.payload.text());
        skipped += message.skipped();
        CHECK(message.missed() == 0);
    }
    CHECK(received < 100);
    CHECK(skipped > 100);
    options.max_hz = 1e6;
    const auto refused = pair.two.subscribe("wombat-1/pose", options);
    REQUIRE_FALSE(refused.has_value());
    CHECK(refused.error().code == rect::Code::option);
}

TEST_CASE("counters, peers and events reflect messages and reachable robots") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("*/n"));
    pair.publish_until_received(subscriber, "n", "12345");
    const auto sender = must(pair.one.counters());
    const auto receiver = must(pair.two.counters());
    CHECK(sender.sent >= 1);
    CHECK(sender.sent_bytes == sender.sent * 5);
    CHECK(receiver.received >= 1);
    CHECK(receiver.missed == 0);
    CHECK(must(pair.one.peers()) == std::vector<std::string>{"wombat-2"});
    CHECK(must(pair.one.name()) == "wombat-1");

    Flag up;
    Flag down;
    const auto subscription = must(pair.one.on_event([&](const rect::Event& event) {
        if (event.robot() == "wombat-2") {
            (event.kind() == rect::Event::Kind::peer_up ? up : down).set();
        }
    }));
    CHECK(up.wait());
    must(pair.two.close());
    CHECK(down.wait());
}

TEST_CASE("a dictionary compresses small messages and is fetched by receivers") {
    Pair pair;
    std::vector<std::string> samples;
    for (int n = 0; n < 2000; ++n) {
        samples.push_back(R"({"angle_deg":)" + std::to_string(n * 7 % 360) + R"(,"battery_volt":7.2,"moving":true})");
    }
    const auto dictionary = must(rect::Dictionary::train(samples, 4096));
    const auto compressing = must(pair.one.with_dictionary(dictionary));
    const auto subscriber = must(pair.two.subscribe("wombat-1/telemetry"));
    rect::expected<rect::Message> message = subscriber.next(0ms);
    until([&] {
        must(compressing.publish("telemetry", rect::Payload::json(samples[7])));
        message = subscriber.next(1s);
        return message.has_value() && message->problem().empty();
    });
    CHECK(must(message->payload.text()) == samples[7]);
    const auto counters = must(pair.one.counters());
    CHECK(counters.sent_bytes / counters.sent < samples[7].size() / 2);
}

TEST_CASE("a robot handle with a codec encodes all messages") {
    Pair pair;
    const auto compressing = must(pair.one.with_codec("zstd:9"));
    const auto subscriber = must(pair.two.subscribe("wombat-1/log"));
    const std::string text(10'000, 'x');
    rect::expected<rect::Message> message = subscriber.next(0ms);
    until([&] {
        must(compressing.publish("log", text));
        message = subscriber.next(retry_interval);
        return message.has_value();
    });
    CHECK(must(message->payload.text()) == text);
    CHECK(must(pair.one.counters()).sent_bytes < 1000 * must(pair.one.counters()).sent);
    CHECK(pair.one.with_codec("gzip").error().code == rect::Code::codec);
}
