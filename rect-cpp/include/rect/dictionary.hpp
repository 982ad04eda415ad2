/// @file
/// Trains and loads compression dictionaries, and decodes payloads.
#ifndef RECT_DICTIONARY_HPP
#define RECT_DICTIONARY_HPP

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A compression dictionary for small messages of similar content. Robot::with_dictionary uses it.
///
///     const auto dictionary = rect::must(rect::Dictionary::train(samples, 4096));
///     const auto robot_with_dictionary = rect::must(robot.with_dictionary(dictionary));
class Dictionary : public Handle {
public:
    using Handle::Handle;

    /// Trains a dictionary of at most `size` bytes (512 to 131072; 4 to 16 kB suit JSON). The samples are a few hundred
    /// messages of the kind that will be sent, about ten times `size` in total.
    ///
    /// Training takes long enough that a program should do it only once, when it starts. Fails with Code::dictionary if the
    /// samples are too few or too different.
    [[nodiscard]] static expected<Dictionary> train(const std::vector<std::string>& samples, std::size_t size) {
        std::vector<rect_payload> raw;
        raw.reserve(samples.size());
        for (const auto& sample : samples) {
            raw.push_back(rect_payload_bytes(sample.data(), sample.size()));
        }
        rect_dictionary dictionary;
        rect_error error;
        const auto code = rect_dictionary_train(raw.data(), raw.size(), size, &dictionary, &error);
        return detail::value_or_error<Dictionary>(code, error, [&] { return Dictionary(dictionary.id); });
    }

    /// Loads a standard zstd dictionary. Fails with Code::dictionary if the bytes are not a dictionary.
    [[nodiscard]] static expected<Dictionary> read(span<const std::uint8_t> bytes) {
        rect_dictionary dictionary;
        rect_error error;
        const auto code = rect_dictionary_read(bytes.data(), bytes.size(), &dictionary, &error);
        return detail::value_or_error<Dictionary>(code, error, [&] { return Dictionary(dictionary.id); });
    }

    /// Returns the id by which payloads refer to the dictionary. It is computed from the content, so it is the same on every
    /// robot.
    [[nodiscard]] expected<std::uint32_t> id() const {
        std::uint32_t id = 0;
        rect_error error;
        const auto code = rect_dictionary_id({handle_id()}, &id, &error);
        return detail::value_or_error<std::uint32_t>(code, error, [&] { return id; });
    }
};

/// Decodes a payload that was encoded with a codec (its encoding ends with e.g. `;zstd`). Messages and frames that a robot
/// receives are already decoded; use this for payloads that were stored elsewhere.
///
/// Fails with Code::codec if the payload is damaged, exceeds the limits, or needs another dictionary.
[[nodiscard]] inline expected<Buffer> decode(const PayloadView& payload, const Dictionary* dictionary = nullptr,
                                             Limits limits = {}) {
    const auto raw_limits = detail::raw(limits);
    rect_dictionary raw_dictionary{};
    raw_dictionary.id = dictionary == nullptr ? 0 : dictionary->handle_id();
    rect_buffer buffer;
    rect_error error;
    const auto code =
        rect_decode(&payload.raw(), dictionary == nullptr ? nullptr : &raw_dictionary, &raw_limits, &buffer, &error);
    return detail::value_or_error<Buffer>(code, error, [&] { return Buffer(buffer); });
}

}  // namespace RECT_ABI
}  // namespace rect

#endif
