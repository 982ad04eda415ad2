// Tests JSON and CBOR with nlohmann::json.
//
//     build/default/tests/rect_tests -# '[#test_json]'
#include <limits>
#include <nlohmann/json.hpp>
#include <numeric>
#include <rect/nlohmann.hpp>
#include <string>

#include "pair.hpp"

namespace {

struct Reading {
    double degrees;
    std::string name;
};
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Reading, degrees, name)

rect::PayloadView view(const std::string& bytes, const char* encoding) {
    return {{reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}, encoding};
}

}  // namespace

TEST_CASE("structs survive a round trip as JSON and as CBOR") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("*/json"));
    const Reading reading{12.5, "arm"};
    const auto json = pair.publish_until_received(subscriber, "json", reading);
    CHECK(json.payload.encoding() == "application/json");
    CHECK(must(json.payload.value<Reading>()).degrees == 12.5);
    CHECK(must(json.payload.value<nlohmann::json>())["name"] == "arm");
    const auto other = must(pair.two.subscribe("*/cbor"));
    const auto cbor = pair.publish_until_received(other, "cbor", rect::Cbor(reading));
    CHECK(cbor.payload.encoding() == "application/cbor");
    CHECK(must(cbor.payload.value<Reading>()).name == "arm");
    const auto numbers = must(pair.two.subscribe("*/number"));
    CHECK(must(pair.publish_until_received(numbers, "number", 42).payload.value<int>()) == 42);
}

TEST_CASE("invalid, mismatched or deeply nested JSON and CBOR is rejected") {
    const auto code = [](const auto& result) { return result.error().code; };
    CHECK(code(view("{", "application/json").value<Reading>()) == rect::Code::payload);
    CHECK(code(view("{}", "application/json").value<Reading>()) == rect::Code::payload);
    CHECK(code(view("{}", "text/plain").value<Reading>()) == rect::Code::payload);
    CHECK(code(view("", "application/cbor").value<nlohmann::json>()) == rect::Code::payload);
    const auto deep_json = view(std::string(1'000'000, '['), "application/json").value<nlohmann::json>();
    CHECK_THAT(deep_json.error().text, ContainsSubstring("too deeply"));
    const auto deep_cbor = view(std::string(1'000'000, '\x81'), "application/cbor").value<nlohmann::json>();
    CHECK_THAT(deep_cbor.error().text, ContainsSubstring("too deeply"));
    // Strings in JSON must be UTF-8.
    CHECK(code(rect::Adapter<std::string>::to_payload("\xff")) == rect::Code::payload);
}

TEST_CASE("a service reads and returns values") {
    Pair pair;
    const auto service = must(pair.two.serve("sum", [](const rect::Request& request) -> rect::expected<int> {
        const auto numbers = request.payload.value<std::vector<int>>();
        if (!numbers) {
            return rect::unexpected<rect::Error>(numbers.error());
        }
        return std::accumulate(numbers->begin(), numbers->end(), 0);
    }));
    rect::expected<rect::Reply> reply = pair.one.request("wombat-2", "sum", std::vector<int>{1, 2, 3}, deadline);
    until([&] {
        if (!reply) {
            reply = pair.one.request("wombat-2", "sum", std::vector<int>{1, 2, 3}, deadline);
        }
        return reply.has_value();
    });
    CHECK(must(reply->payload.value<int>()) == 6);
    const auto refused = pair.one.request("wombat-2", "sum", "not JSON", deadline);
    CHECK(refused.error().code == rect::Code::service);
}
