/// @file
/// Defines requests, replies and services.
#ifndef RECT_SERVICE_HPP
#define RECT_SERVICE_HPP

#include <chrono>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "callback.hpp"
#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A reply to a request.
class Reply {
public:
    /// Takes ownership of a reply of rect.h.
    explicit Reply(const rect_reply& raw) noexcept
        : payload(raw.payload), handle_(raw.id), sender_(raw.sender), is_shared_(raw.is_shared) {}

    /// The payload.
    PayloadView payload;

    /// Returns the robot that replied.
    [[nodiscard]] std::string_view sender() const noexcept { return detail::view(sender_); }

    /// Returns whether the service shares its topic with other programs of the robot (ServiceOptions::allow_several). They have
    /// received the request, too, and carry it out. Robot::request discards their replies; Robot::request_all returns them.
    [[nodiscard]] bool is_shared() const noexcept { return is_shared_; }

private:
    Handle handle_;
    rect_text sender_;
    bool is_shared_;
};

/// The replies to one request of Robot::request_all or Robot::request_stream, in the order of arrival. Destroying it cancels the
/// request.
///
///     const auto replies = rect::must(robot.request_all("battery", ""));
///     while (const auto reply = replies.next()) {
///         std::cout << reply->sender() << std::endl;
///     }
class Replies : public Handle {
public:
    using Handle::Handle;

    /// Waits for the next reply. Fails with Code::service if a robot replied with an error, after which there may be more
    /// replies; with Code::end if all robots have replied, or all replies of a stream have arrived; with Code::interrupted if a stream
    /// ended midway; and with Code::timed_out if the request's timeout expired before that.
    [[nodiscard]] expected<Reply> next() const {
        rect_reply reply;
        rect_error error;
        const auto code = rect_replies_next({handle_id()}, &reply, &error);
        return detail::value_or_error<Reply>(code, error, [&] { return Reply(reply); });
    }
};

/// The outcome of a request at one robot.
struct Outcome {
    /// The robot. Empty if a stock Zenoh program replied with an error, which does not name it.
    std::string_view robot;
    /// Its reply, or the error. The payload is valid as long as the Gathered.
    expected<PayloadView> reply;
    /// Whether the robot serves the topic and did not reply.
    bool is_missing;
};

/// The outcomes of a request to all robots: first the replies and errors in the order of their arrival, and then an error for each
/// missing robot. A robot whose programs have several services of the topic has one for each of them.
///
///     const auto gathered = rect::must(robot.gather("battery", ""));
///     for (const auto& outcome : gathered.outcomes()) {
///         std::cout << outcome.robot << (outcome.reply ? " replied" : outcome.reply.error().text) << std::endl;
///     }
class Gathered {
public:
    /// Takes ownership of outcomes of rect.h.
    explicit Gathered(const rect_gathered& raw) : handle_(raw.id) {
        for (std::size_t i = 0; i < raw.len; ++i) {
            const auto& item = raw.items[i];
            const auto reply = item.code == RECT_CODE_OK
                                   ? expected<PayloadView>(PayloadView(item.payload))
                                   : unexpected<Error>(Error{static_cast<Code>(item.code), std::string(detail::view(item.error))});
            outcomes_.push_back({detail::view(item.robot), reply, item.is_missing});
        }
    }

    /// Returns the outcomes.
    [[nodiscard]] const std::vector<Outcome>& outcomes() const noexcept { return outcomes_; }

private:
    Handle handle_;
    std::vector<Outcome> outcomes_;
};

/// A service in the catalogue of a robot.
struct ServiceEntry {
    /// The topic.
    std::string topic;
    /// The name of the program that serves it; empty if the program has none.
    std::string program;
    /// Its purpose, in the words of the program; empty if there are none.
    std::string about;
    /// Whether other programs of the robot may serve the same topic. Then each of them answers.
    bool several;
};

