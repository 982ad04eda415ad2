/// @file
/// Defines messages, subscribers and subscriptions.
#ifndef RECT_MESSAGE_HPP
#define RECT_MESSAGE_HPP

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// The urgency of messages. In every queue and on a Bluetooth link, messages overtake less urgent ones.
enum class Urgency : std::uint32_t {
    /// For data that may wait, e.g. files.
    bulk = RECT_URGENCY_BULK,
    /// For most messages. The default.
    normal = RECT_URGENCY_NORMAL,
    /// For messages that must arrive before all others, e.g. emergency stops.
    urgent = RECT_URGENCY_URGENT,
};

/// The rule for an item that arrives when the receive queue is full.
enum class WhenFull : std::uint32_t {
    /// The oldest waiting item is dropped, so the program receives recent items. The default.
    drop_oldest = RECT_WHEN_FULL_DROP_OLDEST,
    /// The new item is dropped, so the items that are already waiting have no gaps.
    drop_newest = RECT_WHEN_FULL_DROP_NEWEST,
    /// The sender waits, and nothing is dropped. A program that does not read then blocks all messages of the same urgency
    /// on the same link.
    block = RECT_WHEN_FULL_BLOCK,
};

/// The settings of a receive queue.
struct QueueOptions {
    /// How many items may wait. 0 means the default: 256 messages, or 1 frame of a stream.
    std::size_t capacity = 0;
    /// The rule for a full queue.
    WhenFull when_full = WhenFull::drop_oldest;
};

/// The settings of a subscription. QueueOptions become such settings by themselves.
struct SubscribeOptions {
    /// Creates the defaults.
    SubscribeOptions() = default;
    /// Creates the defaults with other settings of the receive queue.
    SubscribeOptions(QueueOptions settings) : queue(settings) {}  // NOLINT(google-explicit-constructor)
    /// Creates the defaults with other settings of the receive queue.
    SubscribeOptions(std::size_t capacity, WhenFull when_full) : queue{capacity, when_full} {}

    /// The settings of the receive queue.
    QueueOptions queue;
    /// The largest number of messages of each topic per second, 0.01 to 1000; 0 means all, the default. The newest one wins. The
    /// router of the robot that publishes leaves out the others, so that they cost nothing on the air; they count as skipped(), and not
    /// as missed. Messages that are sent to this robot alone, and retained ones, arrive as they are sent.
    double max_hz = 0;
    /// Whether to receive only messages whose value differs from the last one.
    bool on_change = false;
};

/// @cond
namespace detail {

inline rect_queue_options raw(const QueueOptions& queue) noexcept {
    rect_queue_options raw{};
    raw.capacity = queue.capacity;
    raw.when_full = static_cast<std::uint32_t>(queue.when_full);
    return raw;
}

inline rect_subscribe_options raw(const SubscribeOptions& options) noexcept {
    rect_subscribe_options raw_options{};
    raw_options.queue = raw(options.queue);
    raw_options.max_hz = options.max_hz;
    raw_options.on_change = options.on_change;
    return raw_options;
}

}  // namespace detail
/// @endcond

/// The meaning of a retained message beside its value.
struct Retained {
    /// How long ago it was published, by the clock of its robot's router; it does not depend on the time of day.
    std::chrono::duration<double> age;
    /// Whether the program that published it has ended.
    bool has_ended;
    /// Whether its robot has forgotten the topic: there is no value any more.
    bool is_forgotten;
};

/// A message from another robot, or from another program of the same robot. It is valid until the callback that receives it
/// returns; copy whatever is needed later.
class MessageView {
public:
    /// Refers to a struct of rect.h.
    explicit MessageView(const rect_message& raw) noexcept : payload(raw.payload), raw_(raw) {}

    /// The payload.
    PayloadView payload;

