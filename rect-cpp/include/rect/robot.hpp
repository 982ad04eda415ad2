/// @file
/// Connects a program to the other robots: rect::connect and rect::Robot.
#ifndef RECT_ROBOT_HPP
#define RECT_ROBOT_HPP

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "action.hpp"
#include "callback.hpp"
#include "connection.hpp"
#include "deadman.hpp"
#include "dictionary.hpp"
#include "log.hpp"
#include "message.hpp"
#include "numbers.hpp"
#include "options.hpp"
#include "parameters.hpp"
#include "publisher.hpp"
#include "recorder.hpp"
#include "service.hpp"
#include "stop.hpp"
#include "stream.hpp"
#include "transfer.hpp"
#include "typed.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A handle of a program's session, through which it communicates as one robot of the fleet. All functions may be called by
/// several threads at a time, and in callbacks. The session ends when all handles of the robot and everything that was
/// created with them are destroyed, or with `close`.
///
/// The values that can be published, sent and transferred are text, bytes (a span or vector of `std::uint8_t`), numbers,
/// bools, a Picture, a Payload, and all types that have an Adapter. `rect/nlohmann.hpp` adds all types that nlohmann::json
/// can write.
///
///     const auto robot = rect::must(rect::connect("wombat-1"));
///     const auto angles = rect::must(robot.subscribe("*/arm/*", [](const rect::MessageView& message) {
///         std::cout << message.sender() << ": " << message.payload.text().value_or("?") << std::endl;
///     }));
///     rect::must(robot.publish("arm/angle", 12.5));
class Robot : public Handle {
    using Milliseconds = std::chrono::milliseconds;

public:
    using Handle::Handle;

    /// Returns the name of the robot.
    [[nodiscard]] expected<std::string> name() const {
        char name[RECT_NAME_BYTES];
        rect_error error;
        const auto code = rect_robot_name(raw(), &name, &error);
        return detail::value_or_error<std::string>(code, error, [&] { return std::string(name); });
    }

    /// Returns the name of the fleet.
    [[nodiscard]] expected<std::string> fleet() const {
        char fleet[RECT_NAME_BYTES];
        rect_error error;
        const auto code = rect_robot_fleet(raw(), &fleet, &error);
        return detail::value_or_error<std::string>(code, error, [&] { return std::string(fleet); });
    }

    /// Returns a handle of the same robot whose messages and requests have another urgency:
    /// `robot.with_urgency(rect::Urgency::urgent)`.
    [[nodiscard]] expected<Robot> with_urgency(Urgency urgency) const {
        return derive([&](rect_robot* derived, rect_error* error) {
            return rect_robot_with_urgency(raw(), static_cast<std::uint32_t>(urgency), derived, error);
        });
    }

    /// Returns a handle of the same robot whose messages expire: they are dropped rather than delivered later than this after
    /// they were sent. For commands such as steering: `robot.expires_after(std::chrono::milliseconds(200))`.
    [[nodiscard]] expected<Robot> expires_after(Milliseconds lifetime) const {
        return derive([&](rect_robot* derived, rect_error* error) {
            return rect_robot_expires_after(raw(), detail::ms(lifetime), derived, error);
        });
    }

    /// Returns a handle of the same robot whose `request` is repeated while the link or a router is interrupted, and is carried out at
    /// most once: `robot.retrying()`. The request names the run of the program that serves the topic, which carries it out once and
    /// repeats its first reply. A program that was restarted refuses it (Code::interrupted). The timeout is at most 10 minutes
    /// (Code::option). `rect_robot_retrying` in rect.h states how long replies are kept.
    [[nodiscard]] expected<Robot> retrying() const {
        return derive([&](rect_robot* derived, rect_error* error) { return rect_robot_retrying(raw(), derived, error); });
    }

    /// Returns a handle of the same robot that retains what it publishes: the router of this robot keeps the last value of each topic,
    /// and programs that start later, or whose link was interrupted, receive it.
    ///
    /// A subscription receives the value first, then each change, never one twice or an older one after a newer one
    /// (MessageView::retained). The value stays when this program ends. Requests, streams and messages to one robot are not affected,
    /// and retained messages do not expire.
    ///
    /// `publish` then waits for the router, and fails with Code::not_retained if the value is not kept: it has more than 64 kB, the
    /// values of the robot have more than 256 kB, or no router keeps values.
    [[nodiscard]] expected<Robot> retained() const {
        return derive([&](rect_robot* derived, rect_error* error) { return rect_robot_retained(raw(), derived, error); });
    }

    /// Returns a handle as `retained` does, whose values also survive a restart of the robot. The router writes each value to its disk
    /// before it is published: for values that change rarely, such as a calibration.
    [[nodiscard]] expected<Robot> retained_on_disk() const {
        return derive([&](rect_robot* derived, rect_error* error) { return rect_robot_retained_on_disk(raw(), derived, error); });
    }

    /// Returns a handle of the same robot that encodes the payloads of its messages and requests:
    /// `robot.with_codec("zstd:9")`. Receivers decode them automatically. Fails with Code::codec if the codec is unknown.
    [[nodiscard]] expected<Robot> with_codec(const Text& codec) const {
        return derive([&](rect_robot* derived, rect_error* error) {
            return rect_robot_with_codec(raw(), codec.c_str(), derived, error);
        });
    }

    /// Returns a handle of the same robot that compresses the payloads of its messages and requests with a dictionary. Small
    /// JSON messages become much smaller. Receivers fetch the dictionary once, automatically.
    [[nodiscard]] expected<Robot> with_dictionary(const Dictionary& dictionary) const {
        return derive([&](rect_robot* derived, rect_error* error) {
            return rect_robot_with_dictionary(raw(), {dictionary.handle_id()}, derived, error);
        });
    }

