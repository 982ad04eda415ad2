/// @file
/// Publishes and reads values as JSON and CBOR with nlohmann::json: every type that it can convert can be published, and
/// `payload.value<T>()` returns it again.
///
///     struct Reading { double degrees; };
///     NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Reading, degrees)
///     robot.publish("arm/angle", Reading{12.5});
#ifndef RECT_NLOHMANN_HPP
#define RECT_NLOHMANN_HPP

#include <nlohmann/json.hpp>
#include <string>
#include <type_traits>
#include <utility>

#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// Marks a value to be sent as CBOR, which is smaller than JSON: `robot.publish("drive", rect::Cbor(command))`.
template <class T>
struct Cbor {
    /// The value.
    const T& value;
    /// Refers to a value, which must outlive this object.
    explicit Cbor(const T& of) : value(of) {}
};

/// @cond
namespace detail {

/// The maximum nesting depth of a value that is read. Without a limit, a peer could exhaust the stack.
constexpr int max_depth = 128;

/// Parses without storing anything, and stops when the value is nested too deeply.
class Depth : public nlohmann::json::json_sax_t {
    using Json = nlohmann::json;

public:
    bool null() override { return true; }
    bool boolean(bool) override { return true; }
    bool number_integer(Json::number_integer_t) override { return true; }
    bool number_unsigned(Json::number_unsigned_t) override { return true; }
    bool number_float(Json::number_float_t, const Json::string_t&) override { return true; }
    bool string(Json::string_t&) override { return true; }
    bool binary(Json::binary_t&) override { return true; }
    bool start_object(std::size_t) override { return deeper(); }
    bool key(Json::string_t&) override { return true; }
    bool end_object() override { return leave(); }
    bool start_array(std::size_t) override { return deeper(); }
    bool end_array() override { return leave(); }
    bool parse_error(std::size_t, const std::string&, const Json::exception& error) override {
        reason = error.what();
        return false;
    }

    std::string reason = "it is nested too deeply";

private:
    bool deeper() { return ++depth_ <= max_depth; }
    bool leave() {
        --depth_;
        return true;
    }

    int depth_ = 0;
};

inline expected<nlohmann::json> read_json(const PayloadView& payload) {
    using Json = nlohmann::json;
    const auto encoding = payload.encoding();
    const bool is_cbor = encoding == "application/cbor";
    if (!is_cbor && encoding != "application/json" && encoding != "text/json") {
        return failed(Code::payload, "the payload is " + std::string(encoding) + ", but JSON or CBOR is required");
    }
    const auto bytes = payload.bytes();
    const auto* begin = bytes.data();
    const auto* end = begin + bytes.size();
    Depth depth;
    const auto format = is_cbor ? Json::input_format_t::cbor : Json::input_format_t::json;
    if (!Json::sax_parse(begin, end, &depth, format)) {
        return failed(Code::payload, "the payload is not valid " + std::string(encoding) + ": " + depth.reason);
    }
    return is_cbor ? Json::from_cbor(begin, end) : Json::parse(begin, end);
}

template <class T>
using if_json = std::enable_if_t<std::is_constructible_v<nlohmann::json, const T&>>;

}  // namespace detail
/// @endcond

/// Converts every type that nlohmann::json can write and read.
template <class T>
struct Adapter<T, detail::if_json<T>> {
    /// Writes a value as JSON. Fails with Code::payload if it cannot be represented, e.g. because a string is not UTF-8.
    static expected<Payload> to_payload(const T& value) {
        try {
            return Payload::json(nlohmann::json(value).dump());
        } catch (const nlohmann::json::exception& error) {
            return detail::failed(Code::payload, std::string("this value cannot be written as JSON: ") + error.what());
        }
    }
    /// Reads a value from JSON or CBOR, depending on the encoding. Fails with Code::payload if the payload is something
    /// else, is damaged, or does not match the type.
    static expected<T> from_payload(const PayloadView& payload) {
        const auto json = detail::read_json(payload);
        if (!json) {
            return unexpected<Error>(json.error());
        }
        try {
            return json->template get<T>();
        } catch (const nlohmann::json::exception& error) {
            return detail::failed(Code::payload, std::string("the payload does not match the requested type: ") + error.what());
        }
    }
};

/// Writes values as CBOR.
template <class T>
struct Adapter<Cbor<T>, void> {
    /// Writes a value as CBOR. Fails with Code::payload if it cannot be represented.
    static expected<Payload> to_payload(const Cbor<T>& cbor) {
        try {
            std::string bytes;
            nlohmann::json::to_cbor(nlohmann::json(cbor.value), bytes);
            return Payload(std::move(bytes), "application/cbor");
        } catch (const nlohmann::json::exception& error) {
            return detail::failed(Code::payload, std::string("this value cannot be written as CBOR: ") + error.what());
        }
    }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