    /// Returns the robot that published or sent the message.
    [[nodiscard]] std::string_view sender() const noexcept { return detail::view(raw_.sender); }
    /// Returns the robot that the message was sent to; empty if it was published.
    [[nodiscard]] std::string_view recipient() const noexcept { return detail::view(raw_.recipient); }
    /// Returns the topic.
    [[nodiscard]] std::string_view topic() const noexcept { return detail::view(raw_.topic); }
    /// Returns the urgency.
    [[nodiscard]] Urgency urgency() const noexcept { return static_cast<Urgency>(raw_.urgency); }
    /// Returns the time of sending by the sender's clock, or nothing if the sender is a stock Zenoh program. The clock of a
    /// robot without a real-time clock may be wrong by years.
    [[nodiscard]] std::optional<std::chrono::system_clock::time_point> sent_at() const noexcept {
        if (raw_.sent_at_ms < 0) {
            return std::nullopt;
        }
        return std::chrono::system_clock::time_point(std::chrono::milliseconds(raw_.sent_at_ms));
    }
    /// Returns the sequence number that its publisher gave it, or nothing if the sender is a stock Zenoh program.
    [[nodiscard]] std::optional<std::uint32_t> sequence() const noexcept {
        if (raw_.sequence < 0) {
            return std::nullopt;
        }
        return static_cast<std::uint32_t>(raw_.sequence);
    }
    /// Returns how many messages of the same publisher, directly before this one, did not arrive.
    [[nodiscard]] std::uint32_t missed() const noexcept { return raw_.missed; }
    /// Returns how many messages of the same publisher, directly before this one, were left out because the subscription asks for fewer.
    [[nodiscard]] std::uint32_t skipped() const noexcept { return raw_.skipped; }
    /// Returns the time until the message expires, when it was delivered; nothing if it does not expire.
    [[nodiscard]] std::optional<std::chrono::milliseconds> expires_in() const {
        return raw_.expires_in_ms < 0 ? std::nullopt : std::optional<std::chrono::milliseconds>(raw_.expires_in_ms);
    }
    /// Returns whether the message arrived after one with a higher sequence number of the same publisher.
    [[nodiscard]] bool late() const noexcept { return raw_.late; }
    /// Returns whether the message repeats one of a recording. sent_at() is the time of that one.
    [[nodiscard]] bool replayed() const noexcept { return raw_.replayed; }
    /// Returns how old the value of a retained topic is, and whether it was forgotten; nothing if the topic is not retained.
    [[nodiscard]] std::optional<Retained> retained() const noexcept {
        if (!raw_.retained) {
            return std::nullopt;
        }
        return Retained{std::chrono::duration<double>(raw_.age_s), raw_.has_ended, raw_.is_forgotten};
    }
    /// Returns the reason why the payload could not be decoded and is as it arrived: it is damaged, or its codec or
    /// dictionary is not available. Also set if the topic was forgotten, so that there is no payload. Otherwise empty.
    [[nodiscard]] std::string_view problem() const noexcept { return detail::view(raw_.problem); }
    /// Returns the method of the link over which the message arrived, e.g. `ble`. Empty if the sender has several links with
    /// this robot, or if the method is not known.
    [[nodiscard]] std::string_view method() const noexcept { return detail::view(raw_.method); }

    /// Returns the struct of rect.h.
    [[nodiscard]] const rect_message& raw() const noexcept { return raw_; }

private:
    rect_message raw_;
};

/// A message that the program owns, as Robot::wait_for_message and Subscriber::next return it.
class Message : public MessageView {
public:
    /// Takes ownership of a message of rect.h.
    explicit Message(const rect_message& raw) noexcept : MessageView(raw), handle_(raw.id) {}

private:
    Handle handle_;
};

/// How many messages of one robot a Subscriber has received and missed.
struct SenderCounts {
    /// Number of messages that arrived.
    std::uint64_t received;
    /// Number of messages that did not arrive, according to their sequence numbers.
    std::uint64_t missed;
};

/// A subscription with a receive queue from which the program takes messages. Destroying it ends the subscription.
///
///     const auto angles = rect::must(robot.subscribe("wombat-2/arm/angle"));
///     while (const auto message = angles.next()) {
///         std::cout << message->sender() << ": " << message->payload.text().value_or("?") << std::endl;
///     }
class Subscriber : public Handle {
public:
    using Handle::Handle;

    /// Waits for the next message. Fails with Code::timed_out if none arrives within `timeout`, and with Code::closed if the
    /// session was closed or another thread dropped this subscriber.
    [[nodiscard]] expected<Message> next(std::chrono::milliseconds timeout = forever) const {
        rect_message message;
        rect_error error;
        const auto code = rect_subscriber_next({handle_id()}, detail::ms(timeout), &message, &error);
        return detail::value_or_error<Message>(code, error, [&] { return Message(message); });
    }

    /// Returns how many messages the full receive queue has dropped.
    [[nodiscard]] expected<std::uint64_t> dropped() const {
        std::uint64_t dropped = 0;
        rect_error error;
        const auto code = rect_subscriber_dropped({handle_id()}, &dropped, &error);
        return detail::value_or_error<std::uint64_t>(code, error, [&] { return dropped; });
    }

    /// Returns how many messages of each robot were received and missed, by the robot's name.
    [[nodiscard]] expected<std::map<std::string, SenderCounts>> counts_by_sender() const {
        using All = std::map<std::string, SenderCounts>;
        rect_counts_by_sender counts;
        rect_error error;
        const auto code = rect_subscriber_counts_by_sender({handle_id()}, &counts, &error);
        return detail::value_or_error<All>(code, error, [&] {
            const Handle handle(counts.id);
            All all;
            for (const auto& item : span<const rect_sender_counts>(counts.items, counts.len)) {
                all[std::string(detail::view(item.sender))] = {item.received, item.missed};
            }
            return all;
        });
    }
};

/// The registration of a callback for messages, frames or events. It calls a function for each item, one after another, on a thread of its own.
/// Destroying it ends the calls and waits for a call in progress. A function may end its own subscription. If two functions
/// end each other's subscriptions at the same time, both wait forever.
class Subscription : public Handle {
public:
    using Handle::Handle;
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
