/// @file
/// Owns streams, of which the newest frame counts.
#ifndef RECT_STREAM_HPP
#define RECT_STREAM_HPP

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

#include "message.hpp"

namespace rect {
inline namespace RECT_ABI {

/// How a stream is sent.
struct StreamOptions {
    /// How its frames are fitted to what gets through.
    enum class Mode : std::uint32_t {
        /// Frames are as good as what gets through allows: pictures become smaller and coarser by themselves.
        adaptive = RECT_STREAM_MODE_ADAPTIVE,
        /// Frames go as they are given, at most `most_frames_per_s`.
        fixed = RECT_STREAM_MODE_FIXED,
        /// A sensor's values: as they are, as often as they come, and nothing comes back.
        sensor = RECT_STREAM_MODE_SENSOR,
    };

    /// How its frames are fitted.
    Mode mode = Mode::adaptive;
    /// Pictures with a quality are written as WebP instead of JPEG: smaller, and several times as long to write.
    bool webp = false;
    /// Not more frames per second than that; 0: 15. For a fixed one it has to be given.
    double most_frames_per_s = 0;
    /// Frames per second that are wanted even of the smallest; 0: 5.
    double least_frames_per_s = 0;

    /// For a sensor's values.
    static StreamOptions sensor() { return {Mode::sensor, false, 0, 0}; }
    /// For frames that go as they are, at most so often.
    static StreamOptions fixed(double most_frames_per_s) { return {Mode::fixed, false, most_frames_per_s, 0}; }
};

/// A stream that this program sends. It ends when this does.
class Stream : public Handle {
public:
    using Handle::Handle;

    /// Sends a frame as it is, if anyone wants one now; to how many groups of receivers it went. Does not wait for the link.
    template <class T>
    expected<std::uint32_t> send(const T& frame) const {
        std::uint32_t sent = 0;
        const auto done = detail::with_payload(frame, [&](const rect_payload& payload) {
            rect_error error;
            return detail::done(rect_stream_send({id()}, &payload, &sent, &error), error);
        });
        return done ? expected<std::uint32_t>(sent) : unexpected<Error>(done.error());
    }

    /// Sends a picture, at the size and quality that get through; to how many groups of receivers it went. Takes as long as
    /// writing it, and nothing where nobody wants one.
    expected<std::uint32_t> send(const Picture& picture) const {
        std::uint32_t sent = 0;
        rect_error error;
        const auto pixels = picture.pixels();
        const auto code = rect_stream_send_picture({id()}, picture.width(), picture.height(),
                                                   static_cast<std::uint32_t>(picture.format()), pixels.data(),
                                                   pixels.size(), &sent, &error);
        return detail::got<std::uint32_t>(code, error, [&] { return sent; });
    }

    /// What goes out, what gets through, and why it is as it is: JSON (docs/streams.md).
    [[nodiscard]] expected<std::string> status() const {
        rect_string status;
        rect_error error;
        const auto code = rect_stream_status({id()}, &status, &error);
        return detail::got<std::string>(code, error, [&] {
            const Handle handle(status.id);
            return std::string(detail::view(status.text));
        });
    }
};

/// A frame of a stream, which belongs to the callback that is called with it.
class FrameView {
public:
    /// As C has it.
    explicit FrameView(const rect_frame& raw) noexcept : payload(raw.payload), raw_(raw) {}

    /// What it is.
    PayloadView payload;

    /// Its number. The sender numbers anew when it starts, and when this robot gets other frames than before.
    [[nodiscard]] std::uint32_t number() const noexcept { return raw_.number; }
    /// How old it was when it came; until the sender has told its time, how much older than the fastest of the last minute.
    /// Nothing: another program's, which does not tell.
    [[nodiscard]] std::optional<std::chrono::microseconds> age() const noexcept {
        if (raw_.age_us < 0) {
            return std::nullopt;
        }
        return std::chrono::microseconds(raw_.age_us);
    }
    /// So many before it were not seen: the link dropped them, or this program was not there to take them.
    [[nodiscard]] std::uint32_t skipped() const noexcept { return raw_.skipped; }

private:
    rect_frame raw_;
};

/// A frame of the program's own: what Watch::next gives.
class Frame {
public:
    /// Takes over what C has given.
    explicit Frame(const rect_frame& raw) noexcept : handle_(raw.id), view_(raw) {}
    /// What it is.
    [[nodiscard]] const FrameView& operator*() const noexcept { return view_; }
    /// What it is.
    [[nodiscard]] const FrameView* operator->() const noexcept { return &view_; }

private:
    Handle handle_;
    FrameView view_;
};

/// A stream that this program watches. It ends when this does.
class Watch : public Handle {
public:
    using Handle::Handle;

    /// The next frame; Code::timed_out: there was none; Code::closed: the session was closed, or another thread dropped this.
    [[nodiscard]] expected<Frame> next(std::chrono::milliseconds timeout = forever) const {
        rect_frame frame;
        rect_error error;
        const auto code = rect_watch_next({id()}, detail::ms(timeout), &frame, &error);
        return detail::got<Frame>(code, error, [&] { return Frame(frame); });
    }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
