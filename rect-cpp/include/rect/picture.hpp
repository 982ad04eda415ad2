/// @file
/// Defines uncompressed pictures.
#ifndef RECT_PICTURE_HPP
#define RECT_PICTURE_HPP

#include <cstddef>
#include <cstdint>
#include <optional>

#include "handle.hpp"
#include "span.hpp"

namespace rect {
inline namespace RECT_ABI {

/// The format of a pixel, with 8 bits per channel.
enum class Format : std::uint32_t {
    /// Grey: 1 byte per pixel.
    grey8 = RECT_FORMAT_GREY8,
    /// Red, green and blue: 3 bytes per pixel.
    rgb8 = RECT_FORMAT_RGB8,
    /// Red, green, blue and alpha, not premultiplied: 4 bytes per pixel.
    rgba8 = RECT_FORMAT_RGBA8,
};

/// Limits for decoding one payload. They protect against payloads that become extremely large.
struct Limits {
    /// Maximum size of the decoded payload in bytes. 0 means 64 MiB.
    std::size_t max_bytes = 0;
    /// Maximum number of pixels of a picture. 0 means 16 million.
    std::size_t max_pixels = 0;
};

/// @cond
namespace detail {

inline rect_limits raw(const Limits& limits) noexcept {
    rect_limits raw{};
    raw.max_bytes = limits.max_bytes;
    raw.max_pixels = limits.max_pixels;
    return raw;
}

}  // namespace detail
/// @endcond

/// An uncompressed picture: rows of pixels without padding, from the top left. It either refers to pixels of the program or
/// owns those that PayloadView::picture has decoded.
///
///     const rect::Picture picture(320, 240, rect::Format::rgb8, pixels);
///     rect::must(camera.send(picture));
class Picture {
public:
    /// Refers to pixels of the program, which must outlive this object.
    Picture(std::uint32_t width, std::uint32_t height, Format format, span<const std::uint8_t> pixels) noexcept
        : raw_{0, width, height, static_cast<std::uint32_t>(format), pixels.data(), pixels.size()} {}

    /// Returns the width in pixels.
    [[nodiscard]] std::uint32_t width() const noexcept { return raw_.width; }
    /// Returns the height in pixels.
    [[nodiscard]] std::uint32_t height() const noexcept { return raw_.height; }
    /// Returns the format of the pixels.
    [[nodiscard]] Format format() const noexcept { return static_cast<Format>(raw_.format); }
    /// Returns the pixels.
    [[nodiscard]] span<const std::uint8_t> pixels() const noexcept { return {raw_.pixels, raw_.len}; }

    /// @cond
    static expected<Picture> read(const rect_payload& payload, Limits limits) {
        const auto raw_limits = detail::raw(limits);
        rect_picture picture;
        rect_error error;
        const auto code = rect_picture_read(&payload, &raw_limits, &picture, &error);
        return detail::value_or_error<Picture>(code, error, [&] { return Picture(picture); });
    }

    template <class Use>
    expected<void> payload(Use use) const {
        rect_buffer buffer;
        rect_error error;
        const auto code = rect_picture_payload(raw_.width, raw_.height, raw_.format, raw_.pixels, raw_.len, &buffer, &error);
        const Handle handle(code == RECT_CODE_OK ? buffer.id : 0);
        return code == RECT_CODE_OK ? use(buffer.payload) : detail::ok_or_error(code, error);
    }
    /// @endcond

private:
    explicit Picture(const rect_picture& raw) noexcept : handle_(raw.id), raw_(raw) {}

    Handle handle_;
    rect_picture raw_;
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
