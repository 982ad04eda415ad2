// Transfers: bytes and files, their progress, and what is not taken.
#include <atomic>
#include <filesystem>
#include <fstream>
#include <future>
#include <memory>
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

TEST_CASE("a transfer that is waited for by nobody goes on, and its end is told once") {
    Pair pair;
    rect::ReceiveOptions taking;
    taking.max_bytes = 1 << 20;
    const auto transfers = must(pair.two.receive_transfers("*/map", taking));
    const auto transfer = must(pair.one.begin_transfer("wombat-2", "map", std::string(300'000, 'm'), in_time()));
    CHECK(must(transfers.next(deadline)).size_bytes() == 300'000);
    must(transfer.wait(deadline));
    CHECK(transfer.wait(deadline).error().code == rect::Code::end);
}

TEST_CASE("a transfer to a robot that is away waits for it until it is dropped") {
    Pair pair;
    auto transfer = must(pair.one.begin_transfer("wombat-3", "map", "a map"));
    CHECK(transfer.wait(10ms).error().code == rect::Code::timed_out);
    rect::Code code{};
    std::thread waiting([&] { code = transfer.wait().error().code; });
    transfer.drop();
    waiting.join();
    // It may have been dropped before the thread waited.
    CHECK((code == rect::Code::closed || code == rect::Code::handle));
}

TEST_CASE("a transfer that its own callback drops ends there, and what it needs is released") {
    Pair pair;
    rect::ReceiveOptions taking;
    taking.max_bytes = 100 << 20;
    const auto transfers = must(pair.two.receive_transfers("*/map", taking));
    struct Own {
        rect::Transfer transfer;
        std::promise<void> is_there;
        std::promise<void> is_dropped;
    };
    auto own = std::make_shared<Own>();
    const std::weak_ptr<Own> watched = own;
    auto dropped = own->is_dropped.get_future();
    own->transfer = must(pair.one.begin_transfer(
        "wombat-2", "map", std::string(50 << 20, 'm'), in_time(),
        [own, there = own->is_there.get_future(), is_first = true](const rect::Progress& progress) mutable {
            if (is_first && progress.fraction() < 1) {
                is_first = false;
                there.wait();
                own->transfer.drop();
                own->is_dropped.set_value();
            }
        }));
    own->is_there.set_value();
    own.reset();
    REQUIRE(dropped.wait_for(deadline) == std::future_status::ready);
    const auto until = std::chrono::steady_clock::now() + deadline;
    while (!watched.expired() && std::chrono::steady_clock::now() < until) {
        std::this_thread::yield();
    }
    CHECK(watched.expired());
    const auto never = transfers.next(500ms);
    REQUIRE_FALSE(never.has_value());
}
