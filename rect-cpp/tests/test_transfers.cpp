// Transfers: bytes and files, their progress, and what is not taken.
#include <atomic>
#include <filesystem>
#include <fstream>
#include <thread>

#include "pair.hpp"

namespace {

// A folder of its own, gone with this.
struct Folder {
    std::filesystem::path path;

    Folder() {
        std::string name = (std::filesystem::temp_directory_path() / "rect-XXXXXX").string();
        REQUIRE(mkdtemp(name.data()) != nullptr);
        path = name;
    }
    ~Folder() { std::filesystem::remove_all(path); }
};

rect::TransferOptions in_time() {
    rect::TransferOptions options;
    options.patience = deadline;
    return options;
}

}  // namespace

TEST_CASE("bytes get there whole, with progress") {
    Pair pair;
    rect::ReceiveOptions taking;
    taking.max_bytes = 1 << 20;
    const auto transfers = must(pair.two.receive_transfers("wombat-1/maps/*", taking));
    const std::string map(300'000, 'm');
    std::atomic<std::uint64_t> held{0};
    must(pair.one.transfer("wombat-2", "maps/hall", map, in_time(),
                           [&](const rect::Progress& progress) { held = progress.held_bytes; }));
    CHECK(held == map.size());
    const auto received = must(transfers.next(deadline));
    CHECK(received.from() == "wombat-1");
    CHECK(received.topic() == "maps/hall");
    CHECK(received.size_bytes() == map.size());
    CHECK(received.file().empty());
    CHECK(must(received.payload.text()) == map);
}

TEST_CASE("a file arrives as a file") {
    const Folder folder;
    Pair pair;
    const auto file = folder.path / "map.bin";
    std::ofstream(file) << std::string(100'000, 'f');
    rect::ReceiveOptions taking;
    taking.max_bytes = 1 << 20;
    taking.folder = (folder.path / "received").string();
    const auto transfers = must(pair.two.receive_transfers("*/files", taking));
    must(pair.one.transfer("wombat-2", "files", rect::File{file.string()}, in_time()));
    const auto received = must(transfers.next(deadline));
    CHECK(received.name() == "map.bin");
    CHECK(std::filesystem::file_size(std::string(received.file())) == 100'000);
}

TEST_CASE("what is too large, nowhere, or not given is an error that says so") {
    Pair pair;
    CHECK(pair.two.receive_transfers("*/files", {}).error().code == rect::Code::argument);
    rect::ReceiveOptions taking;
    taking.max_bytes = 100;
    const auto transfers = must(pair.two.receive_transfers("*/files", taking));
    const auto large = pair.one.transfer("wombat-2", "files", std::string(101, 'x'), in_time());
    REQUIRE_FALSE(large.has_value());
    CHECK(large.error().code == rect::Code::transfer_refused);
    CHECK_THAT(large.error().text, Catch::Matchers::ContainsSubstring("100"));
    const auto none = pair.one.transfer("wombat-2", "files", rect::File{"/no/such/file"}, in_time());
    REQUIRE_FALSE(none.has_value());
    CHECK(none.error().code == rect::Code::file);
    CHECK(transfers.next(10ms).error().code == rect::Code::timed_out);
}
