// Tests groups of parameters: values, changes of this program and of others, refusals, checks, and the file.
//
//     build/default/tests/rect_tests -# '[#test_parameters]'
#include <atomic>
#include <limits>
#include <optional>
#include <rect/nlohmann.hpp>
#include <string>
#include <thread>
#include <vector>

#include "folder.hpp"
#include "pair.hpp"

namespace {

struct Drive {
    double kp = 1.0;
    std::string side = "left";
    bool turbo = false;
    std::uint8_t steps = 3;
    std::vector<double> points{1, 2};
    std::string serial = "none";
};

rect::Fields<Drive> drive_fields() {
    return rect::fields<Drive>()
        .field("kp", &Drive::kp)
        .range(0, 10)
        .unit("1/s")
        .about("gain of the heading")
        .field("side", &Drive::side)
        .choices({"left", "right"})
        .field("turbo", &Drive::turbo)
        .field("steps", &Drive::steps)
        .field("points", &Drive::points)
        .min(0)
        .field("serial", &Drive::serial)
        .read_only();
}

rect::ParameterOptions<Drive> without_file() {
    rect::ParameterOptions<Drive> options;
    options.without_file = true;
    return options;
}

// Declares the group as a program of wombat-1, which wombat-2 can change when this returns.
rect::ParameterGroup<Drive> declared(const Pair& pair, const rect::ParameterOptions<Drive>& options = without_file()) {
    auto group = must(pair.one.parameters("drive", drive_fields(), options));
    must(pair.one.wait_until_established(deadline));
    return group;
}

rect::Error refusal(const rect::expected<rect::ParameterValues>& outcome) {
    REQUIRE_FALSE(outcome.has_value());
    return outcome.error();
}

}  // namespace

TEST_CASE("parameters have the defaults of the struct, and are read like fields") {
    Pair pair;
    const auto drive = declared(pair);
    const auto values = must(drive.get());
    CHECK(values.kp == 1.0);
    CHECK(values.side == "left");
    CHECK_FALSE(values.turbo);
    CHECK(values.steps == 3);
    CHECK(values.points == std::vector<double>{1, 2});
    CHECK(drive.get()->serial == "none");
}

TEST_CASE("the parameters of another robot are listed") {
    Pair pair;
    const auto drive = declared(pair);
    std::vector<rect::DeclaredParameter> all;
    until([&] {
        auto found = pair.two.declared_parameters("wombat-1");
        all = found ? std::move(*found) : std::vector<rect::DeclaredParameter>();
        return all.size() == 6;
    });
    CHECK(all[0].group == "drive");
    CHECK(all[0].name == "kp");
    CHECK(all[0].default_value == 1.0);
    CHECK(all[0].min == 0.0);
    CHECK(all[0].max == 10.0);
    CHECK(all[0].unit == "1/s");
    CHECK(all[0].about == "gain of the heading");
    CHECK_FALSE(all[0].read_only);
    CHECK(all[1].choices == std::vector<std::string>{"left", "right"});
    CHECK(all[4].default_value == std::vector<double>{1, 2});
    CHECK_FALSE(all[4].max);
    CHECK(all[5].read_only);
    CHECK(must(pair.two.declared_parameters()).empty());
    CHECK(pair.two.declared_parameters("a b").error().code == rect::Code::name);
}

