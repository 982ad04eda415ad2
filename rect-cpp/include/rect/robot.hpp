/// @file
/// Owns a program's place among the robots: what it says, hears, asks, serves and knows.
#ifndef RECT_ROBOT_HPP
#define RECT_ROBOT_HPP

#include <chrono>
#include <cstdint>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "callback.hpp"
#include "connection.hpp"
#include "dictionary.hpp"
#include "message.hpp"
#include "numbers.hpp"
#include "options.hpp"
#include "service.hpp"
#include "stream.hpp"
#include "transfer.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A program of a robot, joined with the others. All may be called by several threads at a time, and in callbacks. The
/// session ends with the last of the robot and what was made by it, or with `close`.
///
/// What can be said is text, bytes (a span or vector of `std::uint8_t`), a Picture, a Payload, and whatever has an Adapter:
/// with `rect/nlohmann.hpp` all that nlohmann::json can write.
class Robot : public Handle {
    using Milliseconds = std::chrono::milliseconds;

public:
    using Handle::Handle;

    /// Its name.
    [[nodiscard]] expected<std::string> name() const {
        char name[RECT_NAME_BYTES];
        rect_error error;
        const auto code = rect_robot_name(raw(), &name, &error);
        return detail::got<std::string>(code, error, [&] { return std::string(name); });
    }

    /// The same robot, speaking with that urgency: `robot.with(rect::Urgency::urgent)`.
    [[nodiscard]] expected<Robot> with(Urgency urgency) const {
        return same([&](rect_robot* same, rect_error* error) {
            return rect_robot_with(raw(), static_cast<std::uint32_t>(urgency), same, error);
        });
    }

    /// The same robot; what it says goes through that codec: `robot.encoded("zstd:9")`.
    [[nodiscard]] expected<Robot> encoded(const Text& codec) const {
        return same([&](rect_robot* same, rect_error* error) {
            return rect_robot_encoded(raw(), codec.c_str(), same, error);
        });
    }

    /// The same robot; what it says is packed with that dictionary, which others fetch by themselves.
    [[nodiscard]] expected<Robot> packed_with(const Dictionary& dictionary) const {
        return same([&](rect_robot* same, rect_error* error) {
            return rect_robot_packed_with(raw(), {dictionary.id()}, same, error);
        });
    }

