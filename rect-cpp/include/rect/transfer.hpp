/// @file
/// Owns transfers: files and bytes of any size.
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

/// A file to transfer, by its path. It must not change before all is there.
struct File {
    /// Where it is.
    std::string path;
};

/// How a transfer goes.
struct TransferOptions {
    /// What it is called there; empty: the file's name, and bytes have none.
    std::string name{};
    /// What a file is; empty: bytes.
    std::string encoding{};
    /// How long nothing may be heard of the receiver; 0: it may come back whenever it likes.
    std::chrono::milliseconds patience{0};
};

/// How transfers are taken.
struct ReceiveOptions {
    /// The largest that is taken, in bytes. It has to be given.
    std::uint64_t max_bytes = 0;
    /// Into a folder for each sender in this one, under the name that the sender gives; empty: into memory.
    std::string folder{};
    /// How many at once, half of them (rounded up) of one sender at most; 0: 4.
    std::size_t at_once = 0;
    /// How long nothing may come before one is given up; 0: 10 minutes.
    std::chrono::milliseconds patience{0};
};

/// How much of a transfer the receiver holds.
struct Progress {
    /// What it holds.
    std::uint64_t held_bytes;
    /// Of how many.
    std::uint64_t size_bytes;

    /// As C has it.
    explicit Progress(const rect_progress& raw) noexcept : held_bytes(raw.held_bytes), size_bytes(raw.size_bytes) {}
    /// 0 to 1; of nothing, all is there.
    [[nodiscard]] double fraction() const noexcept {
        return size_bytes == 0 ? 1 : static_cast<double>(held_bytes) / static_cast<double>(size_bytes);
    }
};

/// A transfer that this program sends. It ends when this does, all there or not.
class Transfer : public Handle {
public:
    using Handle::Handle;

    /// Waits until all is there and right, or can't be. Code::timed_out: it goes on; Code::closed: the session was closed, or
    /// another thread dropped this; Code::end: its end was told before. Not for the transfer's own callback.
    expected<void> wait(std::chrono::milliseconds timeout = forever) const {
        rect_error error;
        const auto code = rect_transfer_wait({id()}, detail::ms(timeout), &error);
        detail::acquire_all();
        return detail::done(code, error);
    }
};

/// A transfer that came, with the right checksum.
class Received {
public:
    /// Takes over what C has given.
    explicit Received(const rect_received& raw) noexcept : payload(raw.payload), handle_(raw.id), raw_(raw) {}

    /// What it is, and its bytes, unless they are in a file.
    PayloadView payload;

    /// Of whom.
    [[nodiscard]] std::string_view from() const noexcept { return detail::view(raw_.from); }
    /// About what.
    [[nodiscard]] std::string_view topic() const noexcept { return detail::view(raw_.topic); }
    /// What its sender calls it; may be empty.
    [[nodiscard]] std::string_view name() const noexcept { return detail::view(raw_.name); }
    /// The file that it is in, which stays; empty, where it is in memory.
    [[nodiscard]] std::string_view file() const noexcept { return detail::view(raw_.file); }
    /// How long it is.
    [[nodiscard]] std::uint64_t size_bytes() const noexcept { return raw_.size_bytes; }

private:
    Handle handle_;
    rect_received raw_;
};

/// The transfers that come. No more are taken when this ends.
class Transfers : public Handle {
public:
    using Handle::Handle;

    /// The next one that ended: all of it, or Code::transfer_failed, and there may be more. Code::timed_out: none did;
    /// Code::closed: the session was closed, or another thread dropped this.
    [[nodiscard]] expected<Received> next(std::chrono::milliseconds timeout = forever) const {
        rect_received received;
        rect_error error;
        const auto code = rect_transfers_next({id()}, detail::ms(timeout), &received, &error);
        return detail::got<Received>(code, error, [&] { return Received(received); });
    }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
