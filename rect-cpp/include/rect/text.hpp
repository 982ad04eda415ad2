/// @file
/// Converts text and durations between C++ and C.
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

/// A text argument: a literal, a `std::string` or a `std::string_view`. A call with a text that contains a zero byte fails
/// with Code::argument.
class Text {
public:
    /// Refers to a text with a terminating zero byte, which must outlive the call.
    Text(const char* text) noexcept : text_(text) {}
    /// Refers to a string, which must outlive the call.
    Text(const std::string& text) noexcept
        : text_(text.find('\0') == std::string::npos ? text.c_str() : nullptr) {}
    /// Copies a text.
    Text(std::string_view text) : copy_(text), text_(copy_.c_str()) {
        if (text.find('\0') != std::string_view::npos) {
            text_ = nullptr;
        }
    }
    Text(const Text&) = delete;
    Text& operator=(const Text&) = delete;
    ~Text() = default;

    /// Returns the text for C; NULL if it contains a zero byte.
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

/// Returns the text for C, or NULL if it is empty.
inline const char* or_null(const std::string& text) noexcept {
    return text.empty() ? nullptr : text.c_str();
}

/// Converts a timeout for C. Timeouts of more than 49 days are limited to that, except rect::forever.
inline std::uint32_t ms(std::chrono::milliseconds time) noexcept {
    constexpr auto max = std::numeric_limits<std::uint32_t>::max() - 1;
    if (time == std::chrono::milliseconds::max()) {
        return RECT_FOREVER;
    }
    if (time.count() < 0) {
        return 0;
    }
    return time.count() > static_cast<std::int64_t>(max) ? max : static_cast<std::uint32_t>(time.count());
}

}  // namespace detail
/// @endcond

/// A timeout that never expires.
inline constexpr std::chrono::milliseconds forever = std::chrono::milliseconds::max();

/// The timeout of a request for which the program states none.
inline constexpr std::chrono::milliseconds default_timeout = std::chrono::seconds(10);

}  // namespace RECT_ABI
}  // namespace rect

#endif