TEST_CASE("parameters are set from another robot, all or none") {
    Pair pair;
    std::optional<rect::ParameterChange> reported;
    Flag is_reported;
    auto options = without_file();
    options.on_change = [&](const Drive& values, const rect::ParameterChange& change) {
        // A function may use all of RECT.
        must(pair.one.publish("kp", values.kp));
        if (!is_reported.wait(0ms)) {
            reported = change;
            is_reported.set();
        }
    };
    const auto drive = declared(pair, options);
    const auto in_force = must(pair.two.set_parameters("wombat-1", "drive", {{"kp", 2}, {"side", "right"}}));
    CHECK(in_force == rect::ParameterValues{{"kp", 2.0}, {"side", "right"}});
    CHECK(drive.get()->kp == 2.0);
    CHECK(drive.get()->side == "right");
    REQUIRE(is_reported.wait());
    REQUIRE(reported->changed.size() == 2);
    CHECK(reported->changed[0].name == "kp");
    CHECK(reported->changed[0].before == 1.0);
    CHECK(reported->changed[0].after.number() == 2.0);
    CHECK(reported->changed[1].after.text() == "right");
    CHECK_THAT(reported->by, ContainsSubstring("wombat-2/"));

    // One value is invalid, and the others are not changed.
    const auto refused = refusal(pair.two.set_parameters("wombat-1", "drive", {{"kp", 11.0}, {"turbo", true}}));
    CHECK(refused.code == rect::Code::service);
    CHECK_THAT(refused.text, ContainsSubstring("kp cannot be 11: the maximum is 10 1/s"));
    CHECK_FALSE(drive.get()->turbo);
    const std::pair<rect::ParameterValues, const char*> wrong[] = {
        {{{"kp", std::numeric_limits<double>::quiet_NaN()}}, "finite"},
        {{{"kp", "fast"}}, "it must be a number, not a text"},
        {{{"side", "lef"}}, "did you mean left?"},
        {{{"steps", 256}}, "the maximum is 255"},
        {{{"points", std::vector<double>{-1}}}, "the minimum is 0"},
        {{{"serial", "7"}}, "serial is read-only"},
        {{{"ki", 1}}, "there is no parameter \"ki\""},
    };
    for (const auto& [values, reason] : wrong) {
        CHECK_THAT(refusal(pair.two.set_parameters("wombat-1", "drive", values)).text, ContainsSubstring(reason));
    }
    must(pair.two.set_parameters("wombat-1", "drive", {{"steps", 255}, {"points", std::vector<double>{}}}));
    CHECK(drive.get()->steps == 255);
    CHECK(drive.get()->points.empty());
    CHECK(must(pair.two.reset_parameters("wombat-1", "drive", {"steps"})) == rect::ParameterValues{{"steps", 3}});
    CHECK(must(pair.two.reset_parameters("wombat-1", "drive")).size() == 6);
    CHECK(drive.get()->side == "left");
}

TEST_CASE("a program sets its own parameters, also read-only ones, and others read them as state") {
    Pair pair;
    const auto values = must(pair.two.subscribe<nlohmann::json>("wombat-1/parameters/drive"));
    const auto drive = declared(pair);
    CHECK(must(must(values.next(deadline)).value()).at("values").at("kp") == 1.0);
    must(drive.set("serial", "w7"));
    must(drive.set({{"kp", 3}, {"turbo", true}}));
    CHECK(drive.get()->serial == "w7");
    CHECK(drive.get()->turbo);
    const auto refused = drive.set("kp", -1);
    REQUIRE_FALSE(refused.has_value());
    CHECK(refused.error().code == rect::Code::parameters);
    CHECK_THAT(refused.error().text, ContainsSubstring("the minimum is 0"));
    until([&] {
        const auto message = must(values.next(deadline));
        return must(message.value()).at("values").at("kp") == 3.0;
    });
    must(drive.reset({"serial", "kp"}));
    CHECK(drive.get()->serial == "none");
    CHECK(drive.get()->turbo);
}

