// Tests recordings: their files, their counts, and what is refused.
//
//     build/default/tests/rect_tests -# '[#test_recorder]'
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <thread>

#include "folder.hpp"
#include "pair.hpp"

namespace {

// Returns whether a file has lines of a log: it names their schema in its summary.
bool has_lines(const std::filesystem::path& file) {
    std::ifstream opened(file, std::ios::binary);
    const std::string content{std::istreambuf_iterator<char>(opened), {}};
    return content.find("foxglove.Log") != std::string::npos;
}

// Returns whether a complete file of a recording that runs has lines.
bool has_recorded_lines(const std::filesystem::path& folder) {
    const std::filesystem::directory_iterator files(folder);
    return std::any_of(begin(files), end(files), [](const auto& file) { return has_lines(file.path()); });
}

}  // namespace

TEST_CASE("a program records what its robot publishes") {
    Folder folder;
    Pair pair;
    const auto file = folder / "match.mcap";
    auto recorder = must(pair.one.record(file));
    until([&] {
        must(pair.one.publish("arm/angle", 12.5));
        return must(recorder.progress()).recorded >= 3;
    });
    const auto again = pair.one.record(file);
    REQUIRE_FALSE(again);
    CHECK(again.error().code == rect::Code::recording);
    const auto last = must(recorder.finish());
    CHECK(last.recorded >= 3);
    CHECK(last.bytes >= 3 * 4);
    CHECK(last.dropped == 0);
    CHECK(last.problem.empty());
    std::ifstream written(file, std::ios::binary);
    std::string magic(5, ' ');
    written.read(magic.data(), 5);
    CHECK(magic == "\x89MCAP");
    CHECK(recorder.progress().error().code == rect::Code::closed);
    CHECK(recorder.finish().error().code == rect::Code::closed);
}

TEST_CASE("a recording selects messages, and is split") {
    Folder folder;
    Pair pair;
    rect::RecordOptions options;
    options.patterns = {"wombat-1/large"};
    options.split_bytes = 1000;
    auto recorder = must(pair.one.record(folder / "match.mcap", options));
    // Two of them fill a part of the folder, which is then larger than a file may be.
    const rect::Payload large(std::string(4'200'000, 'x'), "zenoh/bytes");
    for (std::uint64_t count = 1; count <= 3; ++count) {
        must(pair.one.publish("other", 1));
        must(pair.one.publish("large", large));
        until([&] { return must(recorder.progress()).recorded == count; });
    }
    CHECK(must(recorder.finish()).recorded == 3);
    CHECK(std::filesystem::exists(folder / "match-1.mcap"));
    CHECK(std::filesystem::exists(folder / "match-2.mcap"));
    CHECK_FALSE(std::filesystem::exists(folder / "match-3.mcap"));
}

TEST_CASE("lines are recorded unless they are left out") {
    Folder folder;
    Pair pair;
    rect::RecordOptions options;
    auto with = must(pair.one.record(folder / "with.mcap", options));
    options.without_logs = true;
    auto without = must(pair.one.record(folder / "without.mcap", options));
    until([&] {
        must(pair.one.publish("arm/angle", 12.5));
        pair.one.log(rect::Level::warn, "the gripper is slow");
        std::this_thread::sleep_for(retry_interval);
        return has_recorded_lines(folder / "with.segments");
    });
    must(with.finish());
    CHECK(must(without.finish()).recorded > 0);
    CHECK(has_lines(folder / "with.mcap"));
    CHECK_FALSE(has_lines(folder / "without.mcap"));
}

TEST_CASE("invalid recordings are refused") {
    Folder folder;
    Pair pair;
    CHECK(pair.one.record(folder / "none/match.mcap").error().code == rect::Code::recording);
    rect::RecordOptions options;
    options.patterns = {"no pattern"};
    const auto refused = pair.one.record(folder / "match.mcap", options);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == rect::Code::topic);
}
