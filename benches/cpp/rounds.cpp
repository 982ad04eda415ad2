// Measures the latency from publishing to a callback, and the messages per second, as `../rounds.rs` does for Rust.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "counter.hpp"
#include "pair.hpp"

namespace {

constexpr const char* text = R"({"angle_deg":12.5,"ok":true,"robot":"wombat-1","volt":7.2})";
constexpr int rounds = 1000;
constexpr int messages = 20'000;
using Clock = std::chrono::steady_clock;

double us(Clock::duration time) { return std::chrono::duration<double, std::micro>(time).count(); }

}  // namespace

TEST_CASE("rounds") {
    Pair pair;
    Counter received;
    const auto value = rect::Payload::json(text);
    const auto subscription = must(pair.two.subscribe(
        "wombat-1/n", [&](const rect::MessageView&) { received.add(); }, {1 << 16, rect::WhenFull::block}));
    received.expect_more(1);
    until([&] {
        must(pair.one.publish("n", value));
        return received.wait(retry_interval).has_value();
    });

    std::vector<double> took;
    for (int n = 0; n < rounds; ++n) {
        received.expect_more(1);
        const auto began = Clock::now();
        must(pair.one.publish("n", value));
        const auto reached_at = received.wait(deadline);
        REQUIRE(reached_at);
        took.push_back(us(*reached_at - began));
    }
    std::sort(took.begin(), took.end());
    received.expect_more(messages);
    const auto began = Clock::now();
    for (int n = 0; n < messages; ++n) {
        must(pair.one.publish("n", value));
    }
    const auto reached_at = received.wait(deadline);
    REQUIRE(reached_at);
    const double per_s = messages / us(*reached_at - began) * 1e6;
    std::printf("{\"p50_us\": %f, \"messages_per_s\": %f}\n", took[rounds / 2], per_s);
}
