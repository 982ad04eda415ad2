/// @file
/// Publishes and reads values as JSON and CBOR with nlohmann::json: every type that it can convert can be published, received with
/// `robot.subscribe<T>`, and read with `payload.value<T>()`.
///
///     struct Reading { double degrees; };
///     NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Reading, degrees)
///     robot.publish("arm/angle", Reading{12.5});
#ifndef RECT_NLOHMANN_HPP
#define RECT_NLOHMANN_HPP

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

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
    const auto kind = payload.kind();
    if (!kind) {
        return unexpected<Error>(kind.error());
    }
    const bool is_cbor = *kind == EncodingKind::cbor;
    if (!is_cbor && *kind != EncodingKind::json) {
        const auto text = payload.text();
        if (text) {
            return Json(std::string(*text));
        }
        return failed(Code::payload, "the payload is " + std::string(encoding) + ", but JSON, CBOR or text in UTF-8 is required");
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

using Pointer = nlohmann::json::json_pointer;

/// Returns the text of nlohmann::json for a value that does not fit the type, without its number; empty if it fits.
template <class T>
std::string misfit(const nlohmann::json& value) {
    try {
        (void)value.get<T>();
        return {};
    } catch (const nlohmann::json::exception& error) {
        const std::string_view text = error.what();
        return std::string(text.substr(text.find("] ") + 2));
    }
}

/// The largest value, in parts and in bytes of its payload, of which the part that does not fit is searched for. The search
/// converts the value several times for each part, and a peer must not make a program slow.
constexpr std::size_t max_parts = 200;
constexpr std::size_t max_searched_bytes = 4096;

/// Returns the places of the parts of a value, at most `max_parts`.
inline void list_parts(const nlohmann::json& part, const Pointer& place, std::vector<Pointer>& places) {
    if (places.size() == max_parts) {
        return;
    }
    places.push_back(place);
    if (part.is_object()) {
        for (auto field = part.begin(); field != part.end(); ++field) {
            list_parts(field.value(), place / field.key(), places);
        }
    } else if (part.is_array()) {
        for (std::size_t index = 0; index < part.size(); ++index) {
            list_parts(part[index], place / index, places);
        }
    }
}

/// Returns the part of a value that does not fit; the value itself if that is not known. nlohmann::json says which type was
/// expected, but not where (except with JSON_DIAGNOSTICS, which costs memory, and warnings of GCC 12). So values of other types
/// are put in place of each part: a part that fits is replaced by none without an error about it.
template <class T>
Pointer misfit_place(nlohmann::json value, const std::string& error) {
    const auto ends_with = [](const std::string& text, const nlohmann::json& part) {
        const auto end = std::string(" ") + part.type_name();
        return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
    };
    std::vector<Pointer> places;
    list_parts(value, Pointer(), places);
    if (places.size() == max_parts) {
        return Pointer();
    }
    const nlohmann::json others[] = {0, "", true, nullptr, nlohmann::json::array(), nlohmann::json::object()};
    for (const auto& place : places) {
        const auto part = value.at(place);
        bool is_read = false;
        bool is_replaceable = false;
        for (const auto& other : others) {
            // A number may also be read from true or false.
            const bool is_number = part.is_number() && other.is_boolean() && error.find("must be boolean") == std::string::npos;
            if (!ends_with(error, part) || std::string_view(other.type_name()) == part.type_name() || is_number) {
                continue;
            }
            value[place] = other;
            const auto now = misfit<T>(value);
            is_read |= now != error;
            is_replaceable |= !ends_with(now, other);
        }
        value[place] = part;
        if (is_read && is_replaceable) {
            return place;
        }
    }
    return Pointer();
}

/// Returns a text as valid UTF-8, with control characters escaped: CBOR may contain any bytes, and shortening may cut a character.
inline std::string printable(const std::string& text) {
    const auto quoted = nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
    return quoted.substr(1, quoted.size() - 2);
}

/// Returns in words why a value does not fit a type, as the other languages do: `field percent: expected a number, found the text
/// 'full'`. `bytes` is the size of its payload.
template <class T>
std::string mismatch(const nlohmann::json& value, std::size_t bytes) {
    const auto error = misfit<T>(value);
    const auto between = [&](std::string_view start, std::string_view end) -> std::string {
        const auto begin = error.find(start);
        const auto from = begin + start.size();
        return begin == std::string::npos ? std::string() : error.substr(from, error.find(end, from) - from);
    };
    auto place = bytes <= max_searched_bytes ? misfit_place<T>(value, error) : Pointer();
    const nlohmann::json& part = value.at(place);
    std::string field;
    for (; !place.empty(); place.pop_back()) {
        const bool is_index = value.at(place.parent_pointer()).is_array();
        const auto step = is_index ? "[" + place.back() + "]" : place.back();
        field = step + (field.empty() || field.front() == '[' ? "" : ".") + field;
    }
    const auto missing = between("key '", "' not found");
    if (!missing.empty()) {
        return "field " + missing + ": expected a value, found no such field";
    }
    // The macros for structs read fields with `at` and `value`.
    const auto type = error.find("cannot use ") == std::string::npos ? between("type must be ", ", but is ") : "object";
    auto expected = type.empty() ? "another value (" + error + ")" : type;
    const std::pair<std::string_view, const char*> words[] = {
        {"number", "a number"}, {"string", "text"},      {"boolean", "true or false"},
        {"array", "a list"},    {"object", "an object"}, {"null", "nothing (null)"},
    };
    for (const auto& [name, in_words] : words) {
        if (name == type) {
            expected = in_words;
        }
    }
    return (field.empty() ? "" : "field " + field + ": ") + "expected " + expected + ", found " + described(part);
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
        } catch (const nlohmann::json::exception&) {
            return detail::failed(Code::payload, detail::printable(detail::mismatch<T>(*json, payload.bytes().size())));
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