    /// Publishes a value on `topic` to every subscriber. Blocks while the send queue has no room for a large value. Fails
    /// with Code::topic if the topic is invalid, and with Code::payload or Code::codec if the value cannot be encoded.
    template <class T>
    expected<void> publish(const Text& topic, const T& value) const {
        return detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::ok_or_error(rect_robot_publish(raw(), topic.c_str(), &payload, &error), error);
        });
    }

    /// Returns the last value of a retained topic of the robot `sender`: a MessageOf with `latest<Battery>(...)`, otherwise a Message.
    /// Nothing if that robot retains none, is not reachable, or does not answer within `timeout`. The answer comes from the router of this
    /// robot if one of its programs subscribes to the topic, and otherwise from that of `sender`. Fails with Code::name or Code::topic if
    /// an argument is invalid.
    template <class T = void>
    [[nodiscard]] auto latest(const Text& sender, const Text& topic, Milliseconds timeout = default_timeout) const
        -> expected<std::optional<typename detail::Typed<T>::Message>> {
        using Typed = detail::Typed<T>;
        using Found = std::optional<typename Typed::Message>;
        rect_message message;
        rect_error error;
        const auto code = rect_robot_latest(raw(), sender.c_str(), topic.c_str(), detail::ms(timeout), &message, &error);
        return detail::value_or_error<Found>(
            code, error, [&] { return message.id == 0 ? Found() : Found(Typed::message(message, raw())); });
    }

    /// Forgets a retained topic of this robot. Subscribers receive that as a message without a value (Retained::is_forgotten). Nothing
    /// happens if the topic has no value. Fails with Code::topic if the topic is invalid, and with Code::not_retained if no router keeps
    /// values.
    expected<void> forget(const Text& topic) const {
        rect_error error;
        return detail::ok_or_error(rect_robot_forget(raw(), topic.c_str(), &error), error);
    }

    /// Creates a publisher of `topic`, with the urgency, codec, expiry and retention of this handle: a PublisherOf with
    /// `publisher<Battery>("battery")`, otherwise a Publisher of any values. Fails with Code::topic if the topic is invalid.
    template <class T = void>
    [[nodiscard]] expected<typename detail::Typed<T>::Publisher> publisher(const Text& topic) const {
        using Created = typename detail::Typed<T>::Publisher;
        rect_publisher publisher;
        rect_error error;
        const auto code = rect_robot_publisher(raw(), topic.c_str(), &publisher, &error);
        return detail::value_or_error<Created>(code, error, [&] { return Created(publisher.id); });
    }

    /// Records messages to the file `path`, which ends in `.mcap`, until Recorder::finish is called, with the events of this robot,
    /// the requests to its services, the lines that programs log and, once a second, the state of its router's links. Until then, the
    /// recording is a folder of short files, so that a power cut costs at most its last seconds.
    ///
    /// Recording never delays the program: what a slow or full disk does not take waits in 8 MB of memory, and is then dropped and
    /// counted, urgent messages last.
    ///
    /// Fails with Code::recording if there is a recording of that name or the folder cannot be written, and with Code::topic if a
    /// pattern is invalid.
    [[nodiscard]] expected<Recorder> record(const Text& path, const RecordOptions& options = {}) const {
        const auto patterns = detail::pointers(options.patterns);
        rect_record_options raw{};
        raw.patterns = patterns.data();
        raw.patterns_len = patterns.size();
        raw.keep_ms = static_cast<std::uint64_t>(options.keep.count());
        raw.split_ms = static_cast<std::uint64_t>(options.split.count());
        raw.split_bytes = options.split_bytes;
        raw.without_logs = options.without_logs;
        rect_recorder recorder;
        rect_error error;
        const auto code = rect_robot_record(this->raw(), path.c_str(), &raw, &recorder, &error);
        return detail::value_or_error<Recorder>(code, error, [&] { return Recorder(recorder.id); });
    }

    /// Sends a value on `topic` to one robot only. Nothing confirms that a program of the robot has received it; use `request` if
    /// a reply is needed. Fails like `publish`, with Code::name if the recipient is invalid, and with Code::not_reachable if it is not
    /// reachable now: the first time after up to half a second, later at once. A program that sends to a robot which comes and goes
    /// ignores that error, and one that has just started waits first (wait_for_peer).
    template <class T>
    expected<void> send(const Text& recipient, const Text& topic, const T& value) const {
        return detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::ok_or_error(rect_robot_send(raw(), recipient.c_str(), topic.c_str(), &payload, &error), error);
        });
    }

    /// Waits for the next message that matches `pattern`, published or sent to this robot: a MessageOf with
    /// `wait_for_message<Battery>(...)`, otherwise a Message. Earlier messages are not returned. Fails with Code::timed_out if there
    /// is none within `timeout`.
    template <class T = void>
    [[nodiscard]] expected<typename detail::Typed<T>::Message> wait_for_message(const Text& pattern, Milliseconds timeout) const {
        using Typed = detail::Typed<T>;
        rect_message message;
        rect_error error;
        const auto code = rect_robot_wait_for_message(raw(), pattern.c_str(), detail::ms(timeout), &message, &error);
        return detail::value_or_error<typename Typed::Message>(code, error, [&] { return Typed::message(message, raw()); });
    }

    /// Subscribes to a pattern: `<robot>/<topic>` with wildcards, e.g. `*/arm/*`. The Subscriber receives the matching
    /// messages that are published, and those that are sent to this robot: a SubscriberOf with `subscribe<Battery>("*/battery")`,
    /// otherwise a Subscriber of any values. Fails with Code::topic or Code::name if the pattern is invalid, and with Code::option if an
    /// option is.
    template <class T = void>
    [[nodiscard]] expected<typename detail::Typed<T>::Subscriber> subscribe(const Text& pattern, SubscribeOptions options = {}) const {
        using Typed = detail::Typed<T>;
        const auto raw_options = detail::raw(options);
        rect_subscriber subscriber;
        rect_error error;
        const auto code = rect_robot_subscribe(raw(), pattern.c_str(), &raw_options, &subscriber, &error);
        return detail::value_or_error<typename Typed::Subscriber>(code, error,
                                                                  [&] { return Typed::subscriber(subscriber.id, raw()); });
    }

    /// Calls `function(const rect::MessageView&)`, or with `subscribe<Battery>(...)` `function(const rect::MessageOf<Battery>&)`, for
    /// each message that matches a pattern, one after another, on a thread of its own, until the Subscription is destroyed. The
    /// function may use all of RECT. Exceptions that it throws are passed to the function of rect::on_callback_error. Fails with
    /// Code::topic or Code::name if the pattern is invalid.
    template <class T = void, class F,
              class = std::enable_if_t<std::is_invocable_v<std::decay_t<F>&, const typename detail::Typed<T>::MessageView&>>>
    [[nodiscard]] expected<Subscription> subscribe(const Text& pattern, F&& function, SubscribeOptions options = {}) const {
        const auto raw_options = detail::raw(options);
        auto on_message = [function = std::decay_t<F>(std::forward<F>(function)), robot = raw()](const MessageView& message) mutable {
            function(detail::Typed<T>::view(message, robot));
        };
        return with_callback(std::move(on_message), [&](auto& callback, rect_subscription* subscription, rect_error* error) {
            using C = std::decay_t<decltype(callback)>;
            return rect_robot_on_message(raw(), pattern.c_str(), &raw_options, C::template call<rect_message, MessageView>,
                                         callback.context(), C::release, subscription, error);
        });
    }

    /// Sends a request to the service `topic` of the robot `recipient`, and waits for the first reply: a ReplyOf with
    /// `request<Pose>(...)`, otherwise a Reply with any value.
    ///
    /// Fails with Code::service if the service replies with an error, with Code::no_service if the robot does not offer the
    /// service or is not reachable, with Code::interrupted if it may have received the request and does not reply because its
    /// program ended, or a router or link did, with Code::timed_out if there is no reply within `timeout`, and with Code::payload if the value
    /// of the reply does not fit.
    template <class R = void, class T>
    [[nodiscard]] expected<typename detail::Typed<R>::Reply> request(const Text& recipient, const Text& topic, const T& value,
                                                                     Milliseconds timeout = default_timeout) const {
        rect_reply reply;
        const auto requested = detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            const auto code =
                rect_robot_request(raw(), recipient.c_str(), topic.c_str(), &payload, detail::ms(timeout), &reply, &error);
            return detail::ok_or_error(code, error);
        });
        return requested ? detail::Typed<R>::reply(Reply(reply)) : unexpected<Error>(requested.error());
    }

    /// Sends a request to the service `topic` of every robot that offers it. The replies, RepliesOf with `request_all<Pose>(...)`,
    /// arrive until all robots have replied or `timeout` has passed.
    template <class R = void, class T>
    [[nodiscard]] auto request_all(const Text& topic, const T& value, Milliseconds timeout = default_timeout) const
        -> expected<std::conditional_t<std::is_void_v<R>, Replies, RepliesOf<R>>> {
        using Created = std::conditional_t<std::is_void_v<R>, Replies, RepliesOf<R>>;
        rect_replies replies{};
        const auto requested = detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::ok_or_error(
                rect_robot_request_all(raw(), topic.c_str(), &payload, detail::ms(timeout), &replies, &error), error);
        });
        return requested ? expected<Created>(Created(replies.id)) : unexpected<Error>(requested.error());
    }

    /// Sends a request to the service `topic` of every robot that offers it, waits until all have replied or `timeout` has passed, and
    /// returns the outcome of each robot. An error of one robot does not end the wait. The robots that offer it are those whose
    /// catalogue lists it. A missing one has Code::timed_out, or Code::interrupted if its program, a router or the link ended. Fails with
    /// Code::no_service if no program of the fleet serves the topic; with Code::interrupted if nobody replied and a program has begun,
    /// ended or changed its services meanwhile, so that one may have carried the request out; and with Code::timed_out if nobody has
    /// replied in time that a catalogue lists.
    template <class T>
    [[nodiscard]] expected<Gathered> gather(const Text& topic, const T& value, Milliseconds timeout = default_timeout) const {
        rect_gathered gathered{};
        const auto requested = detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::ok_or_error(
                rect_robot_gather(raw(), topic.c_str(), &payload, detail::ms(timeout), &gathered, &error), error);
        });
        return requested ? expected<Gathered>(Gathered(gathered)) : unexpected<Error>(requested.error());
    }

    /// Sends a request to the service `topic` of `recipient`, which sends several replies, such as the results of a scan. The last call of
    /// `next` fails with Code::end after all of them, and with Code::interrupted if the program, a router or the link ended midway. All
    /// replies, RepliesOf with `request_stream<Pose>(...)`, have to arrive within `timeout`.
    template <class R = void, class T>
    [[nodiscard]] auto request_stream(const Text& recipient, const Text& topic, const T& value,
                                      Milliseconds timeout = default_timeout) const
        -> expected<std::conditional_t<std::is_void_v<R>, Replies, RepliesOf<R>>> {
        using Created = std::conditional_t<std::is_void_v<R>, Replies, RepliesOf<R>>;
        rect_replies replies{};
        const auto requested = detail::with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return detail::ok_or_error(rect_robot_request_stream(raw(), recipient.c_str(), topic.c_str(), &payload,
                                                                 detail::ms(timeout), &replies, &error),
                                       error);
        });
        return requested ? expected<Created>(Created(replies.id)) : unexpected<Error>(requested.error());
    }

    /// Serves requests to `topic` with `function(const rect::Request&)`, which returns the reply. If the function throws a
    /// Refusal, or returns an `expected` with an error, the service replies with that error. After any other exception it
    /// replies that it has failed with an internal error, and the exception is passed to the function of
    /// rect::on_callback_error.
    ///
    /// Up to 16 requests are handled at a time, on several threads, until the Service is destroyed. The function may use all
    /// of RECT. Fails with Code::topic if the topic is invalid, and with Code::service_refused if a program of this robot serves it
    /// already.
    template <class F>
    [[nodiscard]] expected<Service> serve(const Text& topic, F&& function, const ServiceOptions& options = {}) const {
        detail::Callback<std::decay_t<F>> callback(std::forward<F>(function));
        rect_service_options raw_options{};
        raw_options.about = options.about.c_str();
        raw_options.allow_several = options.allow_several;
        rect_service service;
        rect_error error;
        const auto code = rect_robot_serve(raw(), topic.c_str(), &raw_options, detail::serve<std::decay_t<F>>,
                                           callback.context(), decltype(callback)::release, &service, &error);
        return detail::value_or_error<Service>(code, error, [&] { return Service(service.id); });
    }

    /// Creates a stream of which only the newest frame matters: a slow link drops older ones. Fails with Code::topic if the
    /// topic is invalid, and with Code::option if an option is out of range.
    [[nodiscard]] expected<StreamSender> stream(const Text& topic, StreamOptions options = {}) const {
        rect_stream_options raw_options{};
        raw_options.mode = static_cast<std::uint32_t>(options.mode);
        raw_options.webp = options.webp;
        raw_options.max_frames_per_s = options.max_frames_per_s;
        raw_options.min_frames_per_s = options.min_frames_per_s;
        raw_options.max_bytes_per_s = options.max_bytes_per_s;
        raw_options.feedback_interval_ms = detail::ms(options.feedback_interval);
        rect_stream_sender stream;
        rect_error error;
        const auto code = rect_robot_stream(raw(), topic.c_str(), &raw_options, &stream, &error);
        return detail::value_or_error<StreamSender>(code, error, [&] { return StreamSender(stream.id); });
    }

    /// Receives a stream, `<robot>/<topic>`. By default only the newest frame waits for the program. Fails with Code::topic if the
    /// robot or topic is invalid.
    [[nodiscard]] expected<Watcher> watch(const Text& stream, QueueOptions queue = {}) const {
        const auto raw_queue = detail::raw(queue);
        rect_watcher watcher;
        rect_error error;
        const auto code = rect_robot_watch(raw(), stream.c_str(), &raw_queue, &watcher, &error);
        return detail::value_or_error<Watcher>(code, error, [&] { return Watcher(watcher.id); });
    }

    /// Does what `watch` does, but leaves video undecoded: the payloads are the frames as they were sent, from a key frame on,
    /// with the encoding `video/h264`. A program that saves or forwards them needs them all, and so a larger `queue`.
    [[nodiscard]] expected<Watcher> watch_undecoded(const Text& stream, QueueOptions queue = {}) const {
        const auto raw_queue = detail::raw(queue);
        rect_watcher watcher;
        rect_error error;
        const auto code = rect_robot_watch_undecoded(raw(), stream.c_str(), &raw_queue, &watcher, &error);
        return detail::value_or_error<Watcher>(code, error, [&] { return Watcher(watcher.id); });
    }

    /// Calls `function(const rect::FrameView&)` for each frame of a stream, like `subscribe` does for messages. Frames that
    /// arrive during a call wait or are dropped as `queue` specifies; by default only the newest one is kept.
    template <class F, class = std::enable_if_t<std::is_invocable_v<std::decay_t<F>&, const FrameView&>>>
    [[nodiscard]] expected<Subscription> watch(const Text& stream, F&& function, QueueOptions queue = {}) const {
        const auto raw_queue = detail::raw(queue);
        return with_callback(std::forward<F>(function), [&](auto& callback, rect_subscription* subscription, rect_error* error) {
            using C = std::decay_t<decltype(callback)>;
            return rect_robot_on_frame(raw(), stream.c_str(), &raw_queue, C::template call<rect_frame, FrameView>,
                                       callback.context(), C::release, subscription, error);
        });
    }

    /// Transfers a File, or a value of any size, to the robot `recipient`, and waits until it is complete and verified.
    ///
    /// Fails with Code::name or Code::topic if an argument is invalid, with Code::transfer_refused or Code::transfer_failed,
    /// with Code::file if the file cannot be read, and with Code::timed_out if `options.timeout` has expired.
    template <class T>
    expected<void> transfer(const Text& recipient, const Text& topic, const T& source,
                            const TransferOptions& options = {}) const {
        return transfer(recipient, topic, source, options, [](const Progress&) {});
    }

    /// Transfers like the overload above, and calls `function(const rect::Progress&)` up to ten times per second, on the
    /// thread of the transfer.
    template <class T, class F>
    expected<void> transfer(const Text& recipient, const Text& topic, const T& source, const TransferOptions& options,
                            F&& function) const {
        const auto on_progress = [&](const Progress& progress) { function(progress); };
        const auto transfer = begin_transfer(recipient, topic, source, options, on_progress);
        return transfer ? transfer->wait() : unexpected<Error>(transfer.error());
    }

    /// Starts a transfer without waiting for it. It runs until it is complete, fails, or the Transfer is destroyed. Fails
    /// with Code::name or Code::topic if the recipient or the topic is invalid; Transfer::wait returns all later errors.
    template <class T>
    [[nodiscard]] expected<Transfer> begin_transfer(const Text& recipient, const Text& topic, const T& source,
                                                    const TransferOptions& options = {}) const {
        return begin_transfer(recipient, topic, source, options, [](const Progress&) {});
    }

    /// Starts a transfer like the overload above, and calls `function(const rect::Progress&)` up to ten times per second, on
    /// the thread of the transfer. The function may end its own transfer, but must not wait for it.
    template <class T, class F>
    [[nodiscard]] expected<Transfer> begin_transfer(const Text& recipient, const Text& topic, const T& source,
                                                    const TransferOptions& options, F&& function) const {
        using C = detail::Callback<std::decay_t<F>>;
        rect_transfer transfer{};
        const auto start = [&](const char* file, const rect_payload& payload) {
            rect_transfer_options raw_options{};
            raw_options.file = file;
            raw_options.payload = payload;
            raw_options.name = detail::or_null(options.name);
            raw_options.encoding = detail::or_null(options.encoding);
            raw_options.timeout_ms = detail::ms(options.timeout);
            const C callback(std::forward<F>(function));
            rect_error error;
            const auto code = rect_robot_begin_transfer(raw(), recipient.c_str(), topic.c_str(), &raw_options,
                                                        C::template call<rect_progress, Progress>, callback.context(),
                                                        C::release, &transfer, &error);
            return detail::ok_or_error(code, error);
        };
        const auto started = [&] {
            if constexpr (std::is_same_v<T, File>) {
                return start(source.path.c_str(), rect_payload{});
            } else {
                return detail::with_payload(source, [&](const rect_payload& payload) { return start(nullptr, payload); });
            }
        }();
        return started ? expected<Transfer>(Transfer(transfer.id)) : unexpected<Error>(started.error());
    }

    /// Receives the transfers that others send to this robot and that match a pattern, e.g. `*/maps/*`, until the Transfers
    /// object is destroyed. Transfers whose topics match no receiver are refused.
    ///
    /// Fails with Code::topic or Code::name if the pattern is invalid, with Code::argument if `options.max_bytes` is 0, and
    /// with Code::file if the folder cannot be used.
    [[nodiscard]] expected<Transfers> receive_transfers(const Text& pattern, const ReceiveOptions& options) const {
        rect_receive_options raw_options{};
        raw_options.folder = detail::or_null(options.folder);
        raw_options.max_bytes = options.max_bytes;
        raw_options.max_concurrent = options.max_concurrent;
        raw_options.timeout_ms = detail::ms(options.timeout);
        rect_transfers transfers;
        rect_error error;
        const auto code = rect_robot_receive_transfers(raw(), pattern.c_str(), &raw_options, &transfers, &error);
        return detail::value_or_error<Transfers>(code, error, [&] { return Transfers(transfers.id); });
    }

    /// Returns the names of the other robots of the fleet that are reachable now.
    [[nodiscard]] expected<std::vector<std::string>> peers() const {
        rect_names names;
        rect_error error;
        const auto code = rect_robot_peers(raw(), &names, &error);
        return detail::value_or_error<std::vector<std::string>>(code, error, [&] {
            const Handle handle(names.id);
            std::vector<std::string> all;
            for (const auto& name : span<const rect_text>(names.items, names.len)) {
                all.emplace_back(detail::view(name));
            }
            return all;
        });
    }

    /// Waits until the robot `name` is reachable; returns at once if it is. Its programs may start later:
    /// Publisher::wait_for_subscriber waits for one that subscribes. Fails with Code::timed_out if the robot is not reachable
    /// within `timeout`, and with Code::name if the name is invalid.
    expected<void> wait_for_peer(const Text& name, Milliseconds timeout = forever) const {
        rect_error error;
        return detail::ok_or_error(rect_robot_wait_for_peer(raw(), name.c_str(), detail::ms(timeout), &error), error);
    }

    /// Waits until every reachable router knows the subscriptions and services of this program, so that messages and requests
    /// that other robots send from now on arrive. Declarations reach the other robots a moment after the calls that made them,
    /// later over a slow link. Without a router, the wait is for the directly linked programs. Fails with Code::timed_out if a
    /// router does not answer within `timeout`.
    expected<void> wait_until_established(Milliseconds timeout = forever) const {
        rect_error error;
        return detail::ok_or_error(rect_robot_wait_until_established(raw(), detail::ms(timeout), &error), error);
    }

    /// Returns the connections of a router. `filter` selects connections, e.g. `method=ble` or
    /// `peer=wombat-2;state=connected` (docs/reference/registry.md). `target` is the robot whose router is queried; empty means this
    /// robot. Fails with Code::no_service if the router does not answer.
    [[nodiscard]] expected<std::vector<Connection>> connections(const Text& filter = "", const std::string& target = {}) const {
        rect_connections connections;
        rect_error error;
        const auto code = rect_robot_connections(raw(), detail::or_null(target), filter.c_str(), &connections, &error);
        return detail::value_or_error<std::vector<Connection>>(code, error, [&] {
            const Handle handle(connections.id);
            std::vector<Connection> all;
            for (const auto& connection : span<const rect_connection>(connections.items, connections.len)) {
                all.emplace_back(connection);
            }
            return all;
        });
    }

    /// Returns what the programs of a robot serve, in the order in which the programs began. `target` is the robot; empty means this
    /// robot. An answer is kept until the robot's programs announce a change (at most once a second), so that asking again costs nothing
    /// on the air. Fails with Code::no_service if no router with a catalogue answers.
    [[nodiscard]] expected<std::vector<ServiceEntry>> services(const std::string& target = {}) const {
        rect_services services;
        rect_error error;
        const auto code = rect_robot_services(raw(), detail::or_null(target), &services, &error);
        return detail::value_or_error<std::vector<ServiceEntry>>(code, error, [&] {
            const Handle handle(services.id);
            std::vector<ServiceEntry> all;
            for (const auto& service : span<const rect_service_entry>(services.items, services.len)) {
                all.push_back({std::string(detail::view(service.topic)), std::string(detail::view(service.program)),
                               std::string(detail::view(service.about)), service.several});
            }
            return all;
        });
    }

    /// Sends any question to the registry of a router, e.g. `connections/count` or `status` (docs/reference/registry.md), and returns
    /// the answer, which is JSON. `filter` and `target` are the same as for `connections`.
    [[nodiscard]] expected<std::string> query_registry(const Text& question, const Text& filter = "",
                                                       const std::string& target = {}) const {
        rect_string answer;
        rect_error error;
        const auto code =
            rect_robot_query_registry(raw(), detail::or_null(target), question.c_str(), filter.c_str(), &answer, &error);
        return detail::value_or_error<std::string>(code, error, [&] {
            const Handle handle(answer.id);
            return std::string(detail::view(answer.text));
        });
    }

    /// Adds a named connection to a router, or replaces the one with the same name. The router dials it from now on, also
    /// after a restart. `target` is the robot whose router is changed; empty means this robot. The access control of another
    /// robot's router must permit the change. Fails with Code::service if the router rejects the connection.
    expected<void> add_connection(const NamedConnection& connection, const std::string& target = {}) const {
        rect_named_connection raw_connection{};
        raw_connection.name = connection.name.c_str();
        raw_connection.method = connection.method.c_str();
        raw_connection.address = connection.address.c_str();
        raw_connection.port = connection.port;
        raw_connection.psm = connection.psm;
        raw_connection.options = detail::or_null(connection.options);
        rect_error error;
        return detail::ok_or_error(rect_robot_add_connection(raw(), detail::or_null(target), &raw_connection, &error), error);
    }

    /// Removes a named connection from a router and closes its link. `target` is the same as for `add_connection`. Fails
    /// with Code::service if there is no connection with this name.
    expected<void> remove_connection(const Text& name, const std::string& target = {}) const {
        rect_error error;
        return detail::ok_or_error(rect_robot_remove_connection(raw(), detail::or_null(target), name.c_str(), &error), error);
    }

    /// Calls `function(const rect::Event&)` for each event, like `subscribe` does for messages: robots, programs, links and
    /// the router that become reachable or unreachable. The first calls report the robots and programs that are already
    /// reachable and the links that the router already has.
    template <class F>
    [[nodiscard]] expected<Subscription> on_event(F&& function) const {
        return with_callback(std::forward<F>(function), [&](auto& callback, rect_subscription* subscription, rect_error* error) {
            using C = std::decay_t<decltype(callback)>;
            return rect_robot_on_event(raw(), C::template call<rect_event, Event>, callback.context(), C::release, subscription,
                                       error);
        });
    }

    /// Declares a group of parameters: values of this program that people tune while it runs, such as a gain. They are members of the
    /// struct `T`, which is read with ParameterGroup::get.
    ///
    /// They are set with `set_parameters`, `rect param`, and on the dashboard, and kept in a file, so that they survive a restart.
    /// `options` may name the file, and functions that check changes and learn of them.
    ///
    ///     const auto drive = rect::must(robot.parameters("drive", rect::fields<Drive>().field("kp", &Drive::kp).range(0, 10)));
    ///     std::cout << drive.get()->kp << std::endl;
    ///
    /// Fails with Code::parameters if the declaration is invalid, and with Code::service_refused if a program of this robot has a group of
    /// that name already. A file that cannot be read or does not fit is a warning on standard error.
    template <class T>
    [[nodiscard]] expected<ParameterGroup<T>> parameters(const Text& group, const Fields<T>& fields,
                                                         const ParameterOptions<T>& options = {}) const {
        using Functions = detail::GroupFunctions<T>;
        const auto declared = detail::declare(group.c_str(), fields.all());
        if (!declared) {
            return unexpected<Error>(declared.error());
        }
        const auto list = std::make_shared<const std::vector<detail::Field<T>>>(fields.all());
        const detail::Callback<Functions> functions(Functions{list, options.check, options.on_change});
        rect_parameter_options raw_options{};
        raw_options.about = options.about.c_str();
        raw_options.file = detail::or_null(options.file);
        raw_options.without_file = options.without_file;
        rect_parameter_group raw_group;
        rect_error error;
        const auto code = rect_robot_parameters(raw(), {declared->handle_id()}, &raw_options,
                                                options.check ? Functions::call_check : nullptr,
                                                options.on_change ? Functions::call_on_change : nullptr, functions.context(),
                                                decltype(functions)::release, &raw_group, &error);
        return detail::value_or_error<ParameterGroup<T>>(code, error, [&] { return ParameterGroup<T>(raw_group.id, list); });
    }

    /// Changes parameters of a program of the robot `robot`: all or none. Returns them with the values that are in force now. Access
    /// control may permit it to some robots only (`@rect/@set/parameters/**`).
    ///
    ///     rect::must(robot.set_parameters("wombat-2", "drive", {{"kp", 2.0}}));
    ///
    /// Fails with Code::service and the reason if the program refuses a value, with Code::no_parameters if it has no such group, and with
    /// Code::not_stored if it cannot store the values, for which SetOptions::stored waits: they are in force. The other errors are those
    /// of `request`.
    expected<ParameterValues> set_parameters(const Text& robot, const Text& group, const ParameterValues& values,
                                             const SetOptions& options = {}) const {
        const auto all = detail::raw(values);
        rect_parameter_values in_force;
        rect_error error;
        const auto code = rect_robot_set_parameters(raw(), robot.c_str(), group.c_str(), all.data(), all.size(), options.stored,
                                                    detail::ms(options.timeout), &in_force, &error);
        return parameters_or_error(code, error, in_force);
    }

    /// Gives parameters of a program of the robot `robot` their defaults. Without names: all parameters except for read-only ones. Returns
    /// and fails like `set_parameters`.
    expected<ParameterValues> reset_parameters(const Text& robot, const Text& group, const std::vector<std::string>& names = {},
                                               const SetOptions& options = {}) const {
        const auto all = detail::pointers(names);
        rect_parameter_values in_force;
        rect_error error;
        const auto code = rect_robot_reset_parameters(raw(), robot.c_str(), group.c_str(), all.data(), all.size(), options.stored,
                                                      detail::ms(options.timeout), &in_force, &error);
        return parameters_or_error(code, error, in_force);
    }

    /// Returns the parameters that the programs of a robot have declared, in the order in which the programs began. `target` is the robot;
    /// empty means this robot. The answer is kept as that of `services`. Fails with Code::no_service if no router with a catalogue answers.
    [[nodiscard]] expected<std::vector<DeclaredParameter>> declared_parameters(const std::string& target = {}) const {
        rect_declared_parameters parameters;
        rect_error error;
        const auto code = rect_robot_declared_parameters(raw(), detail::or_null(target), &parameters, &error);
        return detail::value_or_error<std::vector<DeclaredParameter>>(code, error, [&] {
            const Handle handle(parameters.id);
            std::vector<DeclaredParameter> all;
            for (const auto& parameter : span<const rect_declared_parameter>(parameters.items, parameters.len)) {
                all.push_back(detail::declared_parameter(parameter));
            }
            return all;
        });
    }

    /// Takes part in the stop of the fleet: with it, this program stops all robots that take part, learns of a stop, and confirms it.
    ///
    /// A stop holds until somebody releases it. The robots remember it, on their disks as well, and pass it on: one that was out of reach
    /// learns of it when it returns, and a program that starts again before this function returns. The motors are up to the program:
    /// `deadman` handles stops, and nothing moves at the release.
    [[nodiscard]] expected<FleetStop> fleet_stop() const {
        rect_fleet_stop stop;
        rect_error error;
        const auto code = rect_robot_fleet_stop(raw(), &stop, &error);
        return detail::value_or_error<FleetStop>(code, error, [&] { return FleetStop(stop.id); });
    }

    /// Carries out commands while they arrive: calls `on_command(const T&)` for each message that matches `pattern`, and
    /// `on_lost(std::string_view reason)`, which stops the motors, when none has arrived for the time `within` (20 ms to 60 s), when the
    /// robot of the last one cannot be reached, while the fleet is stopped (`fleet_stop`), and before the first one. Without a type,
    /// `on_command` gets a MessageView.
    ///
    ///     const auto deadman = rect::must(robot.deadman<Drive>(
    ///         "laptop/drive", 300ms, [](const Drive& drive) { set_motors(drive.left, drive.right); },
    ///         [](std::string_view reason) { set_motors(0, 0); }));
    ///
    /// `on_lost` gets the reason, once for each loss; the next command resumes. After a stop, the first command that counts is a neutral
    /// one, whose numbers are all 0. Retained and replayed messages never count, and neither do those whose value does not fit `T`.
    ///
    /// `on_command` is called on a thread of its own, one command at a time. Commands that arrive meanwhile count only when it has returned:
    /// if it takes longer than `within`, the commander is lost. `on_lost` is called on another thread and does not wait for it: if
    /// `on_command` is running, `on_lost` is called at once, and again as soon as that has returned, which may have started the motors in
    /// between. So what both use must be safe to use from two threads. Both may use all of RECT. Exceptions are passed to the function of
    /// rect::on_callback_error. If this program itself hangs, nothing stops its motors: use the watchdog of the motor controller as well.
    ///
    /// Fails with Code::option if `within` is invalid, and with Code::topic or Code::name if the pattern is.
    template <class T = void, class C, class L>
    [[nodiscard]] expected<Deadman> deadman(const Text& pattern, Milliseconds within, C&& on_command, L&& on_lost) const {
        using Functions = detail::DeadmanFunctions<T, std::decay_t<C>, std::decay_t<L>>;
        const detail::Callback<Functions> functions(Functions{std::forward<C>(on_command), std::forward<L>(on_lost), raw()});
        rect_deadman deadman;
        rect_error error;
        const auto code = rect_robot_deadman(raw(), pattern.c_str(), detail::ms(within), Functions::is_command,
                                             Functions::call_on_command, Functions::call_on_lost, functions.context(),
                                             decltype(functions)::release, &deadman, &error);
        return detail::value_or_error<Deadman>(code, error, [&] { return Deadman(deadman.id); });
    }

    /// Declares an action: a long task, such as driving to a place, which others start (`start`), follow and cancel.
    /// `function(rect::Goal&)` carries out one goal at a time, on a thread of its own, and returns its result, or nothing. If it throws an
    /// exception, or returns an `expected` with an error, the goal has failed with that text.
    ///
    ///     const auto action = rect::must(robot.action("dig", [](rect::Goal& goal) {
    ///         const auto depth = rect::must(goal.payload.value<int>());
    ///         for (int done = 0; done < depth; ++done) {
    ///             rect::must(goal.progress(1.0 * done / depth));
    ///             goal.sleep(1s);
    ///         }
    ///         return "dug";
    ///     }));
    ///
    /// Each goal has one end, which its client learns also after a cut. The robot's router keeps it for 10 minutes, and at most 16 for each
    /// action. A result has at most 16 MB; this program keeps one of more than 48 kB for its clients, while it runs.
    /// A function that is cancelled should end soon (Goal::is_cancelled; Goal::sleep throws): a newer goal waits for that. A goal
    /// is also cancelled when its client has left (ActionOptions::lost_after), and by the stop of the fleet, in which this program takes part.
    ///
    /// Fails with Code::action if the name is invalid (1 to 40 letters, digits, `_`, `-` and `.`), and with Code::service_refused if a
    /// program of this robot has the action already.
    template <class F>
    [[nodiscard]] expected<Action> action(const Text& name, F&& function, const ActionOptions& options = {}) const {
        using Function = std::decay_t<F>;
        const detail::Callback<Function> callback(std::forward<F>(function));
        rect_action_options raw_options{};
        raw_options.about = options.about.c_str();
        raw_options.refuse_when_busy = options.refuse_when_busy;
        raw_options.lost_after_ms = std::max<std::uint32_t>(1, detail::ms(options.lost_after));
        rect_action action;
        rect_error error;
        const auto code = rect_robot_action(raw(), name.c_str(), &raw_options, detail::carry_out<Function>, callback.context(),
                                            decltype(callback)::release, &action, &error);
        return detail::value_or_error<Action>(code, error, [&] { return Action(action.id); });
    }

    /// Starts a goal of an action of the robot `robot`, and returns as soon as it is accepted or refused, which is its end. `goal` is any
    /// value of at most 48 kB.
    ///
    ///     const auto run = rect::must(robot.start("wombat-2", "dig", 3));
    ///     std::cout << rect::must(run.result<std::string>(60s)) << std::endl;
    ///
    /// Fails with Code::no_action if no program of the robot has the action, with Code::action if an argument is invalid, and with
    /// Code::timed_out or Code::interrupted if the robot did not answer: the goal may have begun. Then start it again with the same id
    /// (StartOptions::id), which is safe, or `find` it. The other errors are those of `request`.
    template <class T = std::string_view>
    [[nodiscard]] expected<ActionRun> start(const Text& robot, const Text& action, const T& goal = {},
                                            const StartOptions& options = {}) const {
        rect_action_run run{};
        const auto started = detail::with_payload(goal, [&](const rect_payload& payload) {
            const Text id(options.id);
            if (id.c_str() == nullptr) {
                return expected<void>(detail::failed(Code::argument, "the argument id contains a zero byte"));
            }
            const rect_start_options raw_options{detail::or_null(options.id), options.feedback_per_s};
            rect_error error;
            const auto code = rect_robot_start(raw(), robot.c_str(), action.c_str(), &payload, &raw_options,
                                               detail::ms(options.timeout), &run, &error);
            return detail::ok_or_error(code, error);
        });
        return started ? expected<ActionRun>(ActionRun(run.id)) : unexpected<Error>(started.error());
    }

    /// Returns a goal that this program or another one has started: also after its end, which the robot's router keeps for 10 minutes.
    /// Fails with Code::no_goal if the robot does not know it, or does not answer within `timeout`.
    [[nodiscard]] expected<ActionRun> find(const Text& robot, const Text& action, const Text& id,
                                           Milliseconds timeout = default_timeout) const {
        rect_action_run run;
        rect_error error;
        const auto code =
            rect_robot_find(raw(), robot.c_str(), action.c_str(), id.c_str(), detail::ms(timeout), &run, &error);
        return detail::value_or_error<ActionRun>(code, error, [&] { return ActionRun(run.id); });
    }

    /// Returns the goals of all actions of the robot `robot`, or of all robots (`*`), the newest first: those that have not ended, and those
    /// that did so within the last 10 minutes. A robot that does not answer within `timeout` has none in the list. Fails with Code::name if
    /// the name is invalid.
    [[nodiscard]] expected<std::vector<KnownGoal>> goals(const Text& robot = "*", Milliseconds timeout = default_timeout) const {
        rect_known_goals goals;
        rect_error error;
        const auto code = rect_robot_goals(raw(), robot.c_str(), detail::ms(timeout), &goals, &error);
        return detail::value_or_error<std::vector<KnownGoal>>(code, error, [&] {
            const Handle handle(goals.id);
            std::vector<KnownGoal> all;
            for (const auto& known : span<const rect_known_goal>(goals.items, goals.len)) {
                all.push_back(detail::known_goal(known));
            }
            return all;
        });
    }

    /// Logs a line, which the router of this robot keeps: `rect log` shows it, also after this program has ended. The place of the call in
    /// the source code belongs to it.
    ///
    ///     robot.log(rect::Level::warn, "the gripper is slow");
    ///
    /// It never waits and never fails. A router keeps the last 1,000 lines of each program, and 2 MB in all. A program that logs faster
    /// than that can be sent loses lines, which are counted in the log. Bytes of the text that are not UTF-8 become U+FFFD.
    void log(Level level, std::string_view text, const char* file = __builtin_FILE(), int line = __builtin_LINE()) const {
        detail::log(raw(), LogLine{level, std::string(text)}, file, line);
    }

    /// Logs a line with everything that belongs to it, as `log` does.
    void log_line(const LogLine& line, const char* file = __builtin_FILE(), int number = __builtin_LINE()) const {
        detail::log(raw(), line, file, number);
    }

    /// Reads the log of the robot `robot`, or of all robots (`*`): the last lines, newest ones first in parts, and with
    /// LogOptions::follow new ones. Fails with Code::name if a name is invalid. No item names a robot that does not answer.
    [[nodiscard]] expected<Logs> logs(const Text& robot, const LogOptions& options = {}) const {
        rect_log_options raw_options{};
        raw_options.program = detail::or_null(options.program);
        raw_options.level = static_cast<std::uint32_t>(options.level);
        raw_options.last = options.last;
        raw_options.without_earlier = options.last == 0;
        raw_options.follow = options.follow;
        raw_options.timeout_ms = std::max<std::uint32_t>(1, detail::ms(options.timeout));
        rect_logs logs;
        rect_error error;
        const auto code = rect_robot_logs(raw(), robot.c_str(), &raw_options, &logs, &error);
        return detail::value_or_error<Logs>(code, error, [&] { return Logs(logs.id); });
    }

    /// Raises an alert: something is wrong with this robot until `clear_alert` ends it. `rect status`, the page and recordings show it.
    ///
    ///     rect::must(robot.alert(rect::Level::warn, "battery low"));
    ///     rect::must(robot.clear_alert("battery low"));
    ///
    /// It is a retained message (`retained`) on the topic `alerts/<name>`, whose name is the text in words: `battery low` has
    /// `alerts/battery-low`. It stays when the program ends. The same alert again replaces the first one. A subscription to `*/alerts/*`
    /// receives the alerts of all robots, as JSON with `text`, `level`, `at` (milliseconds since 1970) and `program`.
    ///
    /// Fails with Code::topic if the text has neither a letter nor a digit, and with Code::not_retained if no router keeps it.
    expected<void> alert(Level level, const Text& text) const {
        rect_error error;
        return detail::ok_or_error(rect_robot_alert(raw(), static_cast<std::uint32_t>(level), text.c_str(), &error), error);
    }

    /// Raises an alert under a name of its own, for a text that changes: `battery` with the text `battery at 12 %`. Fails like `alert`, for
    /// the name.
    expected<void> alert_named(const Text& name, Level level, const Text& text) const {
        rect_error error;
        const auto code = rect_robot_alert_named(raw(), name.c_str(), static_cast<std::uint32_t>(level), text.c_str(), &error);
        return detail::ok_or_error(code, error);
    }

    /// Clears the alert with this name or text. Nothing happens if it was not raised. Fails like `alert`.
    expected<void> clear_alert(const Text& name) const {
        rect_error error;
        return detail::ok_or_error(rect_robot_clear_alert(raw(), name.c_str(), &error), error);
    }

    /// Returns the counts of this program's messages.
    [[nodiscard]] expected<Counters> counters() const {
        Counters counters;
        rect_error error;
        const auto code = rect_robot_counters(raw(), &counters, &error);
        return detail::value_or_error<Counters>(code, error, [&] { return counters; });
    }

    /// Returns whether the session was closed.
    [[nodiscard]] expected<bool> is_closed() const {
        bool is_closed = false;
        rect_error error;
        const auto code = rect_robot_is_closed(raw(), &is_closed, &error);
        return detail::value_or_error<bool>(code, error, [&] { return is_closed; });
    }

    /// Closes the session and everything that belongs to it, regardless of other handles.
    expected<void> close() const {
        rect_error error;
        return detail::ok_or_error(rect_robot_close(raw(), &error), error);
    }

    /// Returns the handle for functions of rect.h. It stays valid as long as this object.
    [[nodiscard]] rect_robot raw() const noexcept { return {handle_id()}; }

