// Tests transfers: bytes and files, progress, refusals, and cancellation.
//
//     build/default/tests/rect_tests -# '[#test_transfers]'
#include <atomic>
#include <filesystem>
#include <fstream>
#include <future>
#include <memory>
#include <thread>

#include "folder.hpp"
#include "pair.hpp"

namespace {

rect::TransferOptions with_deadline() {
    rect::TransferOptions options;
    options.timeout = deadline;
    return options;
}

}  // namespace

TEST_CASE("bytes arrive completely, and progress is reported") {
    Pair pair;
    rect::ReceiveOptions receive_options;
    receive_options.max_bytes = 1 << 20;
    const auto transfers = must(pair.two.receive_transfers("wombat-1/maps/*", receive_options));
    const std::string map(300'000, 'm');
    std::atomic<std::uint64_t> received_bytes{0};
    must(pair.one.transfer("wombat-2", "maps/hall", map, with_deadline(),
                           [&](const rect::Progress& progress) { received_bytes = progress.received_bytes; }));
    CHECK(received_bytes == map.size());
    const auto received = must(transfers.next(deadline));
    CHECK(received.sender() == "wombat-1");
    CHECK(received.topic() == "maps/hall");
    CHECK(received.size_bytes() == map.size());
    CHECK(received.file().empty());
    CHECK(must(received.payload.text()) == map);
}

TEST_CASE("a file arrives as a file") {
    const Folder folder;
    Pair pair;
    const auto file = folder / "map.bin";
    std::ofstream(file) << std::string(100'000, 'f');
    rect::ReceiveOptions receive_options;
    receive_options.max_bytes = 1 << 20;
    receive_options.folder = folder / "received";
    const auto transfers = must(pair.two.receive_transfers("*/files", receive_options));
    must(pair.one.transfer("wombat-2", "files", rect::File{file}, with_deadline()));
    const auto received = must(transfers.next(deadline));
    CHECK(received.name() == "map.bin");
    CHECK(std::filesystem::file_size(std::string(received.file())) == 100'000);
}

TEST_CASE("transfers that are too large or whose file is missing fail") {
    Pair pair;
    CHECK(pair.two.receive_transfers("*/files", {}).error().code == rect::Code::argument);
    rect::ReceiveOptions receive_options;
    receive_options.max_bytes = 100;
    const auto transfers = must(pair.two.receive_transfers("*/files", receive_options));
    const auto large = pair.one.transfer("wombat-2", "files", std::string(101, 'x'), with_deadline());
    REQUIRE_FALSE(large.has_value());
    CHECK(large.error().code == rect::Code::transfer_refused);
    CHECK_THAT(large.error().text, ContainsSubstring("100"));
    const auto none = pair.one.transfer("wombat-2", "files", rect::File{"/no/such/file"}, with_deadline());
    REQUIRE_FALSE(none.has_value());
    CHECK(none.error().code == rect::Code::file);
    CHECK(transfers.next(10ms).error().code == rect::Code::timed_out);
}

TEST_CASE("a transfer completes in the background, and its result is returned once") {
    Pair pair;
    rect::ReceiveOptions receive_options;
    receive_options.max_bytes = 1 << 20;
    const auto transfers = must(pair.two.receive_transfers("*/map", receive_options));
    const auto transfer = must(pair.one.begin_transfer("wombat-2", "map", std::string(300'000, 'm'), with_deadline()));
    CHECK(must(transfers.next(deadline)).size_bytes() == 300'000);
    must(transfer.wait(deadline));
    CHECK(transfer.wait(deadline).error().code == rect::Code::end);
}

TEST_CASE("a transfer to an unreachable robot waits until it is dropped") {
    Pair pair;
    auto transfer = must(pair.one.begin_transfer("wombat-3", "map", "a map"));
    CHECK(transfer.wait(10ms).error().code == rect::Code::timed_out);
    rect::Code code{};
    std::thread waiting([&] { code = transfer.wait().error().code; });
    transfer.drop();
    waiting.join();
    // The transfer may have been dropped before the thread called `wait`.
    CHECK((code == rect::Code::closed || code == rect::Code::handle));
}

TEST_CASE("a transfer can be dropped by its own callback, and captured objects are released") {
    Pair pair;
    rect::ReceiveOptions receive_options;
    receive_options.max_bytes = 100 << 20;
    const auto transfers = must(pair.two.receive_transfers("*/map", receive_options));
    struct State {
        rect::Transfer transfer;
        std::promise<void> is_stored;
        std::promise<void> is_dropped;
    };
    auto own = std::make_shared<State>();
    const std::weak_ptr<State> watched = own;
    auto dropped = own->is_dropped.get_future();
    own->transfer = must(pair.one.begin_transfer(
        "wombat-2", "map", std::string(50 << 20, 'm'), with_deadline(),
        [own, stored = own->is_stored.get_future(), is_first = true](const rect::Progress& progress) mutable {
            if (is_first && progress.fraction() < 1) {
                is_first = false;
                stored.wait();
                own->transfer.drop();
                own->is_dropped.set_value();
            }
        }));
    own->is_stored.set_value();
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
