/// @file
/// Owns pictures: rows of pixels without gaps, from the upper left.
#ifndef RECT_PICTURE_HPP
#define RECT_PICTURE_HPP

#include <cstddef>
#include <cstdint>
#include <optional>

#include "handle.hpp"
#include "span.hpp"

namespace rect {
inline namespace RECT_ABI {

/// What a pixel is; 8 bits each.
enum class Format : std::uint32_t {
    /// Grey.
    grey8 = RECT_FORMAT_GREY8,
    /// Red, green, blue.
    rgb8 = RECT_FORMAT_RGB8,
    /// Red, green, blue, and how opaque it is; not multiplied with that.
    rgba8 = RECT_FORMAT_RGBA8,
};

/// What may come out of one payload, whatever a peer sends.
struct Limits {
    /// The most bytes; 0: 64 MiB.
    std::size_t max_bytes = 0;
    /// The most pixels of a picture; 0: 16 million.
    std::size_t max_pixels = 0;
};

/// A picture: the library's own, or the program's pixels.
class Picture {
public:
    /// The program's pixels, which live as long as this.
    Picture(std::uint32_t width, std::uint32_t height, Format format, span<const std::uint8_t> pixels) noexcept
        : raw_{0, width, height, static_cast<std::uint32_t>(format), pixels.data(), pixels.size()} {}

    /// Pixels of a row.
    [[nodiscard]] std::uint32_t width() const noexcept { return raw_.width; }
    /// Rows.
    [[nodiscard]] std::uint32_t height() const noexcept { return raw_.height; }
    /// What a pixel is.
    [[nodiscard]] Format format() const noexcept { return static_cast<Format>(raw_.format); }
    /// The pixels.
    [[nodiscard]] span<const std::uint8_t> pixels() const noexcept { return {raw_.pixels, raw_.len}; }

    /// @cond
    static expected<Picture> read(const rect_payload& payload, Limits limits) {
        const rect_limits most{limits.max_bytes, limits.max_pixels};
        rect_picture picture;
        rect_error error;
        const auto code = rect_picture_read(&payload, &most, &picture, &error);
        return detail::got<Picture>(code, error, [&] { return Picture(picture); });
    }

    template <class Use>
    expected<void> payload(Use use) const {
        rect_buffer buffer;
        rect_error error;
        const auto code = rect_picture_payload(raw_.width, raw_.height, raw_.format, raw_.pixels, raw_.len, &buffer, &error);
        const Handle handle(code == RECT_CODE_OK ? buffer.id : 0);
        return code == RECT_CODE_OK ? use(buffer.payload) : detail::done(code, error);
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
