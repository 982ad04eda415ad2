/// @file
/// Sends and watches streams, of which only the newest frame matters.
#ifndef RECT_STREAM_HPP
#define RECT_STREAM_HPP

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "message.hpp"

namespace rect {
inline namespace RECT_ABI {

/// The options of a stream: Robot::stream.
struct StreamOptions {
    /// How a stream adapts to the links.
    enum class Mode : std::uint32_t {
        /// Pictures are scaled and compressed automatically so that they fit what the links can carry.
        adaptive = RECT_STREAM_MODE_ADAPTIVE,
        /// Frames are sent unchanged, at most `max_frames_per_s` per second.
        fixed = RECT_STREAM_MODE_FIXED,
        /// Values of a sensor: frames are sent unchanged, as often as they come, and receivers send no feedback.
        sensor = RECT_STREAM_MODE_SENSOR,
        /// Pictures are sent as video: each frame contains only what differs from the one before.
        video = RECT_STREAM_MODE_VIDEO,
    };

    /// The mode.
    Mode mode = Mode::adaptive;
    /// Whether to compress pictures as WebP instead of JPEG. WebP is smaller, but takes several times as long.
    bool webp = false;
    /// Maximum frame rate, 0.01 to 1,000,000 frames per second. 0 means the default: 15, or no limit for a sensor.
    double max_frames_per_s = 0;
    /// Minimum frame rate that an adaptive stream aims for with its smallest pictures, 0.01 to 1,000,000 frames per second.
    /// 0 means the default, 5.
    double min_frames_per_s = 0;
    /// Maximum data rate of an adaptive stream, 1 or more bytes per second. 0 means the default, 20,000,000.
    double max_bytes_per_s = 0;
    /// Interval at which receivers report what arrives, 0.2 to 10 s; `rect::forever` for no reports. 0 means the default:
    /// 500 ms for an adaptive stream or a video, 2 s for a fixed one, and no reports for a sensor.
    std::chrono::milliseconds feedback_interval{0};

    /// Returns the options for pictures that are sent as video.
    static StreamOptions video() { return of(Mode::video); }
    /// Returns the options for the values of a sensor.
    static StreamOptions sensor() { return of(Mode::sensor); }
    /// Returns the options for frames that are sent unchanged, at a limited rate in frames per second.
    static StreamOptions fixed(double max_frames_per_s) {
        auto options = of(Mode::fixed);
        options.max_frames_per_s = max_frames_per_s;
        return options;
    }

private:
    static StreamOptions of(Mode mode) {
        StreamOptions options;
        options.mode = mode;
        return options;
    }
};

/// A stream that this program sends. Destroying it ends the stream.
///
///     const auto camera = rect::must(robot.stream("camera"));
///     rect::must(camera.send(rect::Picture(320, 240, rect::Format::rgb8, pixels)));
class StreamSender : public Handle {
public:
    using Handle::Handle;

    /// Sends a frame unchanged, if any receiver needs one now. Returns the number of groups of receivers that it is sent to,
    /// 0 to 2. Does not wait for the link.
    template <class T>
    expected<std::uint32_t> send(const T& frame) const {
        std::uint32_t sent = 0;
        const auto done = detail::with_payload(frame, [&](const rect_payload& payload) {
            rect_error error;
            return detail::ok_or_error(rect_stream_sender_send({handle_id()}, &payload, &sent, &error), error);
        });
        return done ? expected<std::uint32_t>(sent) : unexpected<Error>(done.error());
    }

    /// Sends a picture. An adaptive stream scales and compresses it as the links require, and a video stream sends it as
    /// video; other streams send it uncompressed. Returns the number of groups of receivers that it is sent to, 0 to 2. Takes as long as compressing the
    /// picture; if no receiver needs a frame now, the call returns immediately.
    expected<std::uint32_t> send(const Picture& picture) const {
        std::uint32_t sent = 0;
        rect_error error;
        const auto pixels = picture.pixels();
        const auto code = rect_stream_sender_send_picture({handle_id()}, picture.width(), picture.height(),
                                                   static_cast<std::uint32_t>(picture.format()), pixels.data(),
                                                   pixels.size(), &sent, &error);
        return detail::value_or_error<std::uint32_t>(code, error, [&] { return sent; });
    }

    /// Returns the state of the stream as JSON: what is sent, what arrives, and why the current quality was chosen
    /// (docs/concepts/streams.md).
    [[nodiscard]] expected<std::string> status() const {
        rect_string status;
        rect_error error;
        const auto code = rect_stream_sender_status({handle_id()}, &status, &error);
        return detail::value_or_error<std::string>(code, error, [&] {
            const Handle handle(status.id);
            return std::string(detail::view(status.text));
        });
    }
};

/// A frame of a stream. It is valid until the callback that receives it returns.
class FrameView {
public:
    /// Refers to a struct of rect.h.
    explicit FrameView(const rect_frame& raw) noexcept : payload(raw.payload), raw_(raw) {}

    /// The payload. A frame of a video is decoded: the payload is the raw picture.
    PayloadView payload;

    /// Returns the number of the frame. Numbering restarts when the sender restarts, and when this robot joins another group
    /// of receivers.
    [[nodiscard]] std::uint32_t number() const noexcept { return raw_.number; }
    /// Returns the age of the frame on arrival. Until the offset of the sender's clock is known, this is the delay relative
    /// to the fastest frame of the last minute. Returns nothing if the sender is a stock Zenoh program.
    [[nodiscard]] std::optional<std::chrono::microseconds> age() const noexcept {
        if (raw_.age_us < 0) {
            return std::nullopt;
        }
        return std::chrono::microseconds(raw_.age_us);
    }
    /// Returns how many frames directly before this one the program did not receive, because the link or the receive queue
    /// dropped them.
    [[nodiscard]] std::uint32_t skipped() const noexcept { return raw_.skipped; }
    /// Returns how many of these did not arrive.
    [[nodiscard]] std::uint32_t lost() const noexcept { return raw_.lost; }
    /// Returns the length of the frame as it was sent, in bytes.
    [[nodiscard]] std::size_t sent_bytes() const noexcept { return raw_.sent_bytes; }

private:
    rect_frame raw_;
};

/// A frame that the program owns, as Watcher::next returns it.
class Frame : public FrameView {
public:
    /// Takes ownership of a frame of rect.h.
    explicit Frame(const rect_frame& raw) noexcept : FrameView(raw), handle_(raw.id) {}

private:
    Handle handle_;
};

/// A stream that this program receives. Destroying it ends that.
///
///     const auto camera = rect::must(robot.watch("wombat-2/camera"));
///     while (const auto frame = camera.next()) {
///         const auto picture = rect::must(frame->payload.picture());
///     }
class Watcher : public Handle {
public:
    using Handle::Handle;

    /// Waits for the next frame. Fails with Code::timed_out if none arrives within `timeout`, and with Code::closed if the
    /// session was closed or another thread dropped this watcher.
    [[nodiscard]] expected<Frame> next(std::chrono::milliseconds timeout = forever) const {
        rect_frame frame;
        rect_error error;
        const auto code = rect_watcher_next({handle_id()}, detail::ms(timeout), &frame, &error);
        return detail::value_or_error<Frame>(code, error, [&] { return Frame(frame); });
    }

    /// Asks the sender of a video for a key frame, with the next frame that arrives: for a program that decodes the video itself,
    /// and has dropped frames.
    [[nodiscard]] expected<void> ask_for_key_frame() const {
        rect_error error;
        return detail::ok_or_error(rect_watcher_ask_for_key_frame({handle_id()}, &error), error);
    }

    /// Returns the round trip of a small message to the sender, or nothing until the first one has been measured.
    [[nodiscard]] expected<std::optional<std::chrono::microseconds>> round_trip() const {
        using RoundTrip = std::optional<std::chrono::microseconds>;
        std::int64_t round_trip_us = -1;
        rect_error error;
        const auto code = rect_watcher_round_trip({handle_id()}, &round_trip_us, &error);
        return detail::value_or_error<RoundTrip>(code, error, [&] {
            return round_trip_us < 0 ? RoundTrip() : RoundTrip(std::chrono::microseconds(round_trip_us));
        });
    }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