    /// Says it to all. Waits for room where a large payload finds none.
    template <class T>
    expected<void> publish(const Text& topic, const T& value) const {
        return detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::done(rect_robot_publish(raw(), topic.c_str(), &payload, &error), error);
        });
    }

    /// Says it to one robot alone. Nobody is asked whether it is there: `request` does that.
    template <class T>
    expected<void> send(const Text& to, const Text& topic, const T& value) const {
        return detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::done(rect_robot_send(raw(), to.c_str(), topic.c_str(), &payload, &error), error);
        });
    }

    /// The next message of the robot `from` about `topic`, to all or to this one alone, that is sent from now on.
    [[nodiscard]] expected<Message> listen(const Text& from, const Text& topic, Milliseconds timeout) const {
        rect_message message;
        rect_error error;
        const auto code =
            rect_robot_listen(raw(), from.c_str(), topic.c_str(), detail::ms(timeout), &message, &error);
        return detail::got<Message>(code, error, [&] { return Message(message); });
    }

    /// The messages of a pattern, `<robot>/<topic>` with wildcards, as `*/arm/*`: what those robots say to all, and to this
    /// one alone. They wait until they are taken.
    [[nodiscard]] expected<Subscriber> subscribe(const Text& pattern, Receiving receiving = {}) const {
        const auto waiting = detail::raw(receiving);
        rect_subscriber subscriber;
        rect_error error;
        const auto code = rect_robot_subscribe(raw(), pattern.c_str(), &waiting, &subscriber, &error);
        return detail::got<Subscriber>(code, error, [&] { return Subscriber(subscriber.id); });
    }

    /// Calls `function(const rect::MessageView&)` for each message of a pattern, one after another, on a thread of its own,
    /// until what this returns ends. It may use all of RECT. What it throws is reported (`rect::on_callback_error`).
    template <class F, class = std::enable_if_t<std::is_invocable_v<std::decay_t<F>&, const MessageView&>>>
    [[nodiscard]] expected<Subscription> subscribe(const Text& pattern, F&& function, Receiving receiving = {}) const {
        const auto waiting = detail::raw(receiving);
        return called(std::forward<F>(function), [&](auto& callback, rect_subscription* made, rect_error* error) {
            using C = std::decay_t<decltype(callback)>;
            return rect_robot_on_message(raw(), pattern.c_str(), &waiting, C::template call<rect_message, MessageView>,
                                         callback.context(), C::done, made, error);
        });
    }

    /// Asks a service of a robot, and waits for its first answer. Code::service: it answers with an error; Code::no_service:
    /// nobody serves that there.
    template <class T>
    [[nodiscard]] expected<Reply> request(const Text& of, const Text& topic, const T& value, Milliseconds timeout) const {
        rect_reply reply;
        const auto asked = detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::done(
                rect_robot_request(raw(), of.c_str(), topic.c_str(), &payload, detail::ms(timeout), &reply, &error), error);
        });
        return asked ? expected<Reply>(Reply(reply)) : unexpected<Error>(asked.error());
    }

    /// Asks a service of all robots that have it; answers come until all have answered, or the time is over.
    template <class T>
    [[nodiscard]] expected<Replies> request_all(const Text& topic, const T& value, Milliseconds timeout) const {
        rect_replies replies{};
        const auto asked = detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::done(
                rect_robot_request_all(raw(), topic.c_str(), &payload, detail::ms(timeout), &replies, &error), error);
        });
        return asked ? expected<Replies>(Replies(replies.id)) : unexpected<Error>(asked.error());
    }

    /// Serves `topic` by `function(const rect::Request&)`: what it returns is the answer. A Refusal that it throws, or the
    /// error of an `expected` that it returns, is answered as an error. Up to 16 requests are worked on at a time, on several
    /// threads, until what this returns ends. It may use all of RECT.
    template <class F>
    [[nodiscard]] expected<Service> serve(const Text& topic, F&& function) const {
        detail::Callback<std::decay_t<F>> callback(std::forward<F>(function));
        rect_service service;
        rect_error error;
        const auto code = rect_robot_serve(raw(), topic.c_str(), detail::serve<std::decay_t<F>>, callback.context(),
                                           decltype(callback)::done, &service, &error);
        return detail::got<Service>(code, error, [&] { return Service(service.id); });
    }

    /// A stream of which the newest frame counts: what is old, a slow link drops.
    [[nodiscard]] expected<Stream> stream(const Text& topic, StreamOptions options = {}) const {
        const rect_stream_options how{static_cast<std::uint32_t>(options.mode), options.webp, options.most_frames_per_s,
                                      options.least_frames_per_s};
        rect_stream stream;
        rect_error error;
        const auto code = rect_robot_stream(raw(), topic.c_str(), &how, &stream, &error);
        return detail::got<Stream>(code, error, [&] { return Stream(stream.id); });
    }

    /// Watches a robot's stream: the newest frame waits until it is taken.
    [[nodiscard]] expected<Watch> watch(const Text& from, const Text& topic, Receiving receiving = {}) const {
        const auto waiting = detail::raw(receiving);
        rect_watch watch;
        rect_error error;
        const auto code = rect_robot_watch(raw(), from.c_str(), topic.c_str(), &waiting, &watch, &error);
        return detail::got<Watch>(code, error, [&] { return Watch(watch.id); });
    }

    /// Calls `function(const rect::FrameView&)` for each frame of a robot's stream, as `subscribe` does for messages; while it
    /// runs, older frames are dropped.
    template <class F, class = std::enable_if_t<std::is_invocable_v<std::decay_t<F>&, const FrameView&>>>
    [[nodiscard]] expected<Subscription> watch(const Text& from, const Text& topic, F&& function,
                                               Receiving receiving = {}) const {
        const auto waiting = detail::raw(receiving);
        return called(std::forward<F>(function), [&](auto& callback, rect_subscription* made, rect_error* error) {
            using C = std::decay_t<decltype(callback)>;
            return rect_robot_on_frame(raw(), from.c_str(), topic.c_str(), &waiting, C::template call<rect_frame, FrameView>,
                                       callback.context(), C::done, made, error);
        });
    }

    /// Transfers a File, or whatever can be said, of any size to one robot, and waits until all is there and right.
    template <class T>
    expected<void> transfer(const Text& to, const Text& topic, const T& source, const TransferOptions& options = {}) const {
        return transfer(to, topic, source, options, [](const Progress&) {});
    }

    /// The same; calls `function(const rect::Progress&)` up to ten times a second, on the transfer's thread.
    template <class T, class F>
    expected<void> transfer(const Text& to, const Text& topic, const T& source, const TransferOptions& options,
                            F&& function) const {
        const auto begun = begin_transfer(to, topic, source, options, [&](const Progress& progress) { function(progress); });
        return begun ? begun->wait() : unexpected<Error>(begun.error());
    }

    /// Begins to transfer it, and does not wait: it goes on until it ends, or what this returns does.
    template <class T>
    [[nodiscard]] expected<Transfer> begin_transfer(const Text& to, const Text& topic, const T& source,
                                                    const TransferOptions& options = {}) const {
        return begin_transfer(to, topic, source, options, [](const Progress&) {});
    }

    /// The same; calls `function(const rect::Progress&)` up to ten times a second, on the transfer's thread. It may end its own
    /// transfer, and must not wait for it.
    template <class T, class F>
    [[nodiscard]] expected<Transfer> begin_transfer(const Text& to, const Text& topic, const T& source,
                                                    const TransferOptions& options, F&& function) const {
        using C = detail::Callback<std::decay_t<F>>;
        rect_transfer transfer{};
        const auto go = [&](const char* file, const rect_payload& payload) {
            const rect_transfer_options how{file, payload, detail::or_null(options.name), detail::or_null(options.encoding),
                                            detail::ms(options.patience)};
            const C callback(std::forward<F>(function));
            rect_error error;
            const auto code =
                rect_robot_begin_transfer(raw(), to.c_str(), topic.c_str(), &how, C::template call<rect_progress, Progress>,
                                          callback.context(), C::done, &transfer, &error);
            return detail::done(code, error);
        };
        const auto begun = [&] {
            if constexpr (std::is_same_v<T, File>) {
                return go(source.path.c_str(), rect_payload{});
            } else {
                return detail::with_payload(source, [&](const rect_payload& payload) { return go(nullptr, payload); });
            }
        }();
        return begun ? expected<Transfer>(Transfer(transfer.id)) : unexpected<Error>(begun.error());
    }

    /// Takes the transfers of a pattern, as `*/maps/*`, that others send to this robot, until what this returns ends. Without
    /// it none is taken.
    [[nodiscard]] expected<Transfers> receive_transfers(const Text& pattern, const ReceiveOptions& options) const {
        const rect_receive_options how{detail::or_null(options.folder), options.max_bytes, options.at_once,
                                       detail::ms(options.patience)};
        rect_transfers transfers;
        rect_error error;
        const auto code = rect_robot_receive_transfers(raw(), pattern.c_str(), &how, &transfers, &error);
        return detail::got<Transfers>(code, error, [&] { return Transfers(transfers.id); });
    }

    /// The other robots of the fleet that are there now, by name.
    [[nodiscard]] expected<std::vector<std::string>> peers() const {
        rect_names names;
        rect_error error;
        const auto code = rect_robot_peers(raw(), &names, &error);
        return detail::got<std::vector<std::string>>(code, error, [&] {
            const Handle handle(names.id);
            std::vector<std::string> all;
            for (const auto& name : span<const rect_text>(names.items, names.len)) {
                all.emplace_back(detail::view(name));
            }
            return all;
        });
    }

    /// The connections of a router. `which`: all, or as `method=ble`, `peer=wombat-2;state=connected` (docs/registry.md);
    /// `of`: of which robot; empty: of this one.
    [[nodiscard]] expected<std::vector<Connection>> connections(const Text& which = "", const std::string& of = {}) const {
        rect_connections connections;
        rect_error error;
        const auto code = rect_robot_connections(raw(), detail::or_null(of), which.c_str(), &connections, &error);
        return detail::got<std::vector<Connection>>(code, error, [&] {
            const Handle handle(connections.id);
            std::vector<Connection> all;
            for (const auto& one : span<const rect_connection>(connections.items, connections.len)) {
                all.emplace_back(one);
            }
            return all;
        });
    }

    /// Any question of the registry, as `connections/count` or `status` (docs/registry.md); the answer is JSON.
    [[nodiscard]] expected<std::string> ask_registry(const Text& question, const Text& which = "",
                                                     const std::string& of = {}) const {
        rect_string answer;
        rect_error error;
        const auto code =
            rect_robot_ask_registry(raw(), detail::or_null(of), question.c_str(), which.c_str(), &answer, &error);
        return detail::got<std::string>(code, error, [&] {
            const Handle handle(answer.id);
            return std::string(detail::view(answer.text));
        });
    }

    /// Gives a router a connection, instead of the one of that name if it has one; it is dialled from now on, and after a
    /// restart. `of`: of which robot, whose access control has to allow that; empty: of this one.
    expected<void> add_connection(const NamedConnection& connection, const std::string& of = {}) const {
        const rect_named_connection one{connection.name.c_str(), connection.method.c_str(), connection.address.c_str(),
                                        connection.port,         connection.psm,            detail::or_null(connection.options)};
        rect_error error;
        return detail::done(rect_robot_add_connection(raw(), detail::or_null(of), &one, &error), error);
    }

    /// Takes a connection from a router; its link ends.
    expected<void> remove_connection(const Text& name, const std::string& of = {}) const {
        rect_error error;
        return detail::done(rect_robot_remove_connection(raw(), detail::or_null(of), name.c_str(), &error), error);
    }

    /// Calls `function(const rect::Event&)` for each change of who can be reached, as `subscribe` does for messages, and first
    /// of all for who is there already.
    template <class F>
    [[nodiscard]] expected<Subscription> on_state(F&& function) const {
        return called(std::forward<F>(function), [&](auto& callback, rect_subscription* made, rect_error* error) {
            using C = std::decay_t<decltype(callback)>;
            return rect_robot_on_state(raw(), C::template call<rect_event, Event>, callback.context(), C::done, made, error);
        });
    }

    /// What this program has said and heard.
    [[nodiscard]] expected<Counters> counters() const {
        Counters counters;
        rect_error error;
        const auto code = rect_robot_counters(raw(), &counters, &error);
        return detail::got<Counters>(code, error, [&] { return counters; });
    }

    /// Ends the session now, and all that belongs to it.
    expected<void> close() const {
        rect_error error;
        return detail::done(rect_robot_close(raw(), &error), error);
    }

    /// For functions of rect.h.
    [[nodiscard]] rect_robot raw() const noexcept { return {id()}; }

private:
    template <class Make>
    expected<Robot> same(Make make) const {
        rect_robot robot;
        rect_error error;
        const auto code = make(&robot, &error);
        return detail::got<Robot>(code, error, [&] { return Robot(robot.id); });
    }

    template <class F, class Make>
    static expected<Subscription> called(F&& function, Make make) {
        detail::Callback<std::decay_t<F>> callback(std::forward<F>(function));
        rect_subscription subscription;
        rect_error error;
        const auto code = make(callback, &subscription, &error);
        return detail::got<Subscription>(code, error, [&] { return Subscription(subscription.id); });
    }
};

/// Joins as a program of that robot: at the router of this computer, or as the options say. Waits until the router answers.
[[nodiscard]] inline expected<Robot> connect(const Text& robot, const Options& options = {}) {
    return detail::with_options(options, [&](const rect_options& raw) {
        rect_robot joined;
        rect_error error;
        const auto code = rect_connect(robot.c_str(), &raw, &joined, &error);
        return detail::got<Robot>(code, error, [&] { return Robot(joined.id); });
    });
}

/// The version of the library, as `0.1.0`.
[[nodiscard]] inline const char* version() noexcept { return rect_version(); }

}  // namespace RECT_ABI
}  // namespace rect

#endif
