/// @file
/// Defines errors, and `rect::expected`, which functions that may fail return.
#ifndef RECT_ERROR_HPP
#define RECT_ERROR_HPP

#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "../rect.h"
#include "abi.hpp"

#if RECT_HAS_STD_EXPECTED
#include <expected>
#else
#include "third_party/expected.hpp"
#endif

namespace rect {
inline namespace RECT_ABI {

/// The kind of an error.
enum class Code {
    /// There are no more items: all robots have replied, or the end of the transfer has already been reported.
    end = RECT_CODE_END,
    /// The timeout expired. Try again, allow more time, or check the link with `rect connections`.
    timed_out = RECT_CODE_TIMED_OUT,
    /// An argument is not UTF-8, contains a zero byte, or is out of range. The text names the argument.
    argument = RECT_CODE_ARGUMENT,
    /// The object was moved from or dropped.
    handle = RECT_CODE_HANDLE,
    /// The session was closed, or another thread dropped the object while the call was waiting.
    closed = RECT_CODE_CLOSED,
    /// The name of a robot or fleet, or the file name of a transfer, is invalid. Choose another one.
    name = RECT_CODE_NAME,
    /// A topic or pattern is invalid. The text explains the rule that it breaks.
    topic = RECT_CODE_TOPIC,
    /// A value cannot be sent, or a payload cannot be read as the requested type.
    payload = RECT_CODE_PAYLOAD,
    /// A codec does not suit the payload, or the encoded payload is damaged.
    codec = RECT_CODE_CODEC,
    /// The bytes are not a dictionary, or no dictionary can be trained from the samples.
    dictionary = RECT_CODE_DICTIONARY,
    /// There is no router at the endpoint. Start one, or specify another endpoint.
    no_router = RECT_CODE_NO_ROUTER,
    /// A locator or another option is invalid. The text names the option and the values that are allowed.
    option = RECT_CODE_OPTION,
    /// The robot does not offer the service. Check that the robot is reachable and that its program is running.
    no_service = RECT_CODE_NO_SERVICE,
    /// The service replied with an error, which is the text.
    service = RECT_CODE_SERVICE,
    /// Zenoh reported an error.
    zenoh = RECT_CODE_ZENOH,
    /// The recipient refused the transfer.
    transfer_refused = RECT_CODE_TRANSFER_REFUSED,
    /// The transfer started and failed before it was complete. The text states whether to send it again.
    transfer_failed = RECT_CODE_TRANSFER_FAILED,
    /// A file or folder of a transfer cannot be read or written.
    file = RECT_CODE_FILE,
    /// An internal error of RECT. Please report it with its text.
    internal = RECT_CODE_INTERNAL,
    /// Another error. The text describes it.
    other = RECT_CODE_OTHER,
    /// The router requires a login, and the login of this program is missing or wrong. Specify the team's login file.
    login_refused = RECT_CODE_LOGIN_REFUSED,
    /// The router belongs to another robot than the name under which the program connects. Use that robot's name, or connect
    /// to the router of the right robot.
    wrong_robot = RECT_CODE_WRONG_ROBOT,
    /// The operating system does not start another thread. Close other programs, or raise the limit of threads.
    thread = RECT_CODE_THREAD,
    /// A recording cannot start, or not become a file. Choose another name, or make room on the disk.
    recording = RECT_CODE_RECORDING,
    /// A service may have received the request, and no reply follows: its program, a router or the link ended. It may have been
    /// carried out; ask the robot before you repeat a request that must not be carried out twice.
    interrupted = RECT_CODE_INTERRUPTED,
    /// Another program of the robot serves the topic already. The text names it.
    service_refused = RECT_CODE_SERVICE_REFUSED,
    /// The robot to which a message is sent is not reachable. The text lists the reachable ones. Check the name, or wait for the robot.
    not_reachable = RECT_CODE_NOT_REACHABLE,
    /// The value of a retained topic is not kept; the text states why. It was published, unless a program serves the topic.
    not_retained = RECT_CODE_NOT_RETAINED,
    /// A declaration of parameters is invalid, or one of this program's own values is refused. The text states why.
    parameters = RECT_CODE_PARAMETERS,
    /// No program of the robot has the group of parameters. The text lists its groups. Check that the program is running. A robot that
    /// was configured by an earlier version lacks the rule for `@rect/@set/parameters/**` in its access control.
    no_parameters = RECT_CODE_NO_PARAMETERS,
    /// The values of parameters are in force, but are lost when the program of the robot ends. The text states why.
    not_stored = RECT_CODE_NOT_STORED,
    /// An action cannot be declared, or an argument of a goal is invalid. The text states why.
    action = RECT_CODE_ACTION,
    /// No program of the robot has the action. The text lists its actions. Check that the program is running. A robot that was configured
    /// by an earlier version lacks the rule for `@rect/@set/actions/**` in its access control.
    no_action = RECT_CODE_NO_ACTION,
    /// The robot does not know the goal: it never began, or ended more than ten minutes ago.
    no_goal = RECT_CODE_NO_GOAL,
    /// A goal was not carried out, or not to its end. The text states how it ended, and why.
    goal = RECT_CODE_GOAL,
    /// The goal was cancelled while the function that carries it out was sleeping. It should end soon.
    cancelled = RECT_CODE_CANCELLED,
};

/// The reason why a call failed.
struct Error {
    /// The kind of the error.
    Code code;
    /// One line for people: what happened, and what to do.
    std::string text;
    /// The errors of Zenoh or of the operating system that caused this one, outermost first. The text already contains what
    /// matters of them; they help to find out why something was refused.
    std::vector<std::string> causes{};
};

#if RECT_HAS_STD_EXPECTED
/// The value that a call returns, or its error: `std::expected` if the standard library has it, otherwise
/// `nonstd::expected`, which has the same interface.
template <class T, class E = Error>
using expected = std::expected<T, E>;
/// Marks the error of an `expected`.
template <class E>
using unexpected = std::unexpected<E>;
#else
/// The value that a call returns, or its error: `std::expected` if the standard library has it, otherwise
/// `nonstd::expected`, which has the same interface.
template <class T, class E = Error>
using expected = nonstd::expected<T, E>;
/// Marks the error of an `expected`.
template <class E>
using unexpected = nonstd::unexpected_type<E>;
#endif

/// The exception that rect::must throws. `what()` returns the text of the error.
class Exception : public std::runtime_error {
public:
    /// Creates the exception of an error.
    explicit Exception(const Error& error)
        : std::runtime_error(error.text), code_(error.code), causes_(std::make_shared<Causes>(error.causes)) {}
    /// Returns the kind of the error.
    [[nodiscard]] Code code() const noexcept { return code_; }
    /// Returns the errors that caused this one, outermost first; see Error::causes.
    [[nodiscard]] const std::vector<std::string>& causes() const noexcept { return *causes_; }

private:
    using Causes = const std::vector<std::string>;
    Code code_;
    // Shared, because copying an exception must not throw.
    std::shared_ptr<Causes> causes_;
};

/// Returns the value of an `expected`, or throws an Exception if it is an error.
///
///     auto robot = rect::must(rect::connect("wombat-1"));
template <class T>
T must(expected<T> result) {
    if (!result) {
        throw Exception(result.error());
    }
    if constexpr (!std::is_void_v<T>) {
        return std::move(*result);
    }
}

/// @cond
namespace detail {

// Must be called on the thread of the call that failed, before the next call.
inline unexpected<Error> failed(rect_code code, const rect_error& error) {
    Error failure{static_cast<Code>(code), error.text};
    char cause[RECT_ERROR_BYTES];
    while (rect_error_cause(failure.causes.size(), &cause) == RECT_CODE_OK) {
        failure.causes.emplace_back(cause);
    }
    return unexpected<Error>(std::move(failure));
}

inline unexpected<Error> failed(Code code, std::string text) {
    return unexpected<Error>(Error{code, std::move(text)});
}

inline expected<void> ok_or_error(rect_code code, const rect_error& error) {
    if (code == RECT_CODE_OK) {
        return {};
    }
    return failed(code, error);
}

}  // namespace detail
/// @endcond

}  // namespace RECT_ABI
}  // namespace rect

#endif
