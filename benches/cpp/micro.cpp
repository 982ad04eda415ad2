// Micro-benchmarks of the C++ library: two robots in one process, linked over TCP.
#include <cstdio>
#include <nlohmann/json.hpp>
#include <rect/nlohmann.hpp>

#include "allocations.hpp"
#include "counter.hpp"
#include "pair.hpp"

namespace {

const nlohmann::json reading{{"robot", "wombat-1"}, {"angle_deg", 12.5}, {"volt", 7.2}, {"ok", true}};
const std::string text = reading.dump();

}  // namespace

TEST_CASE("a message") {
    Pair pair;
    Counter received;
    const auto subscription = must(pair.two.subscribe(
        "wombat-1/n", [&](const rect::MessageView&) { received.add(); }, {1 << 16, rect::WhenFull::block}));
    received.expect_more(1);
    until([&] {
        must(pair.one.publish("n", text));
        return received.wait(retry_interval).has_value();
    });

    BENCHMARK("publish to callback") {
        received.expect_more(1);
        must(pair.one.publish("n", text));
        return received.wait(deadline).has_value();
    };
    BENCHMARK("1000 messages to callbacks") {
        received.expect_more(1000);
        for (int n = 0; n < 1000; ++n) {
            must(pair.one.publish("n", text));
        }
        return received.wait(deadline).has_value();
    };
    const auto allocated = allocations();
    constexpr int messages = 10'000;
    received.expect_more(messages);
    for (int n = 0; n < messages; ++n) {
        must(pair.one.publish("n", text));
    }
    REQUIRE(received.wait(deadline));
    std::printf("heap allocations for a message, published and received: %.2f\n", double(allocations() - allocated) / messages);
}

TEST_CASE("a request") {
    Pair pair;
    const auto service = must(pair.two.serve("echo", [](const rect::Request& request) { return rect::Payload(request.payload); }));
    until([&] { return pair.one.request("wombat-2", "echo", text, 1s).has_value(); });
    BENCHMARK("request and reply") { return must(pair.one.request("wombat-2", "echo", text, deadline)).payload.bytes().size(); };
}

TEST_CASE("parts") {
    const rect::PayloadView payload({reinterpret_cast<const std::uint8_t*>(text.data()), text.size()}, "application/json");
    BENCHMARK("text of a payload") { return payload.text()->size(); };
    BENCHMARK("JSON of a payload") { return payload.value<nlohmann::json>()->size(); };
    BENCHMARK("an empty handle") { return rect::Robot().counters().has_value(); };
}
