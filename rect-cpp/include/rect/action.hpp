/// @file
/// Defines actions: long tasks with progress, cancel and one end.
#ifndef RECT_ACTION_HPP
#define RECT_ACTION_HPP

#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "callback.hpp"
#include "message.hpp"
#include "payload.hpp"
#include "service.hpp"

namespace rect {
inline namespace RECT_ABI {

/// How far a goal has come.
enum class Phase : std::uint32_t {
    /// It waits for the end of another goal.
    waiting = RECT_PHASE_WAITING,
    /// It is being carried out.
    running = RECT_PHASE_RUNNING,
    /// It is being carried out, and was asked to end.
    cancelling = RECT_PHASE_CANCELLING,
    /// It was carried out. This and the following ones are the ends.
    done = RECT_PHASE_DONE,
    /// It was not accepted, and never began.
    refused = RECT_PHASE_REFUSED,
    /// Its program has failed at it.
    failed = RECT_PHASE_FAILED,
    /// Somebody has cancelled it.
    cancelled = RECT_PHASE_CANCELLED,
    /// A newer goal has taken its place.
    preempted = RECT_PHASE_PREEMPTED,
    /// The program that carried it out has ended, so that nobody knows how far it came.
    lost = RECT_PHASE_LOST,
};

/// Returns the name of a phase, in lower case: `running`.
[[nodiscard]] inline const char* name(Phase phase) noexcept { return rect_phase_name(static_cast<std::uint32_t>(phase)); }

/// Returns whether a goal in this phase has ended.
[[nodiscard]] inline bool is_end(Phase phase) noexcept { return phase >= Phase::done; }

/// The exception that Goal::sleep throws if the function that carries out the goal should end. The function needs not catch it.
class Cancelled : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

/// The rules of an action.
struct ActionOptions {
    /// The purpose of the action, for `rect action list` and the dashboard: at most 200 characters.
    std::string about{};
    /// Whether a new goal is refused while another one runs. Otherwise it preempts the other one, which is asked to end.
    bool refuse_when_busy{false};
    /// How long the client of a goal has to be away until the goal is cancelled: its program has ended, or its robot cannot be reached.
    /// rect::forever: the goal is carried out without its client, too.
    std::chrono::milliseconds lost_after{std::chrono::seconds(5)};
};

/// A goal that a function carries out. It is valid until the function returns.
class Goal {
public:
    /// Refers to a struct of rect.h.
    explicit Goal(const rect_goal& raw) noexcept : payload(raw.payload), raw_(raw) {}

    /// The goal itself: `goal.payload.value<Target>()`. Empty if its client has given none.
    PayloadView payload;

    /// Returns the id, which the client has chosen.
    [[nodiscard]] std::string_view id() const noexcept { return detail::view(raw_.goal_id); }
    /// Returns the program that has started the goal: `<robot>/<program>`. The name is not verified: do not base permissions on it.
    [[nodiscard]] std::string_view by() const noexcept { return detail::view(raw_.by); }

    /// Reports news to those who follow the goal: a value of at most 48 kB, and how much is done, from 0 to 1. The newest counts, and it
    /// is sent 10 times a second at most, without delaying anything else. Does not wait. Fails with Code::action if the value is too large,
    /// and with Code::payload if it cannot be encoded.
    template <class T>
    expected<void> feedback(const T& value, std::optional<double> progress = {}) const {
        return detail::with_payload(value, [&](const rect_payload& payload) { return give(&payload, progress.value_or(NAN)); });
    }

    /// Reports how much is done, from 0 to 1, as `feedback` does, without a value.
    expected<void> progress(double progress) const { return give(nullptr, progress); }

    /// Returns whether the function should end: somebody has cancelled the goal, a newer one takes its place, its client has left, the fleet
    /// is stopped, or the action ends. If the function returns after this was true, the goal counts as cancelled or preempted, and
    /// otherwise as done.
    [[nodiscard]] bool is_cancelled() const noexcept { return rect_goal_is_cancelled(raw_.id); }

    /// Returns why the function should end, as `is_cancelled` describes; empty if it should not.
    [[nodiscard]] expected<std::string> cancel_reason() const {
        rect_string reason;
        rect_error error;
        const auto code = rect_goal_cancel_reason(raw_.id, &reason, &error);
        return detail::value_or_error<std::string>(code, error, [&] {
            const Handle handle(reason.id);
            return std::string(detail::view(reason.text));
        });
    }

    /// Sleeps. Throws Cancelled as soon as the function should end.
    void sleep(std::chrono::milliseconds time) const {
        rect_error error;
        const auto code = rect_goal_sleep(raw_.id, detail::ms(time), &error);
        if (code == RECT_CODE_CANCELLED) {
            throw Cancelled(error.text);
        }
        must(detail::ok_or_error(code, error));
    }

private:
    expected<void> give(const rect_payload* value, double progress) const {
        rect_error error;
        return detail::ok_or_error(rect_goal_feedback(raw_.id, value, progress, &error), error);
    }

    rect_goal raw_;
};

/// An action of this program, which calls a function for each goal. Destroying it ends the action: its goals are cancelled, no further ones
/// begin, and it waits for a call in progress. The function may end its own action.
class Action : public Handle {
public:
    using Handle::Handle;
};

/// How a goal is started.
struct StartOptions {
    /// The id of the goal: 1 to 40 letters, digits, underscores, hyphens and periods. If it is empty, RECT chooses one. A goal that is
    /// started again with its id runs once.
    std::string id{};
    /// How often feedback is sent at most, per second: 0.1 to 50. 0: 10.
    double feedback_per_s{0};
    /// How long to wait until the goal is accepted or refused: at most 10 minutes.
    std::chrono::milliseconds timeout{default_timeout};
};

/// The status of a goal, as far as a program that follows it knows.
struct GoalStatus {
    /// The robot that carries out the goal.
    std::string robot;
    /// The action.
    std::string action;
    /// The id of the goal.
    std::string id;
    /// How far it has come.
    Phase phase;
    /// For how long it has been in this phase. If it is Phase::cancelling, the goal does not heed its cancel.
    std::chrono::milliseconds phase_for;
    /// Why it has ended, or is asked to; empty if that is clear.
    std::string reason;
    /// How much is done, from 0 to 1, as its program has said last.
    std::optional<double> progress;
    /// The value of the newest feedback.
    std::optional<Payload> feedback;
    /// For how long the robot has not been reachable; nothing if it is. The goal goes on meanwhile, unless the rules of its action say
    /// otherwise.
    std::optional<std::chrono::milliseconds> unreachable_for;
};

/// News of a goal. It is valid until the function that receives it returns.
struct FeedbackView {
    /// The value: `feedback.value.value<Depth>()`. Empty if there is none.
    PayloadView value;
    /// How much is done, from 0 to 1.
    std::optional<double> progress;
};

/// A goal of some robot, as its router keeps it.
struct KnownGoal {
    /// The robot that carries it out.
    std::string robot;
    /// The action.
    std::string action;
    /// The id of the goal.
    std::string id;
    /// How far it has come.
    Phase phase;
    /// Why it has ended, or is asked to; empty if that is clear.
    std::string reason;
    /// The program that has started it: `<robot>/<program>`.
    std::string by;
    /// The program that carries it out; empty if it has no name.
    std::string program;
    /// When it was started, by the clock of its robot.
    std::chrono::system_clock::time_point began;
    /// When it ended.
    std::optional<std::chrono::system_clock::time_point> ended;
    /// For how long the robot's router has known this state: how long ago it began or ended, whatever the clock of the robot says.
    std::chrono::milliseconds age;
    /// The goal itself; empty if it is long, or there is none.
    Payload goal;
    /// The result, unless it has more than 48 kB: ActionRun::result returns it.
    std::optional<Payload> result;
};

/// A goal that this program has started or found. Destroying it does not cancel the goal.
///
///     const auto run = rect::must(robot.start("wombat-2", "dig", 3));
///     std::cout << rect::must(run.result<std::string>(60s)) << std::endl;
class ActionRun : public Handle {
    using Milliseconds = std::chrono::milliseconds;

public:
    using Handle::Handle;

    /// Returns what is known of the goal now.
    [[nodiscard]] expected<GoalStatus> status() const {
        rect_goal_status status;
        rect_error error;
        const auto code = rect_action_run_status(raw(), &status, &error);
        return detail::value_or_error<GoalStatus>(code, error, [&] {
            const Handle handle(status.id);
            GoalStatus known{std::string(detail::view(status.robot)),
                             std::string(detail::view(status.action)),
                             std::string(detail::view(status.goal_id)),
                             static_cast<Phase>(status.phase),
                             Milliseconds(status.phase_ms),
                             std::string(detail::view(status.reason)),
                             {},
                             {},
                             {}};
            if (!std::isnan(status.progress)) {
                known.progress = status.progress;
            }
            if (status.has_feedback) {
                known.feedback.emplace(PayloadView(status.feedback));
            }
            if (!status.is_reachable) {
                known.unreachable_for = Milliseconds(status.unreachable_ms);
            }
            return known;
        });
    }

    /// Returns how far the goal has come.
    [[nodiscard]] expected<Phase> phase() const {
        const auto known = status();
        return known ? expected<Phase>(known->phase) : unexpected<Error>(known.error());
    }

    /// Returns the id of the goal.
    [[nodiscard]] expected<std::string> id() const {
        auto known = status();
        return known ? expected<std::string>(std::move(known->id)) : unexpected<Error>(known.error());
    }

    /// Calls `function(const rect::FeedbackView&)` for the newest feedback, at once if there is some, and then whenever there is newer one,
    /// on a thread of its own, until the Subscription is destroyed, also after this object was. Feedback that arrives meanwhile replaces
    /// earlier one, and feedback that does not differ from the one before is not reported. Exceptions that the function throws are passed to
    /// the function of rect::on_callback_error.
    template <class F>
    [[nodiscard]] expected<Subscription> on_feedback(F&& function) const {
        auto on_news = [function = std::decay_t<F>(std::forward<F>(function))](const rect_feedback& raw) mutable {
            const std::optional<double> progress = std::isnan(raw.progress) ? std::nullopt : std::optional<double>(raw.progress);
            function(FeedbackView{PayloadView(raw.value), progress});
        };
        using C = detail::Callback<decltype(on_news)>;
        const C callback(std::move(on_news));
        rect_subscription subscription;
        rect_error error;
        const auto code = rect_action_run_on_feedback(raw(), C::template call<rect_feedback, const rect_feedback&>, callback.context(),
                                                      C::release, &subscription, &error);
        return detail::value_or_error<Subscription>(code, error, [&] { return Subscription(subscription.id); });
    }

    /// Waits for a change that was not known when this was called last, or when the object was created: of the phase, of the feedback, and
    /// whether the robot is reachable. Several are reported as one. Fails with Code::end if the goal has ended and that was reported, with
    /// Code::timed_out if there is no change within `timeout`, and with Code::closed if the session was closed or another thread dropped
    /// this object.
    expected<void> wait_for_change(Milliseconds timeout = forever) const {
        rect_error error;
        return detail::ok_or_error(rect_action_run_wait_for_change(raw(), detail::ms(timeout), &error), error);
    }

    /// Asks the function that carries out the goal to end. Returns when its robot has the wish; the end follows as soon as the function
    /// heeds it. Nothing happens if the goal has ended. Fails like Robot::request.
    expected<void> cancel() const {
        rect_error error;
        return detail::ok_or_error(rect_action_run_cancel(raw(), &error), error);
    }

    /// Waits for the end of the goal, and returns its result: a value of type `T` with `result<T>()`, otherwise a Buffer of text,
    /// JSON or bytes, which is `null` as JSON if there is none. A robot that cannot be reached does not
    /// end the wait. A result of more than 48 kB is received from the program that has carried out the goal, which has to run until then.
    ///
    /// Fails with Code::goal if the goal was not reached, or its result is lost: the text states the end and the reason, and `status` has
    /// both; with Code::timed_out if it has not ended within `timeout`: the text states its phase, and for how long it has been in it, or how
    /// much of the result has arrived; with Code::payload if the result does not fit; and with Code::closed if the session was closed or
    /// another thread dropped this object.
    template <class T = void>
    [[nodiscard]] auto result(Milliseconds timeout = forever) const
        -> expected<std::conditional_t<std::is_void_v<T>, Buffer, T>> {
        rect_buffer result;
        rect_error error;
        const auto code = rect_action_run_result(raw(), detail::ms(timeout), &result, &error);
        auto end = detail::value_or_error<Buffer>(code, error, [&] { return Buffer(result); });
        if constexpr (std::is_void_v<T>) {
            return end;
        } else {
            return end ? end->view().template value<T>() : unexpected<Error>(end.error());
        }
    }

private:
    [[nodiscard]] rect_action_run raw() const noexcept { return {handle_id()}; }
};

/// @cond
namespace detail {

inline void fail(std::uint64_t goal, const std::string& text) {
    rect_error error;
    // A text for C ends at its first zero byte.
    if (rect_goal_fail(goal, text.c_str(), &error) == RECT_CODE_ARGUMENT) {
        rect_goal_fail(goal, error.text, nullptr);
    }
}

template <class T>
void end(std::uint64_t goal, const T& value) {
    if constexpr (is_expected<T>::value) {
        if (!value) {
            fail(goal, refusal_text(value.error()));
        } else if constexpr (!std::is_void_v<typename T::value_type>) {
            end(goal, *value);
        }
    } else {
        const auto ended = with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return ok_or_error(rect_goal_done(goal, &payload, &error), error);
        });
        if (!ended) {
            fail(goal, ended.error().text);
        }
    }
}

/// The callback for C: ends a goal with the result of the program's function.
template <class F>
void carry_out(const rect_goal* raw, void* context) noexcept {
    acquire(context);
    guarded([&] {
        try {
            auto& function = *static_cast<F*>(context);
            if constexpr (std::is_void_v<std::invoke_result_t<F&, Goal&>>) {
                Goal goal(*raw);
                function(goal);
            } else {
                Goal goal(*raw);
                end(raw->id, function(goal));
            }
        } catch (const std::exception& exception) {
            fail(raw->id, exception.what());
        } catch (...) {
            fail(raw->id, "an exception that is not a std::exception");
        }
    });
    release(context);
    release_all();
}

inline KnownGoal known_goal(const rect_known_goal& raw) {
    using Time = std::chrono::system_clock::time_point;
    KnownGoal known{std::string(view(raw.robot)),
                    std::string(view(raw.action)),
                    std::string(view(raw.goal_id)),
                    static_cast<Phase>(raw.phase),
                    std::string(view(raw.reason)),
                    std::string(view(raw.by)),
                    std::string(view(raw.program)),
                    Time(std::chrono::milliseconds(raw.began_ms)),
                    {},
                    std::chrono::milliseconds(raw.age_ms),
                    Payload(PayloadView(raw.goal)),
                    {}};
    if (raw.ended_ms != 0) {
        known.ended = Time(std::chrono::milliseconds(raw.ended_ms));
    }
    if (raw.has_result) {
        known.result.emplace(PayloadView(raw.result));
    }
    return known;
}

}  // namespace detail
/// @endcond

}  // namespace RECT_ABI
}  // namespace rect

#endif
