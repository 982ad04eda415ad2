/// @file
/// Owns saying arrays of numbers.
#ifndef RECT_NUMBERS_HPP
#define RECT_NUMBERS_HPP

#include <cstddef>
#include <string>
#include <vector>

#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// Numbers as a payload: `robot.publish("scan", rect::numbers(distances))`, or with a shape, `rect::numbers(map, {480, 640})`.
/// Code::codec if they are not as many as the shape says.
template <class Container>
[[nodiscard]] expected<Payload> numbers(const Container& items, std::vector<std::size_t> shape = {}) {
    using T = std::remove_cv_t<std::remove_reference_t<decltype(*items.data())>>;
    if (shape.empty()) {
        shape.push_back(items.size());
    }
    const auto bytes = items.size() * sizeof(T);
    char encoding[RECT_ENCODING_BYTES];
    rect_error error;
    const auto code = rect_array_encoding(detail::element<T>(), shape.data(), shape.size(), items.data(), bytes, &encoding, &error);
    return detail::got<Payload>(code, error, [&] {
        return Payload(std::string(reinterpret_cast<const char*>(items.data()), bytes), encoding);
    });
}

}  // namespace RECT_ABI
}  // namespace rect

#endif
