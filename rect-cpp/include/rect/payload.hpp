/// @file
/// Defines payloads, and converts values to payloads and back.
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
// False, but only when the template is instantiated.
template <class T>
inline constexpr bool never = false;
}  // namespace detail
/// @endcond

/// Converts a type of the program to a payload and back. Specialise it for each type; `rect/nlohmann.hpp` does so for every
/// type that nlohmann::json can convert.
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
    /// Only declared, so that the static assertion above is the only error that the compiler reports.
    static expected<Payload> to_payload(const T& value);
    /// See to_payload.
    static expected<T> from_payload(const PayloadView& payload);
};

/// The kind of a payload, according to its encoding, which is compared like any media type, without case and without parameters.
enum class EncodingKind : std::uint32_t {
    other = RECT_ENCODING_KIND_OTHER,  ///< Anything else, also text in another character set than UTF-8.
    json = RECT_ENCODING_KIND_JSON,    ///< JSON: `application/json`, `text/json`, or a type that ends in `+json`.
    cbor = RECT_ENCODING_KIND_CBOR,    ///< CBOR: `application/cbor`, or a type that ends in `+cbor`.
    text = RECT_ENCODING_KIND_TEXT,    ///< Text in UTF-8: `text/...`, or `zenoh/string`.
    png = RECT_ENCODING_KIND_PNG,      ///< A picture: `image/png`.
    jpeg = RECT_ENCODING_KIND_JPEG,    ///< A picture: `image/jpeg`.
    webp = RECT_ENCODING_KIND_WEBP,    ///< A picture: `image/webp`.
    h264 = RECT_ENCODING_KIND_H264,    ///< A frame of a video: `video/h264`.
    raw = RECT_ENCODING_KIND_RAW,      ///< A raw picture or array, or any bytes: `application/octet-stream`.
};

/// A payload whose bytes belong to another object: a message, a frame, or a variable of the program.
class PayloadView {
public:
    /// Refers to bytes with an encoding, e.g. `application/json`. Both must outlive this object.
    PayloadView(span<const std::uint8_t> bytes, std::string_view encoding) noexcept
        : raw_{bytes.data(), bytes.size(), detail::raw(encoding)} {}
    /// Refers to a struct of rect.h.
    explicit PayloadView(const rect_payload& raw) noexcept : raw_(raw) {}

    /// Returns the bytes.
    [[nodiscard]] span<const std::uint8_t> bytes() const noexcept {
        return {static_cast<const std::uint8_t*>(raw_.data), raw_.len};
    }
    /// Returns the encoding, e.g. `application/json`.
    [[nodiscard]] std::string_view encoding() const noexcept { return detail::view(raw_.encoding); }
    /// Returns what the bytes are, by the encoding. Fails with Code::argument if the encoding is too long or not UTF-8.
    [[nodiscard]] expected<EncodingKind> kind() const {
        rect_encoding_kind kind;
        rect_error error;
        const auto code = rect_payload_kind(&raw_, &kind, &error);
        return detail::value_or_error<EncodingKind>(code, error, [&] { return static_cast<EncodingKind>(kind); });
    }
    /// Returns the text. Fails with Code::payload if the encoding is not a kind of text, or if the bytes are not UTF-8.
    [[nodiscard]] expected<std::string_view> text() const {
        rect_text text;
        rect_error error;
        const auto code = rect_payload_as_text(&raw_, &text, &error);
        return detail::value_or_error<std::string_view>(code, error, [&] { return detail::view(text); });
    }
    /// Returns the payload as a value of type `T`, which the Adapter of `T` reads. Fails with Code::payload if that is not
    /// possible.
    template <class T>
    [[nodiscard]] expected<T> value() const {
        return Adapter<T>::from_payload(*this);
    }
    /// Returns the picture, which may be uncompressed, PNG, JPEG or WebP. Fails with Code::payload if the payload is not a
    /// picture, and with Code::codec if it is damaged or exceeds the limits.
    [[nodiscard]] expected<Picture> picture(Limits limits = {}) const { return Picture::read(raw_, limits); }
    /// Returns the array of numbers, raw or quantised. Fails with Code::payload if the payload is not an array, and with
    /// Code::codec if it is damaged or exceeds the limits.
    [[nodiscard]] expected<Array> array(Limits limits = {}) const { return Array::read(raw_, limits); }

