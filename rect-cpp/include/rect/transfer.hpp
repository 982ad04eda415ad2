/// @file
/// Sends and receives transfers: files and values of any size.
#ifndef RECT_TRANSFER_HPP
#define RECT_TRANSFER_HPP

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "payload.hpp"
#include "sanitizer.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A file to transfer. It must not change until the transfer is complete.
struct File {
    /// The path of the file.
    std::string path;
};

/// The options of an outgoing transfer.
struct TransferOptions {
    /// The file name at the receiver. If it is empty, a file keeps its own name, and a value has none.
    std::string name{};
    /// The encoding of the content. If it is empty, a value keeps its own encoding, and a file is `zenoh/bytes`.
    std::string encoding{};
    /// How long the receiver may be unreachable, or its program take none of the transfers that have arrived, before the
    /// transfer fails. 0 means no limit.
    std::chrono::milliseconds timeout{0};
};

/// The options for receiving transfers.
struct ReceiveOptions {
    /// Maximum size of a transfer in bytes. Larger ones are refused. Required.
    std::uint64_t max_bytes = 0;
    /// The folder for received files, which no other receiver may use. Each sender has a subfolder. Files keep the names
    /// that their senders give, and replace files of the same name. Transfers into a folder resume after a restart. If this
    /// is empty, transfers are kept in memory.
    std::string folder{};
    /// Maximum number of transfers at the same time, of which at most half (rounded up) have the same sender. 0 means the
    /// default, 4.
    std::size_t max_concurrent = 0;
    /// How long a transfer may make no progress before the receiver abandons it. 0 means the default, 10 minutes.
    std::chrono::milliseconds timeout{0};
};

/// The progress of an outgoing transfer.
struct Progress {
    /// Number of bytes that the receiver has.
    std::uint64_t received_bytes;
    /// Size of the transfer in bytes.
    std::uint64_t size_bytes;

    /// Copies a struct of rect.h.
    explicit Progress(const rect_progress& raw) noexcept : received_bytes(raw.received_bytes), size_bytes(raw.size_bytes) {}
    /// Returns the completed fraction, 0 to 1. An empty transfer is complete.
    [[nodiscard]] double fraction() const noexcept {
        return size_bytes == 0 ? 1 : static_cast<double>(received_bytes) / static_cast<double>(size_bytes);
    }
};

/// An outgoing transfer. Destroying it ends the transfer, whether or not it is complete.
///
///     const auto transfer = rect::must(robot.begin_transfer("wombat-2", "maps/hall", rect::File{"hall.pcd"}));
///     rect::must(transfer.wait());
class Transfer : public Handle {
public:
    using Handle::Handle;

    /// Waits until the transfer is complete and verified, or has failed. Must not be called in the transfer's own callback.
    ///
    /// Fails with Code::timed_out if the transfer is still running after `timeout`, or if the timeout of its options has
    /// expired; with Code::transfer_refused or Code::transfer_failed; with Code::file if its file cannot be read; with
    /// Code::name if its file name is invalid; with Code::closed if the session was closed or another thread dropped this
    /// transfer; and with Code::end if an earlier call has already returned the result.
    expected<void> wait(std::chrono::milliseconds timeout = forever) const {
        rect_error error;
        const auto code = rect_transfer_wait({handle_id()}, detail::ms(timeout), &error);
        detail::acquire_all();
        return detail::ok_or_error(code, error);
    }
};

/// A transfer that was received completely and whose checksum is correct.
class Received {
public:
    /// Takes ownership of a transfer of rect.h.
    explicit Received(const rect_received& raw) noexcept : payload(raw.payload), handle_(raw.id), raw_(raw) {}

    /// The encoding, and the bytes unless they are in a file.
    PayloadView payload;

    /// Returns the robot that sent the transfer.
    [[nodiscard]] std::string_view sender() const noexcept { return detail::view(raw_.sender); }
    /// Returns the topic.
    [[nodiscard]] std::string_view topic() const noexcept { return detail::view(raw_.topic); }
    /// Returns the file name that the sender gave the transfer; may be empty.
    [[nodiscard]] std::string_view name() const noexcept { return detail::view(raw_.name); }
    /// Returns the path of the received file, which remains when this object is destroyed. Empty if the transfer is in
    /// memory.
    [[nodiscard]] std::string_view file() const noexcept { return detail::view(raw_.file); }
    /// Returns the size of the transfer in bytes.
    [[nodiscard]] std::uint64_t size_bytes() const noexcept { return raw_.size_bytes; }

private:
    Handle handle_;
    rect_received raw_;
};

/// A receiver of transfers. Destroying it ends the reception.
///
///     rect::ReceiveOptions options;
///     options.max_bytes = 100 << 20;
///     options.folder = "/var/lib/maps";
///     const auto maps = rect::must(robot.receive_transfers("*/maps/*", options));
///     const auto map = rect::must(maps.next());
class Transfers : public Handle {
public:
    using Handle::Handle;

    /// Waits for the next transfer to finish. Fails with Code::transfer_failed if an incoming transfer failed, after which
    /// there may be more; with Code::timed_out if none finished within `timeout`; and with Code::closed if the session was
    /// closed or another thread dropped this receiver.
    [[nodiscard]] expected<Received> next(std::chrono::milliseconds timeout = forever) const {
        rect_received received;
        rect_error error;
        const auto code = rect_transfers_next({handle_id()}, detail::ms(timeout), &received, &error);
        return detail::value_or_error<Received>(code, error, [&] { return Received(received); });
    }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
