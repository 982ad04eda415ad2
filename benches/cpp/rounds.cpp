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
    until([&] {
        must(pair.one.publish("n", text));
        return heard.wait(1, patience);
    });

    std::vector<double> took;
    for (int n = 0; n < rounds; ++n) {
        const auto before = heard.now();
        const auto began = Clock::now();
        must(pair.one.publish("n", text));
        // Not REQUIRE, which would cost a part of what is measured.
        if (!heard.wait(before + 1, deadline)) {
            FAIL("a message did not arrive");
        }
        took.push_back(us(heard.at() - began));
    }
    std::sort(took.begin(), took.end());
    const auto before = heard.now();
    const auto began = Clock::now();
    for (int n = 0; n < messages; ++n) {
        must(pair.one.publish("n", text));
    }
    REQUIRE(heard.wait(before + messages, deadline));
    const double per_s = messages / us(heard.at() - began) * 1e6;
    std::printf("{\"p50_us\": %f, \"messages_per_s\": %f}\n", took[rounds / 2], per_s);
}