    /// Returns the struct of rect.h.
    [[nodiscard]] const rect_payload& raw() const noexcept { return raw_; }

private:
    rect_payload raw_;
};

/// A payload that owns its bytes.
class Payload {
public:
    /// Takes ownership of the bytes, which are stored in a string, and of their encoding.
    Payload(std::string bytes, std::string encoding) : bytes_(std::move(bytes)), encoding_(std::move(encoding)) {}
    /// Copies a payload.
    explicit Payload(const PayloadView& view)
        : bytes_(reinterpret_cast<const char*>(view.bytes().data()), view.bytes().size()),
          encoding_(view.encoding()) {}

    /// Returns a view, which is valid as long as this object.
    [[nodiscard]] PayloadView view() const noexcept {
        return {{reinterpret_cast<const std::uint8_t*>(bytes_.data()), bytes_.size()}, encoding_};
    }

    /// Makes a payload of JSON that the program has written.
    static Payload json(std::string text) { return {std::move(text), "application/json"}; }

private:
    std::string bytes_;
    std::string encoding_;
};

/// A payload that the library owns: the result of rect::encode, rect::decode or ActionRun::result.
class Buffer {
public:
    /// Takes ownership of a buffer of rect.h.
    explicit Buffer(const rect_buffer& raw) noexcept : handle_(raw.id), payload_(raw.payload) {}
    /// Returns a view, which is valid as long as this object.
    [[nodiscard]] const PayloadView& view() const noexcept { return payload_; }

private:
    Handle handle_;
    PayloadView payload_;
};

/// Encodes a payload with a codec, e.g. `zstd:9`, `jpeg:60`, `webp:60`, `png` or `quantised:0.01`. A handle of
/// Robot::with_codec encodes the payloads of all its messages and requests. Fails with Code::codec if the codec is unknown
/// or does not suit the payload.
[[nodiscard]] inline expected<Buffer> encode(const Text& codec, const PayloadView& payload) {
    rect_buffer buffer;
    rect_error error;
    const auto code = rect_encode(codec.c_str(), &payload.raw(), &buffer, &error);
    return detail::value_or_error<Buffer>(code, error, [&] { return Buffer(buffer); });
}

/// @cond
namespace detail {

// Accepts containers of bytes, but not types that are merely convertible to one, like nlohmann::json.
template <class T, class = void>
inline constexpr bool is_bytes = false;
template <class T>
inline constexpr bool is_bytes<T, std::void_t<decltype(std::declval<const T&>().data())>> =
    std::is_same_v<decltype(std::declval<const T&>().data()), const std::uint8_t*> ||
    std::is_same_v<decltype(std::declval<const T&>().data()), std::uint8_t*>;

/// Writes a number or bool as JSON, independent of the program's locale. Fails with Code::payload for infinity and NaN,
/// which JSON cannot represent.
template <class T>
expected<std::string> number_to_json(T value) {
    if constexpr (std::is_same_v<T, bool>) {
        return std::string(value ? "true" : "false");
    } else if constexpr (std::is_integral_v<T>) {
        return std::to_string(value);
    } else {
        if (!std::isfinite(value)) {
            return failed(Code::payload, "this value cannot be written as JSON: it is infinite or not a number");
        }
        std::string text;
        // Uses the smallest number of digits that gives the same number again.
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
        // A floating-point number must remain one for the receiver.
        return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
    }
}

/// Calls `use` with the value as a payload of rect.h.
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
