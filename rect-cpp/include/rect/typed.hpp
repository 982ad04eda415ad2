/// @file
/// Defines messages and replies whose values have a type that the program states: `robot.subscribe<Battery>("*/battery")`.
#ifndef RECT_TYPED_HPP
#define RECT_TYPED_HPP

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "message.hpp"
#include "publisher.hpp"
#include "service.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A message whose value has the type `T`, which the Adapter of `T` reads. In a callback, it is valid until the callback returns,
/// and the value for as long as the program keeps it.
template <class T>
class MessageOf : public Message {
public:
    /// Takes ownership of a message of rect.h, and reads its value. `robot` counts it if it does not fit.
    MessageOf(const rect_message& raw, rect_robot robot) : Message(raw), value_(read()) {
        if (!value_ && !is_forgotten()) {
            const std::string sender(this->sender());
            const std::string topic(this->topic());
            // Fails only if the session was closed.
            rect_robot_on_problem(robot, sender.c_str(), topic.c_str(), value_.error().text.c_str(), nullptr);
        }
    }

    /// Returns the value, or the problem why there is none: Code::payload if it does not fit `T` or its topic was forgotten, and
    /// Code::codec if the payload could not be decoded.
    [[nodiscard]] const expected<T>& value() const& noexcept { return value_; }
    /// Moves the value out of a message that is not needed any more.
    [[nodiscard]] expected<T> value() && { return std::move(value_); }
    /// Returns the reason why there is no value. Empty if there is one.
    [[nodiscard]] std::string_view problem() const noexcept {
        return value_ ? std::string_view() : std::string_view(value_.error().text);
    }

private:
    [[nodiscard]] bool is_forgotten() const noexcept { return this->raw().is_forgotten; }

    [[nodiscard]] expected<T> read() const {
        const auto problem = Message::problem();
        const auto code = is_forgotten() ? Code::payload : Code::codec;
        return problem.empty() ? payload.template value<T>() : detail::failed(code, std::string(problem));
    }

    expected<T> value_;
};

/// A subscriber of messages whose values have the type `T`. Destroying it ends the subscription.
///
///     const auto batteries = rect::must(robot.subscribe<Battery>("*/battery"));
///     while (const auto message = batteries.next()) {
///         if (message->value()) {
///             std::cout << message->sender() << ": " << message->value()->percent << std::endl;
///         }
///     }
template <class T>
class SubscriberOf : public Subscriber {
public:
    /// Takes ownership of a subscriber of rect.h that was created with `robot`.
    SubscriberOf(std::uint64_t id, rect_robot robot) noexcept : Subscriber(id), robot_(robot) {}

    /// Waits for the next message like Subscriber::next. A message whose value does not fit `T` is returned with a problem, it is
    /// counted in Counters::problems, and a warning goes to standard error for the first one of each sender and topic.
    [[nodiscard]] expected<MessageOf<T>> next(std::chrono::milliseconds timeout = forever) const {
        rect_message message;
        rect_error error;
        const auto code = rect_subscriber_next({handle_id()}, detail::ms(timeout), &message, &error);
        return detail::value_or_error<MessageOf<T>>(code, error, [&] { return MessageOf<T>(message, robot_); });
    }

private:
    rect_robot robot_;
};

/// A publisher of values of the type `T`.
template <class T>
class PublisherOf : public Publisher {
public:
    using Publisher::Publisher;

    /// Publishes a value to every subscriber. Fails like Robot::publish.
    expected<void> publish(const T& value) const { return Publisher::publish(value); }
};

/// A reply whose value has the type `T`.
template <class T>
class ReplyOf : public Reply {
public:
    /// The value.
    T value;

    /// Takes a reply and its value.
    ReplyOf(Reply reply, T of) : Reply(std::move(reply)), value(std::move(of)) {}
};

/// @cond
namespace detail {

// The types that are returned if the program states the type `T` of the values, or none (`void`).
template <class T>
struct Typed {
    using Message = MessageOf<T>;
    using MessageView = MessageOf<T>;
    using Subscriber = SubscriberOf<T>;
    using Publisher = PublisherOf<T>;
    using Reply = ReplyOf<T>;

    static MessageView view(const rect::MessageView& message, rect_robot robot) { return {message.raw(), robot}; }
    static Message message(const rect_message& raw, rect_robot robot) { return {raw, robot}; }
    static Subscriber subscriber(std::uint64_t id, rect_robot robot) { return {id, robot}; }
    static expected<Reply> reply(rect::Reply reply) {
        auto value = reply.payload.template value<T>();
        return value ? expected<Reply>(Reply(std::move(reply), std::move(*value))) : unexpected<Error>(value.error());
    }
};

template <>
struct Typed<void> {
    using Message = rect::Message;
    using MessageView = rect::MessageView;
    using Subscriber = rect::Subscriber;
    using Publisher = rect::Publisher;
    using Reply = rect::Reply;

    static const MessageView& view(const rect::MessageView& message, rect_robot) { return message; }
    static Message message(const rect_message& raw, rect_robot) { return Message(raw); }
    static Subscriber subscriber(std::uint64_t id, rect_robot) { return Subscriber(id); }
    static expected<Reply> reply(rect::Reply reply) { return reply; }
};

}  // namespace detail
/// @endcond

/// The replies to one request, whose values have the type `T`. Destroying it cancels the request.
template <class T>
class RepliesOf : public Replies {
public:
    using Replies::Replies;

    /// Waits for the next reply like Replies::next. Fails with Code::payload if its value does not fit `T`, after which there may be
    /// more replies.
    [[nodiscard]] expected<ReplyOf<T>> next() const {
        auto reply = Replies::next();
        return reply ? detail::Typed<T>::reply(std::move(*reply)) : unexpected<Error>(reply.error());
    }
};

}  // namespace RECT_ABI
}  // namespace rect

#endif
