// Runs the test vectors of tests/conformance, which every language must pass. Keys and attachments are left out: the Rust
// library creates them for C++ programs.
//
//     build/default/tests/rect_tests -# '[#test_conformance]'
#include <cstdlib>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "pair.hpp"

namespace {

using Json = nlohmann::json;

// The limits that all vectors assume.
constexpr rect::Limits limits{65'536, 4096};

Json cases(const std::string& file) {
    std::ifstream stream(std::string(RECT_VECTORS) + "/" + file + ".json");
    const auto all = Json::parse(stream)["cases"];
    REQUIRE_FALSE(all.empty());
    return all;
}

std::string bytes(const Json& hex) {
    const auto text = hex.get<std::string>();
    std::string all;
    for (std::size_t n = 0; n + 1 < text.size(); n += 2) {
        all.push_back(static_cast<char>(std::stoi(text.substr(n, 2), nullptr, 16)));
    }
    return all;
}

std::string hex(rect::span<const std::uint8_t> bytes) {
    static constexpr char digits[] = "0123456789abcdef";
    std::string text;
    for (const auto byte : bytes) {
        text += digits[byte >> 4];
        text += digits[byte & 15];
    }
    return text;
}

rect::Payload payload(const Json& in) { return {bytes(in["bytes"]), in["encoding"].get<std::string>()}; }

// Returns whether a code belongs to the kind of error that a vector expects. The vectors distinguish more kinds than there
// are codes.
bool is_error(const Json& out, rect::Code code) {
    const auto kind = out["error"].get<std::string>();
    const bool is_payload = kind == "other" || kind == "read" || kind == "write";
    return code == (is_payload ? rect::Code::payload : rect::Code::codec);
}

}  // namespace

TEST_CASE("names, topics and patterns are validated") {
    using Check = rect_code (*)(const char*, rect_error*);
    const std::map<std::string, Check> checks{
        {"names", rect_check_name}, {"topics", rect_check_topic}, {"patterns", rect_check_pattern}};
    for (const auto& [file, check] : checks) {
        for (const auto& vector : cases(file)) {
            CAPTURE(file, vector["in"]);
            const auto text = vector["in"].get<std::string>();
            const bool is_valid = vector["out"].is_boolean() ? vector["out"].get<bool>() : !vector["out"].is_null();
            rect_error error;
            CHECK((check(text.c_str(), &error) == RECT_CODE_OK) == is_valid);
        }
    }
}

TEST_CASE("codecs have the expected names") {
    for (const auto& vector : cases("codecs")) {
        CAPTURE(vector["in"]);
        rect_string name;
        rect_error error;
        const auto code = rect_codec_name(vector["in"].get<std::string>().c_str(), &name, &error);
        if (vector["out"].is_object()) {
            CHECK(is_error(vector["out"], static_cast<rect::Code>(code)));
        } else {
            REQUIRE(code == RECT_CODE_OK);
            const rect::Handle handle(name.id);
            CHECK(rect::detail::view(name.text) == vector["out"].get<std::string>());
        }
    }
}

TEST_CASE("dictionaries have the expected ids") {
    for (const auto& vector : cases("dictionaries")) {
        const auto all = bytes(vector["in"]);
        const auto dictionary = rect::Dictionary::read({reinterpret_cast<const std::uint8_t*>(all.data()), all.size()});
        CHECK(dictionary.has_value() == !vector["out"].is_null());
        if (dictionary) {
            CHECK(must(dictionary->id()) == vector["out"].get<std::uint32_t>());
        }
    }
}

TEST_CASE("encoded payloads are decoded") {
    for (const auto& vector : cases("compressed")) {
        const auto& in = vector["in"];
        std::optional<rect::Dictionary> dictionary;
        if (in.contains("dictionary") && !in["dictionary"].is_null()) {
            const auto all = bytes(in["dictionary"]);
            dictionary = must(rect::Dictionary::read({reinterpret_cast<const std::uint8_t*>(all.data()), all.size()}));
        }
        const auto encoded = payload(in);
        const auto decoded = rect::decode(encoded.view(), dictionary ? &*dictionary : nullptr, limits);
        CAPTURE(in["encoding"], vector["out"]);
        if (vector["out"].contains("error")) {
            REQUIRE_FALSE(decoded.has_value());
            CHECK(is_error(vector["out"], decoded.error().code));
        } else {
            CHECK(must(decoded ? rect::expected<std::string>(hex(decoded->view().bytes())) : rect::unexpected<rect::Error>(decoded.error())) ==
                  vector["out"]["bytes"].get<std::string>());
            CHECK(decoded->view().encoding() == vector["out"]["encoding"].get<std::string>());
        }
    }
}

TEST_CASE("pictures are read") {
    for (const auto& vector : cases("pictures")) {
        const auto& out = vector["out"];
        const auto encoded = payload(vector["in"]);
        const auto picture = encoded.view().picture(limits);
        CAPTURE(vector["in"]["encoding"], out.contains("error"));
        if (out.contains("error")) {
            REQUIRE_FALSE(picture.has_value());
            CHECK(is_error(out, picture.error().code));
            continue;
        }
        REQUIRE(picture.has_value());
        CHECK(picture->width() == out["width"].get<std::uint32_t>());
        CHECK(picture->height() == out["height"].get<std::uint32_t>());
        const std::map<std::string, rect::Format> formats{
            {"grey8", rect::Format::grey8}, {"rgb8", rect::Format::rgb8}, {"rgba8", rect::Format::rgba8}};
        CHECK(picture->format() == formats.at(out["format"].get<std::string>()));
        const auto expected = bytes(out["pixels"]);
        REQUIRE(picture->pixels().size() == expected.size());
        // Decoders of lossy pictures round differently.
        int difference = 0;
        for (std::size_t n = 0; n < expected.size(); ++n) {
            difference = std::max(difference, std::abs(int(picture->pixels()[n]) - int(static_cast<std::uint8_t>(expected[n]))));
        }
        CHECK(difference <= (out["off"].is_null() ? 0 : out["off"].get<int>()));
    }
}

TEST_CASE("arrays are read") {
    const char* const elements[] = {"u8", "i8", "u16", "i16", "u32", "i32", "i64", "f32", "f64"};
    for (const auto& vector : cases("arrays")) {
        const auto& out = vector["out"];
        const auto encoded = payload(vector["in"]);
        const auto array = encoded.view().array(limits);
        CAPTURE(vector["in"]["encoding"]);
        if (out.contains("error")) {
            REQUIRE_FALSE(array.has_value());
            CHECK(is_error(out, array.error().code));
            continue;
        }
        REQUIRE(array.has_value());
        CHECK(elements[array->element()] == out["element"].get<std::string>());
        CHECK(Json(std::vector<std::size_t>(array->shape().begin(), array->shape().end())) == out["shape"]);
        CHECK(hex(array->bytes()) == out["bytes"].get<std::string>());
    }
}
