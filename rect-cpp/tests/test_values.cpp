// Tests values (text, bytes, numbers, pictures, arrays) and the small parts of the headers.
//
//     build/default/tests/rect_tests -# '[#test_values]'
#include <array>
#include <limits>
#include <vector>

#include "pair.hpp"

static_assert(!std::is_copy_constructible_v<rect::Robot> && std::is_nothrow_move_constructible_v<rect::Robot>);
static_assert(!std::is_copy_constructible_v<rect::Message> && std::is_nothrow_move_assignable_v<rect::Message>);

TEST_CASE("text and bytes survive a round trip") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("*/v"));
    const std::vector<std::uint8_t> bytes{0, 1, 255};
    CHECK(must(pair.publish_until_received(subscriber, "v", "hä").payload.text()) == "hä");
    const auto other = must(pair.two.subscribe("*/b"));
    const auto message = pair.publish_until_received(other, "b", bytes);
    CHECK(message.payload.encoding() == "zenoh/bytes");
    CHECK(std::equal(bytes.begin(), bytes.end(), message.payload.bytes().begin(), message.payload.bytes().end()));
    const auto error = message.payload.text().error();
    CHECK(error.code == rect::Code::payload);
    CHECK_THAT(error.text, ContainsSubstring("zenoh/bytes, but text in UTF-8 is required"));
}

namespace {

// Returns the payload with which a number is published.
template <class T>
std::string published(T value) {
    std::string text;
    must(rect::detail::with_payload(value, [&](const rect_payload& payload) -> rect::expected<void> {
        CHECK(rect::detail::view(payload.encoding) == "application/json");
        text.assign(static_cast<const char*>(payload.data), payload.len);
        return {};
    }));
    return text;
}

}  // namespace

TEST_CASE("numbers and bools are published as equivalent JSON") {
    CHECK(published(12.5) == "12.5");
    CHECK(published(0.1) == "0.1");
    CHECK(published(0.1F) == "0.1");
    CHECK(published(5.0) == "5.0");
    CHECK(published(1.0 / 3) == "0.3333333333333333");
    CHECK(published(-1e300) == "-1e+300");
    CHECK(published(42) == "42");
    CHECK(published(std::numeric_limits<std::uint64_t>::max()) == "18446744073709551615");
    CHECK(published(true) == "true");
    const auto nothing = [](const rect_payload&) -> rect::expected<void> { return {}; };
    const auto none = rect::detail::with_payload(std::numeric_limits<double>::quiet_NaN(), nothing);
    CHECK(none.error().code == rect::Code::payload);
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("*/angle"));
    CHECK(must(pair.publish_until_received(subscriber, "angle", 12.5).payload.text()) == "12.5");
}

TEST_CASE("arrays survive a round trip with their shape") {
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("*/scan"));
    const std::array<float, 6> scan{1.5F, -2, 3, 4, 5, 6e9F};
    const auto message = pair.publish_until_received(subscriber, "scan", must(rect::numbers(scan, {2, 3})));
    CHECK(message.payload.encoding() == "application/octet-stream;array;f32;2x3");
    const auto array = must(message.payload.array());
    REQUIRE(array.shape().size() == 2);
    CHECK(array.shape()[1] == 3);
    const auto numbers = array.numbers<float>();
    CHECK(std::equal(scan.begin(), scan.end(), numbers.begin(), numbers.end()));
    CHECK(array.numbers<double>().empty());
    CHECK(rect::numbers(scan, {2, 2}).error().code == rect::Code::codec);
    CHECK(must(rect::numbers(std::vector<std::int64_t>{1, 2})).view().encoding() == "application/octet-stream;array;i64;2");
}

TEST_CASE("pictures are encoded and decoded") {
    const std::vector<std::uint8_t> pixels(16 * 8, 200);
    const rect::Picture picture(16, 8, rect::Format::grey8, pixels);
    Pair pair;
    const auto subscriber = must(pair.two.subscribe("*/photo"));
    const auto raw = pair.publish_until_received(subscriber, "photo", picture);
    const auto png = must(rect::encode("png", raw.payload));
    CHECK(png.view().encoding() == "image/png");
    const auto read = must(png.view().picture());
    CHECK(read.width() == 16);
    CHECK(read.height() == 8);
    CHECK(read.format() == rect::Format::grey8);
    CHECK(std::equal(pixels.begin(), pixels.end(), read.pixels().begin(), read.pixels().end()));
    CHECK(png.view().picture({0, 100}).error().code == rect::Code::codec);
    CHECK(png.view().array().error().code == rect::Code::payload);
}

TEST_CASE("a span refers to arrays and containers") {
    const int array[] = {1, 2, 3};
    std::vector<int> vector{4, 5};
    const rect::span<const int> of_array = array;
    const rect::span<int> of_vector = vector;
    const rect::span<const int> of_const = static_cast<const std::vector<int>&>(vector);
    CHECK(of_array.size() == 3);
    CHECK(of_array.back() == 3);
    of_vector[0] = 7;
    CHECK(of_const.front() == 7);
    CHECK(of_const.size_bytes() == 8);
    CHECK(rect::span<const int>().empty());
    int sum = 0;
    for (const int number : of_array) {
        sum += number;
    }
    CHECK(sum == 6);
}

TEST_CASE("timeouts are converted and limited") {
    CHECK(rect::detail::ms(-5ms) == 0);
    CHECK(rect::detail::ms(7s) == 7000);
    CHECK(rect::detail::ms(std::chrono::hours(24 * 365)) == RECT_FOREVER - 1);
    CHECK(rect::detail::ms(rect::forever) == RECT_FOREVER);
    CHECK(std::string(rect::version()) == "0.1.0");
}
