// Streams: values of a sensor, pictures that fit themselves, and their status.
#include <atomic>
#include <thread>
#include <vector>

#include "pair.hpp"

namespace {

// Does something every few ms on a thread of its own, while it is there.
template <class Do>
class Again {
public:
    explicit Again(Do again) : thread_([this, again] {
        while (!is_over_) {
            again();
            std::this_thread::sleep_for(5ms);
        }
    }) {}
    ~Again() {
        is_over_ = true;
        thread_.join();
    }

private:
    std::atomic<bool> is_over_{false};
    std::thread thread_;
};

}  // namespace

TEST_CASE("a sensor's values are watched, and have numbers and ages") {
    Pair pair;
    const auto stream = must(pair.one.stream("distance", rect::StreamOptions::sensor()));
    const auto watch = must(pair.two.watch("wombat-1", "distance"));
    const Again sending([&] { must(stream.send(std::vector<std::uint8_t>{12, 34})); });
    const auto first = must(watch.next(deadline));
    CHECK(first->payload.bytes().size() == 2);
    CHECK(first->payload.bytes()[1] == 34);
    const auto next = must(watch.next(deadline));
    CHECK(next->number() > first->number());
    until([&] { return must(watch.next(deadline))->age().has_value(); });
}

TEST_CASE("pictures of a camera arrive as pictures") {
    Pair pair;
    const std::vector<std::uint8_t> pixels(64 * 48 * 3, 90);
    const rect::Picture picture(64, 48, rect::Format::rgb8, pixels);
    const auto stream = must(pair.one.stream("camera"));
    Flag seen;
    std::atomic<std::uint32_t> width{0};
    const auto watch = must(pair.two.watch("wombat-1", "camera", [&](const rect::FrameView& frame) {
        width = must(frame.payload.picture()).width();
        seen.set();
    }));
    {
        const Again sending([&] { must(stream.send(picture)); });
        CHECK(seen.wait());
    }
    CHECK(width > 0);
    CHECK(width <= 64);
    CHECK_THAT(must(stream.status()), Catch::Matchers::ContainsSubstring("\"groups\""));
}

TEST_CASE("nobody there is nothing sent, and not an error") {
    Pair pair;
    const auto stream = must(pair.one.stream("camera", rect::StreamOptions::fixed(10)));
    CHECK(must(stream.send("frame")) == 0);
}

TEST_CASE("options of a stream are checked") {
    Pair pair;
    CHECK(pair.one.stream("s", rect::StreamOptions::fixed(0)).error().code == rect::Code::argument);
    CHECK(pair.one.stream("s", rect::StreamOptions::fixed(-1)).error().code == rect::Code::argument);
    rect::StreamOptions wrong;
    wrong.mode = static_cast<rect::StreamOptions::Mode>(9);
    const auto error = pair.one.stream("s", wrong).error();
    CHECK(error.code == rect::Code::argument);
    CHECK_THAT(error.text, Catch::Matchers::ContainsSubstring("options.mode is 9"));
}
