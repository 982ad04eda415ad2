// Tests streams: a sensor's values, adaptive pictures, and the status.
//
//     build/default/tests/rect_tests -# '[#test_streams]'
#include <atomic>
#include <nlohmann/json.hpp>
#include <thread>
#include <vector>

#include "pair.hpp"

namespace {

// Calls a function every 5 ms on a thread of its own, until this object is destroyed.
template <class Function>
class Repeat {
public:
    explicit Repeat(Function function) : thread_([this, function] {
        while (!is_stopped_) {
            function();
            std::this_thread::sleep_for(5ms);
        }
    }) {}
    ~Repeat() {
        is_stopped_ = true;
        thread_.join();
    }

private:
    std::atomic<bool> is_stopped_{false};
    std::thread thread_;
};

}  // namespace

TEST_CASE("frames of a sensor's stream have numbers and ages") {
    Pair pair;
    const auto stream = must(pair.one.stream("distance", rect::StreamOptions::sensor()));
    const auto watch = must(pair.two.watch("wombat-1/distance"));
    const Repeat sending([&] { must(stream.send(std::vector<std::uint8_t>{12, 34})); });
    const auto first = must(watch.next(deadline));
    CHECK(first.payload.bytes().size() == 2);
    CHECK(first.payload.bytes()[1] == 34);
    const auto next = must(watch.next(deadline));
    CHECK(next.number() > first.number());
    until([&] { return must(watch.next(deadline)).age().has_value(); });
}

TEST_CASE("a camera's pictures arrive as pictures") {
    Pair pair;
    const std::vector<std::uint8_t> pixels(64 * 48 * 3, 90);
    const rect::Picture picture(64, 48, rect::Format::rgb8, pixels);
    const auto stream = must(pair.one.stream("camera"));
    Flag received;
    std::atomic<std::uint32_t> width{0};
    const auto watch = must(pair.two.watch("wombat-1/camera", [&](const rect::FrameView& frame) {
        width = must(frame.payload.picture()).width();
        received.set();
    }));
    {
        const Repeat sending([&] { must(stream.send(picture)); });
        CHECK(received.wait());
    }
    CHECK(width > 0);
    CHECK(width <= 64);
    CHECK_THAT(must(stream.status()), ContainsSubstring("\"groups\""));
}

TEST_CASE("video arrives as pictures, or as it was sent") {
    Pair pair;
    const std::vector<std::uint8_t> pixels(64 * 48 * 3, 90);
    const rect::Picture picture(64, 48, rect::Format::rgb8, pixels);
    const auto stream = must(pair.one.stream("camera", rect::StreamOptions::video()));
    const auto decoded = must(pair.two.watch("wombat-1/camera"));
    rect::QueueOptions every_frame;
    every_frame.capacity = 100;
    const auto undecoded = must(pair.two.watch_undecoded("wombat-1/camera", every_frame));
    const Repeat sending([&] { must(stream.send(picture)); });
    until([&] {
        const auto frame = must(decoded.next(deadline));
        const auto shown = must(frame.payload.picture());
        CHECK(frame.sent_bytes() < pixels.size() / 4);
        return shown.width() == 64 && shown.height() == 48;
    });
    const auto frame = must(undecoded.next(deadline));
    CHECK(frame.payload.encoding() == "video/h264");
    CHECK(frame.sent_bytes() == frame.payload.bytes().size());
    must(undecoded.ask_for_key_frame());
    CHECK_THAT(must(stream.status()), ContainsSubstring("\"key_frames\""));
}

TEST_CASE("sending without receivers sends nothing and succeeds") {
    Pair pair;
    const auto stream = must(pair.one.stream("camera", rect::StreamOptions::fixed(10)));
    CHECK(must(stream.send("frame")) == 0);
}

TEST_CASE("the byte limit of a stream is respected, and receivers report") {
    Pair pair;
    rect::StreamOptions options;
    options.max_bytes_per_s = 1000;
    options.feedback_interval = 200ms;
    const auto stream = must(pair.one.stream("camera", options));
    const auto watch = must(pair.two.watch("wombat-1/camera"));
    const std::vector<std::uint8_t> pixels(64 * 48 * 3, 90);
    const Repeat sending([&] { must(stream.send(rect::Picture(64, 48, rect::Format::rgb8, pixels))); });
    until([&] {
        const auto status = nlohmann::json::parse(must(stream.status()));
        for (const auto& group : status["groups"]) {
            CHECK(group["bytes_per_s"].get<double>() <= 1000);
        }
        return !status["receivers"].empty();
    });
    until([&] { return must(watch.round_trip()).has_value(); });
}

TEST_CASE("invalid options of a stream are rejected") {
    Pair pair;
    rect::StreamOptions wrong;
    wrong.mode = static_cast<rect::StreamOptions::Mode>(9);
    const auto error = pair.one.stream("s", wrong).error();
    CHECK(error.code == rect::Code::argument);
    CHECK_THAT(error.text, ContainsSubstring("options.mode is 9"));

    const auto rejected = [&](const rect::StreamOptions& options) {
        const auto error = pair.one.stream("s", options).error();
        CHECK(error.code == rect::Code::option);
        return error.text;
    };
    CHECK_THAT(rejected(rect::StreamOptions::fixed(-1)),
               ContainsSubstring("the option max_frames_per_s cannot be") && ContainsSubstring("-1") && ContainsSubstring("0.01 to 1000000"));
    rect::StreamOptions options;
    options.min_frames_per_s = 2e6;
    CHECK_THAT(rejected(options), ContainsSubstring("min_frames_per_s"));
    options = {};
    options.max_bytes_per_s = 0.5;
    CHECK_THAT(rejected(options), ContainsSubstring("max_bytes_per_s") && ContainsSubstring("1 or more"));
    options = {};
    options.feedback_interval = 100ms;
    CHECK_THAT(rejected(options), ContainsSubstring("feedback_interval") && ContainsSubstring("0.2 to 10 seconds"));
    options.feedback_interval = rect::forever;
    must(pair.one.stream("s", options));
}
