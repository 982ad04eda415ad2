/// @file
/// Owns messages, and how they are waited for.
#ifndef RECT_MESSAGE_HPP
#define RECT_MESSAGE_HPP

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// How urgently a robot speaks; more urgent messages overtake others in every queue and on the Bluetooth link.
enum class Urgency : std::uint32_t {
    /// In no hurry.
    bulk = RECT_URGENCY_BULK,
    /// As usual.
    normal = RECT_URGENCY_NORMAL,
    /// Before everything else.
    urgent = RECT_URGENCY_URGENT,
};

/// What happens when one more comes than may wait.
enum class WhenFull : std::uint32_t {
    /// The oldest is dropped: what the program gets is fresh.
    newest_wins = RECT_WHEN_FULL_NEWEST_WINS,
    /// The new one is dropped: what the program gets has no gap before it is full.
    oldest_wins = RECT_WHEN_FULL_OLDEST_WINS,
    /// Whoever sends waits. Nothing is dropped, and a program that does not read holds up everything of that urgency that
    /// comes over the same connection.
    wait = RECT_WHEN_FULL_WAIT,
};

/// How what comes waits for the program.
struct Receiving {
    /// How many may wait; 0: 256 messages, or the newest frame alone.
    std::size_t capacity = 0;
    /// What happens to more.
    WhenFull when_full = WhenFull::newest_wins;
};

/// @cond
namespace detail {

inline rect_receiving raw(const Receiving& receiving) noexcept {
    return {receiving.capacity, static_cast<std::uint32_t>(receiving.when_full)};
}

}  // namespace detail
/// @endcond

/// A message from another robot (or another program of this one), which belongs to the callback that is called with it.
class MessageView {
public:
    /// As C has it.
    explicit MessageView(const rect_message& raw) noexcept : payload(raw.payload), raw_(raw) {}

    /// What it says.
    PayloadView payload;

    /// Who sent it.
    [[nodiscard]] std::string_view from() const noexcept { return detail::view(raw_.from); }
    /// To whom alone; empty: to all.
    [[nodiscard]] std::string_view to() const noexcept { return detail::view(raw_.to); }
    /// About what.
    [[nodiscard]] std::string_view topic() const noexcept { return detail::view(raw_.topic); }
    /// How urgent.
    [[nodiscard]] Urgency urgency() const noexcept { return static_cast<Urgency>(raw_.urgency); }
    /// When, by the sender's clock; nothing for one of a stock program. A robot without a clock of its own may be years off.
    [[nodiscard]] std::optional<std::chrono::system_clock::time_point> sent() const noexcept {
        if (raw_.sent_ms < 0) {
            return std::nullopt;
        }
        return std::chrono::system_clock::time_point(std::chrono::milliseconds(raw_.sent_ms));
    }
    /// Its number at its publisher; nothing for one of a stock program.
    [[nodiscard]] std::optional<std::uint32_t> sequence() const noexcept {
        if (raw_.sequence < 0) {
            return std::nullopt;
        }
        return static_cast<std::uint32_t>(raw_.sequence);
    }
    /// So many of its publisher, before it, did not arrive.
    [[nodiscard]] std::uint32_t missed() const noexcept { return raw_.missed; }
    /// Whether it was overtaken on its way.
    [[nodiscard]] bool late() const noexcept { return raw_.late; }
    /// Why it is still packed as it came, if it is: it is damaged, or of a codec that is not known here.
    [[nodiscard]] std::string_view flaw() const noexcept { return detail::view(raw_.flaw); }
    /// By what it came, as `ble`, where its sender has one link with this robot, and that is known.
    [[nodiscard]] std::string_view over() const noexcept { return detail::view(raw_.over); }

private:
    rect_message raw_;
};

/// A message of the program's own: what `listen` and Subscriber::next give.
class Message {
public:
    /// Takes over what C has given.
    explicit Message(const rect_message& raw) noexcept : handle_(raw.id), view_(raw) {}
    /// What it says, and of whom.
    [[nodiscard]] const MessageView& operator*() const noexcept { return view_; }
    /// What it says, and of whom.
    [[nodiscard]] const MessageView* operator->() const noexcept { return &view_; }

private:
    Handle handle_;
    MessageView view_;
};

/// The messages of a pattern, which wait until they are taken. It ends when this does.
class Subscriber : public Handle {
public:
    using Handle::Handle;

    /// The next message; Code::timed_out: there was none; Code::closed: the session was closed, or another thread dropped
    /// this.
    [[nodiscard]] expected<Message> next(std::chrono::milliseconds timeout = forever) const {
        rect_message message;
        rect_error error;
        const auto code = rect_subscriber_next({id()}, detail::ms(timeout), &message, &error);
        return detail::got<Message>(code, error, [&] { return Message(message); });
    }

    /// How many messages were dropped because the program did not take them in time.
    [[nodiscard]] expected<std::uint64_t> dropped() const {
        std::uint64_t dropped = 0;
        rect_error error;
        const auto code = rect_subscriber_dropped({id()}, &dropped, &error);
        return detail::got<std::uint64_t>(code, error, [&] { return dropped; });
    }
};

/// A callback that is called for whatever comes, one after another, on a thread of its own, until this ends; that waits for a
/// call that is under way. It may be ended in its own callback. Two callbacks that end each other's at the same time wait
/// for each other for ever.
class Subscription : public Handle {
public:
    using Handle::Handle;
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