/// The description of a service, and whether it may have company.
struct ServiceOptions {
    /// The purpose of the service, for `rect service list` and the dashboard: at most 200 characters.
    std::string about{};
    /// Whether other programs of the robot may serve the same topic, which then have to allow it, too. Each of them answers every
    /// request.
    bool allow_several{false};
};

/// A request to a service. It is valid until the function that receives it returns.
class Request {
public:
    /// Refers to a struct of rect.h.
    explicit Request(const rect_request& raw) noexcept : payload(raw.payload), raw_(raw) {}

    /// The payload.
    PayloadView payload;

    /// Returns the robot that sent the request, according to the request itself; empty if the sender is a stock Zenoh
    /// program. The name is not verified: do not base permissions on it.
    [[nodiscard]] std::string_view sender() const noexcept { return detail::view(raw_.sender); }
    /// Returns the time until the sender stops waiting for the reply.
    [[nodiscard]] std::chrono::milliseconds remaining() const noexcept {
        return std::chrono::milliseconds(raw_.remaining_ms);
    }
    /// Returns whether the sender still waits for a reply, so that a service can stop when nobody does.
    ///
    /// It does not wait after its deadline, or if it has closed the request, or if its program or robot has ended. Except for the
    /// deadline, this is known within 0.5 s. The end of a program is known if the program has a name, and that of a stock Zenoh program
    /// never. The first call begins to observe the sender, which sends nothing on the air.
    [[nodiscard]] bool is_wanted() const noexcept { return rect_request_is_wanted(raw_.id); }
    /// Sends a reply before the one that the function returns. Robot::request receives the first reply, and Robot::request_stream all of
    /// them.
    template <class T>
    [[nodiscard]] expected<void> reply(const T& value) const {
        return detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::ok_or_error(rect_request_reply(raw_.id, &payload, &error), error);
        });
    }

private:
    rect_request raw_;
};

/// The error with which a service replies: its function throws it, or returns it as `rect::unexpected<rect::Refusal>`. The
/// sender receives its text. An Exception of rect::must that the function throws is treated in the same way.
class Refusal : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

/// A service of this program, which calls a function for each request. Destroying it ends the service and waits for calls in
/// progress. The function may end its own service; its reply is not sent then.
class Service : public Handle {
public:
    using Handle::Handle;
};

/// @cond
namespace detail {

template <class T>
struct is_expected : std::false_type {};
template <class T, class E>
struct is_expected<expected<T, E>> : std::true_type {};

inline std::string refusal_text(const Error& error) { return error.text; }
inline std::string refusal_text(const Refusal& refusal) { return refusal.what(); }
inline std::string refusal_text(std::string_view text) { return std::string(text); }

inline void refuse(std::uint64_t request, std::string_view text) {
    rect_payload payload{};
    payload.data = text.data();
    payload.len = text.size();
    payload.encoding = raw("text/plain");
    rect_error error;
    if (rect_request_refuse(request, &payload, &error) != RECT_CODE_OK) {
        report(error.text);
    }
}

template <class T>
void reply(std::uint64_t request, const T& value) {
    if constexpr (is_expected<T>::value) {
        if (value) {
            reply(request, *value);
        } else {
            refuse(request, refusal_text(value.error()));
        }
    } else {
        const auto sent = with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return ok_or_error(rect_request_reply(request, &payload, &error), error);
        });
        if (!sent) {
            refuse(request, sent.error().text);
        }
    }
}

/// The callback for C: replies to a request with the result of the program's function.
template <class F>
void serve(const rect_request* raw, void* context) noexcept {
    acquire(context);
    const bool has_replied = guarded([&] {
        try {
            reply(raw->id, (*static_cast<F*>(context))(Request(*raw)));
        } catch (const Refusal& refusal) {
            refuse(raw->id, refusal.what());
        } catch (const Exception& exception) {
            refuse(raw->id, exception.what());
        }
    });
    if (!has_replied) {
        guarded([&] { refuse(raw->id, "the service failed with an internal error"); });
    }
    release(context);
    release_all();
}

}  // namespace detail
/// @endcond

}  // namespace RECT_ABI
}  // namespace rect

#endif
