/// @file
/// Reads arrays of numbers from payloads.
#ifndef RECT_ARRAY_HPP
#define RECT_ARRAY_HPP

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include "handle.hpp"
#include "picture.hpp"
#include "span.hpp"

namespace rect {
inline namespace RECT_ABI {

/// @cond
namespace detail {

template <class T>
constexpr rect_element element() {
    if constexpr (std::is_same_v<T, std::uint8_t>) {
        return RECT_ELEMENT_U8;
    } else if constexpr (std::is_same_v<T, std::int8_t>) {
        return RECT_ELEMENT_I8;
    } else if constexpr (std::is_same_v<T, std::uint16_t>) {
        return RECT_ELEMENT_U16;
    } else if constexpr (std::is_same_v<T, std::int16_t>) {
        return RECT_ELEMENT_I16;
    } else if constexpr (std::is_same_v<T, std::uint32_t>) {
        return RECT_ELEMENT_U32;
    } else if constexpr (std::is_same_v<T, std::int32_t>) {
        return RECT_ELEMENT_I32;
    } else if constexpr (std::is_same_v<T, std::int64_t>) {
        return RECT_ELEMENT_I64;
    } else if constexpr (std::is_same_v<T, float>) {
        return RECT_ELEMENT_F32;
    } else {
        static_assert(std::is_same_v<T, double>, "arrays are of 8 to 64 bit integers, float or double");
        return RECT_ELEMENT_F64;
    }
}

}  // namespace detail
/// @endcond

/// An array of numbers of one type with up to 8 dimensions, in row-major order (the last index varies fastest).
///
///     const auto scan = rect::must(message->payload.array());
///     for (const float distance : scan.numbers<float>()) { ... }
class Array {
public:
    /// Returns the size of each dimension, the slowest-varying one first.
    [[nodiscard]] span<const std::size_t> shape() const noexcept { return {raw_.shape, raw_.dimensions}; }
    /// Returns the type of the numbers.
    [[nodiscard]] rect_element element() const noexcept { return static_cast<rect_element>(raw_.element); }
    /// Returns the numbers as a span of `T`. The span is empty if the array has numbers of another type.
    template <class T>
    [[nodiscard]] span<const T> numbers() const noexcept {
        if (element() != detail::element<T>()) {
            return {};
        }
        // The numbers arrive in little-endian order, which is also that of this computer; the library aligns them to 8
        // bytes.
        return {reinterpret_cast<const T*>(raw_.numbers), raw_.len / sizeof(T)};
    }
    /// Returns the numbers as bytes in little-endian order.
    [[nodiscard]] span<const std::uint8_t> bytes() const noexcept { return {raw_.numbers, raw_.len}; }

    /// @cond
    static expected<Array> read(const rect_payload& payload, Limits limits) {
        const auto raw_limits = detail::raw(limits);
        rect_array array;
        rect_error error;
        const auto code = rect_array_read(&payload, &raw_limits, &array, &error);
        return detail::value_or_error<Array>(code, error, [&] { return Array(array); });
    }
    /// @endcond

private:
    explicit Array(const rect_array& raw) noexcept : handle_(raw.id), raw_(raw) {}

    Handle handle_;
    rect_array raw_;
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
