/// @file
/// Owns payloads: bytes and what they are, and how a program's values become one and back.
#ifndef RECT_PAYLOAD_HPP
#define RECT_PAYLOAD_HPP

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <iomanip>
#include <limits>
#include <locale>
#include <sstream>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "array.hpp"
#include "picture.hpp"
#include "span.hpp"
#include "text.hpp"

namespace rect {
inline namespace RECT_ABI {

class Payload;
class PayloadView;

/// @cond
namespace detail {
// False, but only once the type is known.
template <class T>
inline constexpr bool never = false;
}  // namespace detail
/// @endcond

/// How a type of the program's becomes a payload and back; specialised for each, as `rect/nlohmann.hpp` does for JSON:
///
///     template <>
///     struct rect::Adapter<Reading> {
///         static rect::expected<rect::Payload> to_payload(const Reading& reading);
///         static rect::expected<Reading> from_payload(const rect::PayloadView& payload);
///     };
template <class T, class = void>
struct Adapter {
    static_assert(detail::never<T>,
                  "no rect::Adapter for this type: include <rect/nlohmann.hpp> (it needs nlohmann-json) for JSON, containers and "
                  "structs with NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE, use rect::numbers of <rect/numbers.hpp> for arrays of "
                  "numbers, or specialise rect::Adapter for the type");
    /// Declared only: the advice above is the one error that the compiler reports.
    static expected<Payload> to_payload(const T& value);
    /// See to_payload.
    static expected<T> from_payload(const PayloadView& payload);
};

/// Bytes and what they are, which belong to something else: a message, a frame, the program.
class PayloadView {
public:
    /// Bytes, and their encoding, as `application/json`.
    PayloadView(span<const std::uint8_t> bytes, std::string_view encoding) noexcept
        : raw_{bytes.data(), bytes.size(), detail::raw(encoding)} {}
    /// As C has them.
    explicit PayloadView(const rect_payload& raw) noexcept : raw_(raw) {}

    /// The bytes.
    [[nodiscard]] span<const std::uint8_t> bytes() const noexcept {
        return {static_cast<const std::uint8_t*>(raw_.data), raw_.len};
    }
    /// What they are.
    [[nodiscard]] std::string_view encoding() const noexcept { return detail::view(raw_.encoding); }
    /// As text; Code::payload if it is something else.
    [[nodiscard]] expected<std::string_view> text() const {
        rect_text text;
        rect_error error;
        const auto code = rect_payload_as_text(&raw_, &text, &error);
        return detail::got<std::string_view>(code, error, [&] { return detail::view(text); });
    }
    /// As a value of the program's, by its Adapter.
    template <class T>
    [[nodiscard]] expected<T> value() const {
        return Adapter<T>::from_payload(*this);
    }
    /// As a picture: a raw one, PNG, JPEG or WebP.
    [[nodiscard]] expected<Picture> picture(Limits limits = {}) const { return Picture::read(raw_, limits); }
    /// As an array of numbers, raw or quantised.
    [[nodiscard]] expected<Array> array(Limits limits = {}) const { return Array::read(raw_, limits); }

    /// As C has it.
    [[nodiscard]] const rect_payload& raw() const noexcept { return raw_; }

private:
    rect_payload raw_;
};

/// Bytes and what they are, of its own.
class Payload {
public:
    /// Bytes in a string, and their encoding.
    Payload(std::string bytes, std::string encoding) : bytes_(std::move(bytes)), encoding_(std::move(encoding)) {}
    /// A copy.
    explicit Payload(const PayloadView& view)
        : bytes_(reinterpret_cast<const char*>(view.bytes().data()), view.bytes().size()),
          encoding_(view.encoding()) {}

    /// What is in it.
    [[nodiscard]] PayloadView view() const noexcept {
        return {{reinterpret_cast<const std::uint8_t*>(bytes_.data()), bytes_.size()}, encoding_};
    }

    /// JSON, as some library has written it.
    static Payload json(std::string text) { return {std::move(text), "application/json"}; }

private:
    std::string bytes_;
    std::string encoding_;
};

/// A payload of the library's own: what a codec made.
class Buffer {
public:
    /// Takes over what C has given.
    explicit Buffer(const rect_buffer& raw) noexcept : handle_(raw.id), payload_(raw.payload) {}
    /// What is in it.
    [[nodiscard]] const PayloadView& view() const noexcept { return payload_; }

private:
    Handle handle_;
    PayloadView payload_;
};

/// A payload made smaller by a codec: `zstd:9`, `jpeg:60`, `webp:60`, `png`, `quantised:0.01`.
[[nodiscard]] inline expected<Buffer> encode(const Text& codec, const PayloadView& payload) {
    rect_buffer buffer;
    rect_error error;
    const auto code = rect_encode(codec.c_str(), &payload.raw(), &buffer, &error);
    return detail::got<Buffer>(code, error, [&] { return Buffer(buffer); });
}

/// @cond
namespace detail {

// Containers of bytes, and not what only says that it can become one, as nlohmann::json does.
template <class T, class = void>
inline constexpr bool is_bytes = false;
template <class T>
inline constexpr bool is_bytes<T, std::void_t<decltype(std::declval<const T&>().data())>> =
    std::is_same_v<decltype(std::declval<const T&>().data()), const std::uint8_t*> ||
    std::is_same_v<decltype(std::declval<const T&>().data()), std::uint8_t*>;

/// A number or truth value as JSON, whatever the program's locale is. Code::payload: JSON has no infinity and no NaN.
template <class T>
expected<std::string> number_to_json(T value) {
    if constexpr (std::is_same_v<T, bool>) {
        return std::string(value ? "true" : "false");
    } else if constexpr (std::is_integral_v<T>) {
        return std::to_string(value);
    } else {
        if (!std::isfinite(value)) {
            return failed(Code::payload, "this value can't be written as JSON: it is infinite or not a number");
        }
        std::string text;
        // As few digits as give the same number again.
        for (int digits = std::numeric_limits<T>::digits10; digits <= std::numeric_limits<T>::max_digits10; ++digits) {
            std::ostringstream written;
            written.imbue(std::locale::classic());
            written << std::setprecision(digits) << value;
            text = written.str();
            std::istringstream read(text);
            read.imbue(std::locale::classic());
            T same{};
            if (read >> same && same == value) {
                break;
            }
        }
        // A number with a fraction stays one for the receiver.
        return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
    }
}

/// Calls `use` with the value as C wants it.
template <class T, class Use>
expected<void> with_payload(const T& value, Use use) {
    if constexpr (std::is_same_v<T, PayloadView>) {
        return use(value.raw());
    } else if constexpr (std::is_same_v<T, Payload> || std::is_same_v<T, Buffer>) {
        return use(value.view().raw());
    } else if constexpr (std::is_convertible_v<const T&, std::string_view>) {
        const std::string_view text = value;
        return use(rect_payload{text.data(), text.size(), raw("text/plain")});
    } else if constexpr (is_bytes<T>) {
        const span<const std::uint8_t> bytes = value;
        return use(rect_payload{bytes.data(), bytes.size(), raw("zenoh/bytes")});
    } else if constexpr (std::is_same_v<T, Picture>) {
        return value.payload([&](const rect_payload& payload) { return use(payload); });
    } else if constexpr (std::is_arithmetic_v<T>) {
        const auto text = number_to_json(value);
        if (!text) {
            return unexpected<Error>(text.error());
        }
        return use(rect_payload{text->data(), text->size(), raw("application/json")});
    } else {
        const auto made = Adapter<T>::to_payload(value);
        if (!made) {
            return unexpected<Error>(made.error());
        }
        return use(made->view().raw());
    }
}

}  // namespace detail
/// @endcond

}  // namespace RECT_ABI
}  // namespace rect

#endif