private:
    template <class Make>
    expected<Robot> derive(Make make) const {
        rect_robot robot;
        rect_error error;
        const auto code = make(&robot, &error);
        return detail::value_or_error<Robot>(code, error, [&] { return Robot(robot.id); });
    }

    static expected<ParameterValues> parameters_or_error(rect_code code, const rect_error& error,
                                                         const rect_parameter_values& values) {
        return detail::value_or_error<ParameterValues>(code, error, [&] {
            const Handle handle(values.id);
            return detail::parameter_values(values);
        });
    }

    template <class F, class Make>
    static expected<Subscription> with_callback(F&& function, Make make) {
        detail::Callback<std::decay_t<F>> callback(std::forward<F>(function));
        rect_subscription subscription;
        rect_error error;
        const auto code = make(callback, &subscription, &error);
        return detail::value_or_error<Subscription>(code, error, [&] { return Subscription(subscription.id); });
    }
};

/// Connects as a program of the robot `robot`, to the router of this computer or as the options specify. Blocks until the
/// router answers, at most `options.timeout`.
///
///     const auto robot = rect::must(rect::connect("wombat-1"));
///
/// Fails with Code::no_router if there is no router at the endpoint, Code::login_refused if the login is missing or wrong,
/// Code::wrong_robot if the router belongs to another robot, Code::name if the name is invalid, and Code::option if Zenoh
/// rejects an option.
[[nodiscard]] inline expected<Robot> connect(const Text& robot, const Options& options = {}) {
    return detail::with_options(options, [&](const rect_options& raw) {
        rect_robot connected;
        rect_error error;
        const auto code = rect_connect(robot.c_str(), &raw, &connected, &error);
        return detail::value_or_error<Robot>(code, error, [&] { return Robot(connected.id); });
    });
}

/// Returns the version of the library, e.g. `0.1.0`.
[[nodiscard]] inline const char* version() noexcept { return rect_version(); }

/// Lets Zenoh do all its work on one thread in place of five pools, unless the environment variable ZENOH_RUNTIME is set.
///
/// That saves a wake-up for each message. It is only safe for a program without receive queues of WhenFull::block, services
/// and dictionaries: a thread that waits for room there would stop all other messages. Call it at the start of main, before
/// other threads run.
inline void use_one_thread() noexcept { rect_use_one_thread(); }

}  // namespace RECT_ABI
}  // namespace rect

#endif
