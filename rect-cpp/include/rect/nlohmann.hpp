/// @file
/// Publishes and reads values as JSON and CBOR with nlohmann::json: every type that it can convert can be published, received with
/// `robot.subscribe<T>`, and read with `payload.value<T>()`.
///
///     struct Reading { double degrees; };
///     NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Reading, degrees)
///     robot.publish("arm/angle", Reading{12.5});
#ifndef RECT_NLOHMANN_HPP
#define RECT_NLOHMANN_HPP

// Lets the errors of nlohmann::json name the place of a value that does not fit. Without effect if the program has included
// nlohmann/json.hpp before.
#ifndef JSON_DIAGNOSTICS
#define JSON_DIAGNOSTICS 1
#endif
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
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
    const bool is_json = encoding == "application/json" || encoding == "text/json";
    if (!is_cbor && !is_json) {
        const auto text = payload.text();
        if (text) {
            return Json(std::string(*text));
        }
        return failed(Code::payload, "the payload is " + std::string(encoding) + ", but JSON, CBOR or text is required");
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

/// Returns a value in words.
inline std::string described(const nlohmann::json& value) {
    constexpr std::size_t max_shown = 60;
    const auto shortened = [](const std::string& text) {
        return text.size() <= max_shown ? text : text.substr(0, max_shown - 3) + "...";
    };
    if (value.is_null()) {
        return "nothing (null)";
    }
    if (value.is_boolean()) {
        return value.get<bool>() ? "true" : "false";
    }
    if (value.is_number()) {
        return "the number " + value.dump();
    }
    if (value.is_string()) {
        return "the text '" + shortened(value.get_ref<const std::string&>()) + "'";
    }
    if (value.is_array()) {
        return "a list of " + std::to_string(value.size());
    }
    if (value.is_binary()) {
        return std::to_string(value.get_binary().size()) + " bytes";
    }
    std::string names;
    for (auto field = value.begin(); field != value.end() && names.size() <= max_shown; ++field) {
        names += (names.empty() ? "" : ", ") + field.key();
    }
    return names.empty() ? "an empty object" : "an object with the fields " + shortened(names);
}

/// Returns in words why a value does not fit a type, as the other languages do: "field percent: expected a number, found the text
/// 'full'". `what` is the text of nlohmann::json, such as "[json.exception.type_error.302] (/percent) type must be number, but is
/// string".
inline std::string mismatch(const nlohmann::json& value, const std::string& what) {
    const auto between = [&](std::string_view start, std::string_view end) -> std::string {
        const auto begin = what.find(start);
        if (begin == std::string::npos) {
            return {};
        }
        const auto from = begin + start.size();
        return what.substr(from, what.find(end, from) - from);
    };
    const auto place = between("] (", ") ");
    const nlohmann::json* part = &value;
    std::string field;
    if (!place.empty()) {
        nlohmann::json::json_pointer rest(place);
        std::vector<std::string> steps;
        for (; !rest.empty(); rest.pop_back()) {
            steps.push_back(rest.back());
        }
        for (auto step = steps.rbegin(); step != steps.rend(); ++step) {
            const bool is_index = part->is_array();
            part = is_index ? &part->at(std::stoul(*step)) : &part->at(*step);
            field += is_index ? "[" + *step + "]" : (field.empty() ? "" : ".") + *step;
        }
    }
    const auto missing = between("key '", "' not found");
    if (!missing.empty()) {
        return "field " + field + (field.empty() ? "" : ".") + missing + ": expected a value, found no such field";
    }
    const auto found = ", found " + described(*part);
    const auto start = field.empty() ? std::string() : "field " + field + ": ";
    const auto type = between("type must be ", ", but is ");
    if (type.empty()) {
        return start + "expected another value (" + what.substr(what.find("] ") + 2) + ")" + found;
    }
    const std::pair<std::string_view, const char*> words[] = {
        {"number", "a number"}, {"string", "text"},      {"boolean", "true or false"},
        {"array", "a list"},    {"object", "an object"}, {"null", "nothing (null)"},
    };
    for (const auto& [name, expected] : words) {
        if (name == type) {
            return start + "expected " + expected + found;
        }
    }
    return start + "expected " + type + found;
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
    /// Reads a value from JSON, CBOR or text, depending on the encoding. Fails with Code::payload if the payload is something
    /// else, is damaged, or does not fit the type; the text names the field then.
    static expected<T> from_payload(const PayloadView& payload) {
        const auto json = detail::read_json(payload);
        if (!json) {
            return unexpected<Error>(json.error());
        }
        try {
            return json->template get<T>();
        } catch (const nlohmann::json::exception& error) {
            return detail::failed(Code::payload, detail::mismatch(*json, error.what()));
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
