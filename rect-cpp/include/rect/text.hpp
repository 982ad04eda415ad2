/// @file
/// Owns text: as C gives it, and as C wants it.
#ifndef RECT_TEXT_HPP
#define RECT_TEXT_HPP

#include <chrono>
#include <cstdint>
#include <limits>
#include <string>
#include <string_view>

#include "error.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A text that a call takes: a literal, a `std::string` or a `std::string_view`. One with a zero byte in it is
/// Code::argument.
class Text {
public:
    /// A text with a zero byte at its end, that lives as long as the call; not copied.
    Text(const char* text) noexcept : text_(text) {}
    /// A string that lives as long as the call; not copied.
    Text(const std::string& text) noexcept
        : text_(text.find('\0') == std::string::npos ? text.c_str() : nullptr) {}
    /// Any text; copied.
    Text(std::string_view text) : copy_(text), text_(copy_.c_str()) {
        if (text.find('\0') != std::string_view::npos) {
            text_ = nullptr;
        }
    }
    Text(const Text&) = delete;
    Text& operator=(const Text&) = delete;
    ~Text() = default;

    /// For C.
    [[nodiscard]] const char* c_str() const noexcept { return text_; }

private:
    std::string copy_;
    const char* text_;
};

/// @cond
namespace detail {

inline std::string_view view(const rect_text& text) noexcept {
    return {reinterpret_cast<const char*>(text.data), text.len};
}

inline rect_text raw(std::string_view text) noexcept {
    return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

/// NULL for nothing.
inline const char* or_null(const std::string& text) noexcept {
    return text.empty() ? nullptr : text.c_str();
}

/// As C counts; what is longer than 49 days is so long.
inline std::uint32_t ms(std::chrono::milliseconds time) noexcept {
    constexpr auto most = std::numeric_limits<std::uint32_t>::max() - 1;
    if (time == std::chrono::milliseconds::max()) {
        return RECT_FOREVER;
    }
    if (time.count() < 0) {
        return 0;
    }
    return time.count() > static_cast<std::int64_t>(most) ? most : static_cast<std::uint32_t>(time.count());
}

}  // namespace detail
/// @endcond

/// As a timeout: waits as long as it takes.
inline constexpr std::chrono::milliseconds forever = std::chrono::milliseconds::max();

}  // namespace RECT_ABI
}  // namespace rect

#endif
