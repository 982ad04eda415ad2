/// @file
/// Owns dictionaries: what many small messages have in common.
#ifndef RECT_DICTIONARY_HPP
#define RECT_DICTIONARY_HPP

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A dictionary, with which small messages of the same kind become much smaller: Robot::packed_with.
class Dictionary : public Handle {
public:
    using Handle::Handle;

    /// Makes one, at most `size` bytes large (512 to 131072; 4 to 16 kB is good for JSON), of messages like those to come:
    /// some hundred, ten times its size together. Takes a while.
    [[nodiscard]] static expected<Dictionary> train(const std::vector<std::string>& samples, std::size_t size) {
        std::vector<rect_payload> raw;
        raw.reserve(samples.size());
        for (const auto& sample : samples) {
            raw.push_back(rect_payload_bytes(sample.data(), sample.size()));
        }
        rect_dictionary dictionary;
        rect_error error;
        const auto code = rect_dictionary_train(raw.data(), raw.size(), size, &dictionary, &error);
        return detail::got<Dictionary>(code, error, [&] { return Dictionary(dictionary.id); });
    }

    /// Reads a standard zstd dictionary.
    [[nodiscard]] static expected<Dictionary> read(span<const std::uint8_t> bytes) {
        rect_dictionary dictionary;
        rect_error error;
        const auto code = rect_dictionary_read(bytes.data(), bytes.size(), &dictionary, &error);
        return detail::got<Dictionary>(code, error, [&] { return Dictionary(dictionary.id); });
    }

    /// The number that messages name it by: made from its content, so that it is the same everywhere.
    [[nodiscard]] expected<std::uint32_t> number() const {
        std::uint32_t number = 0;
        rect_error error;
        const auto code = rect_dictionary_number({id()}, &number, &error);
        return detail::got<std::uint32_t>(code, error, [&] { return number; });
    }
};

/// A payload without its packings (`;zstd`). What comes by a robot has none any more: this is for what was kept elsewhere.
[[nodiscard]] inline expected<Buffer> unpack(const PayloadView& payload, const Dictionary* dictionary = nullptr,
                                             Limits limits = {}) {
    const rect_limits most{limits.max_bytes, limits.max_pixels};
    const rect_dictionary known{dictionary == nullptr ? 0 : dictionary->id()};
    rect_buffer buffer;
    rect_error error;
    const auto code = rect_unpack(&payload.raw(), dictionary == nullptr ? nullptr : &known, &most, &buffer, &error);
    return detail::got<Buffer>(code, error, [&] { return Buffer(buffer); });
}

}  // namespace RECT_ABI
}  // namespace rect

#endif