TEST_CASE("a check refuses values with a reason") {
    static std::atomic<int> reported{0};
    reported = 0;
    rect::on_callback_error([](const char*) noexcept { ++reported; });
    Pair pair;
    rect::ParameterGroup<Drive> drive;
    auto options = without_file();
    std::optional<rect::Error> own;
    Flag has_tried;
    options.check = [&](const Drive& values) {
        if (values.turbo && values.kp > 5) {
            throw rect::Refusal("turbo needs a kp of at most 5");
        }
        if (values.steps == 13) {
            throw std::runtime_error("test");
        }
        if (values.steps == 14) {
            own = drive.set("turbo", true).error();
            has_tried.set();
        }
    };
    drive = declared(pair, options);
    must(pair.two.set_parameters("wombat-1", "drive", {{"kp", 6}}));
    const auto refused = refusal(pair.two.set_parameters("wombat-1", "drive", {{"turbo", true}}));
    CHECK(refused.code == rect::Code::service);
    CHECK_THAT(refused.text, ContainsSubstring("turbo needs a kp of at most 5"));
    CHECK(drive.set("turbo", true).error().text == "turbo needs a kp of at most 5");
    CHECK_FALSE(drive.get()->turbo);
    CHECK_THAT(refusal(pair.two.set_parameters("wombat-1", "drive", {{"steps", 13}})).text, ContainsSubstring("internal error"));
    CHECK(reported == 1);
    must(pair.two.set_parameters("wombat-1", "drive", {{"steps", 14}}));
    REQUIRE(has_tried.wait());
    CHECK(own->text == "a check cannot change parameters");
    rect::on_callback_error(nullptr);
}

TEST_CASE("a restart keeps the values") {
    Folder folder;
    rect::ParameterOptions<Drive> options;
    options.file = folder / "drive.json";
    Pair pair;
    {
        const auto drive = declared(pair, options);
        rect::SetOptions stored;
        stored.stored = true;
        must(pair.two.set_parameters("wombat-1", "drive", {{"kp", 4}}, stored));
        CHECK(std::filesystem::exists(options.file));
        must(drive.set("side", "right"));
    }
    const auto drive = declared(pair, options);
    CHECK(drive.get()->kp == 4);
    CHECK(drive.get()->side == "right");
}

TEST_CASE("errors of parameters have codes") {
    Pair pair;
    rect::SetOptions stored;
    stored.stored = true;
    const auto drive = declared(pair);
    const auto not_stored = refusal(pair.two.set_parameters("wombat-1", "drive", {{"kp", 7}}, stored));
    CHECK(not_stored.code == rect::Code::not_stored);
    CHECK(drive.get()->kp == 7);
    CHECK(refusal(pair.two.set_parameters("wombat-1", "arm", {{"kp", 7}})).code == rect::Code::no_parameters);
    CHECK(refusal(pair.two.set_parameters("wombat-1", "a b", {{"kp", 7}})).code == rect::Code::parameters);
    CHECK(refusal(pair.two.set_parameters("a b", "drive", {{"kp", 7}})).code == rect::Code::name);
    const auto second = pair.one.parameters("drive", drive_fields(), without_file());
    REQUIRE_FALSE(second.has_value());
    CHECK(second.error().code == rect::Code::service_refused);
    const auto invalid = pair.one.parameters("arm", rect::fields<Drive>().field("kp", &Drive::kp).range(2, 3));
    REQUIRE_FALSE(invalid.has_value());
    CHECK(invalid.error().code == rect::Code::parameters);
    CHECK_THAT(invalid.error().text, ContainsSubstring("the default: kp cannot be 1"));
    CHECK_THROWS_AS(rect::fields<Drive>().unit("m"), std::logic_error);
    CHECK(rect::ParameterGroup<Drive>().get().error().code == rect::Code::handle);
}

TEST_CASE("a function can end its own group, and objects that it captured are released") {
    Pair pair;
    const auto count = std::make_shared<int>(0);
    {
        rect::ParameterGroup<Drive> drive;
        Flag ended;
        auto options = without_file();
        options.on_change = [&, count](const Drive&, const rect::ParameterChange&) {
            drive.drop();
            ended.set();
        };
        drive = declared(pair, options);
        options = {};
        CHECK(count.use_count() == 2);
        must(pair.two.set_parameters("wombat-1", "drive", {{"kp", 2}}));
        REQUIRE(ended.wait());
        until([&] { return count.use_count() == 1; });
        CHECK(drive.get().error().code == rect::Code::handle);
    }
    auto options = without_file();
    options.check = [count](const Drive&) {};
    CHECK_FALSE(pair.one.parameters("a b", drive_fields(), options).has_value());
    options = {};
    CHECK(count.use_count() == 1);
}
