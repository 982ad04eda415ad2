/// @file
/// Makes payloads of arrays of numbers.
#ifndef RECT_NUMBERS_HPP
#define RECT_NUMBERS_HPP

#include <cstddef>
#include <string>
#include <vector>

#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// Makes a payload of a container of numbers, whose elements are contiguous. Without a shape, the array has one dimension.
///
///     robot.publish("scan", rect::must(rect::numbers(distances)));
///     robot.publish("map", rect::must(rect::numbers(cells, {480, 640})));
///
/// Fails with Code::codec if the number of elements does not match the shape.
template <class Container>
[[nodiscard]] expected<Payload> numbers(const Container& items, std::vector<std::size_t> shape = {}) {
    using T = std::remove_cv_t<std::remove_reference_t<decltype(*items.data())>>;
    if (shape.empty()) {
        shape.push_back(items.size());
    }
    const auto bytes = items.size() * sizeof(T);
    char encoding[RECT_ENCODING_BYTES];
    rect_error error;
    const auto code =
        rect_array_encoding(detail::element<T>(), shape.data(), shape.size(), items.data(), bytes, &encoding, &error);
    return detail::value_or_error<Payload>(code, error, [&] {
        return Payload(std::string(reinterpret_cast<const char*>(items.data()), bytes), encoding);
    });
}

}  // namespace RECT_ABI
}  // namespace rect

#endif
