// What the C++ library takes to call back with a message, and how many it carries: `../rounds.rs`, in C++.
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
    Counter heard;
    const auto subscription = must(pair.two.subscribe(
        "wombat-1/n", [&](const rect::MessageView&) { heard.add(); }, {1 << 16, rect::WhenFull::wait}));
    heard.want(1);
    until([&] {
        must(pair.one.publish("n", text));
        return heard.wait(patience).has_value();
    });

    std::vector<double> took;
    for (int n = 0; n < rounds; ++n) {
        heard.want(1);
        const auto began = Clock::now();
        must(pair.one.publish("n", text));
        const auto heard_at = heard.wait(deadline);
        REQUIRE(heard_at);
        took.push_back(us(*heard_at - began));
    }
    std::sort(took.begin(), took.end());
    heard.want(messages);
    const auto began = Clock::now();
    for (int n = 0; n < messages; ++n) {
        must(pair.one.publish("n", text));
    }
    const auto heard_at = heard.wait(deadline);
    REQUIRE(heard_at);
    const double per_s = messages / us(*heard_at - began) * 1e6;
    std::printf("{\"p50_us\": %f, \"messages_per_s\": %f}\n", took[rounds / 2], per_s);
}
