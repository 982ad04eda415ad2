/// @file
/// Owns errors, and `rect::expected`: what a call gives, or why it does not.
#ifndef RECT_ERROR_HPP
#define RECT_ERROR_HPP

#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "../rect.h"
#include "abi.hpp"

#if RECT_HAS_STD_EXPECTED
#include <expected>
#else
#include "third_party/expected.hpp"
#endif

namespace rect {
inline namespace RECT_ABI {

/// How a call ended.
enum class Code {
    /// There are no more: all have answered.
    end = RECT_CODE_END,
    /// It took longer than was allowed. Ask again, allow more time, or look at the link (`rect connections`).
    timed_out = RECT_CODE_TIMED_OUT,
    /// An argument is not UTF-8, or out of its range; the text names it.
    argument = RECT_CODE_ARGUMENT,
    /// The object was moved from, or is closed.
    handle = RECT_CODE_HANDLE,
    /// The session was closed, or what is waited for was dropped meanwhile.
    closed = RECT_CODE_CLOSED,
    /// The name of a robot or fleet. Choose another.
    name = RECT_CODE_NAME,
    /// A topic or pattern. Write it as the text says.
    topic = RECT_CODE_TOPIC,
    /// A value that can't be sent or read as asked for.
    payload = RECT_CODE_PAYLOAD,
    /// A codec that does not fit, or a payload that is damaged.
    codec = RECT_CODE_CODEC,
    /// Bytes that are no dictionary, or samples that make none.
    dictionary = RECT_CODE_DICTIONARY,
    /// No router. Start one, or name another.
    no_router = RECT_CODE_NO_ROUTER,
    /// A locator, or something else in the options, that Zenoh does not take.
    option = RECT_CODE_OPTION,
    /// Nobody has that service. Is the robot there, and does its program run?
    no_service = RECT_CODE_NO_SERVICE,
    /// The service answered with an error.
    service = RECT_CODE_SERVICE,
    /// Zenoh refuses.
    zenoh = RECT_CODE_ZENOH,
    /// A transfer is not taken there.
    transfer_refused = RECT_CODE_TRANSFER_REFUSED,
    /// A transfer began and ended before all was there. The text says whether to send it again.
    transfer_failed = RECT_CODE_TRANSFER_FAILED,
    /// A file or folder of a transfer can't be used.
    file = RECT_CODE_FILE,
    /// A fault of RECT's own: please report it with its text.
    fault = RECT_CODE_FAULT,
    /// Another failure; the text tells.
    other = RECT_CODE_OTHER,
    /// The router asks for a login, and this program's is missing or wrong. Name the team's login file.
    login_refused = RECT_CODE_LOGIN_REFUSED,
    /// The router serves another robot than the program joins as. Join under that name, or at the right router.
    wrong_robot = RECT_CODE_WRONG_ROBOT,
};

/// Why a call did not do it.
struct Error {
    /// What kind of failure.
    Code code;
    /// For people: one line that says what to do.
    std::string text;
};

#if RECT_HAS_STD_EXPECTED
/// What a call gives, or why it does not: `std::expected` where the standard has it, otherwise the same by `nonstd::expected`.
template <class T, class E = Error>
using expected = std::expected<T, E>;
/// The second of the two.
template <class E>
using unexpected = std::unexpected<E>;
#else
/// What a call gives, or why it does not: `std::expected` where the standard has it, otherwise the same by `nonstd::expected`.
template <class T, class E = Error>
using expected = nonstd::expected<T, E>;
/// The second of the two.
template <class E>
using unexpected = nonstd::unexpected_type<E>;
#endif

/// What `must` throws: what() is the error's text.
class Failed : public std::runtime_error {
public:
    /// Of an error.
    explicit Failed(const Error& error) : std::runtime_error(error.text), code_(error.code) {}
    /// What kind of failure.
    [[nodiscard]] Code code() const noexcept { return code_; }

private:
    Code code_;
};

/// What a call gives, or a Failed is thrown: `auto robot = rect::must(rect::connect("wombat-1"));`.
template <class T>
T must(expected<T> got) {
    if (!got) {
        throw Failed(got.error());
    }
    if constexpr (!std::is_void_v<T>) {
        return std::move(*got);
    }
}

/// @cond
namespace detail {

inline unexpected<Error> failed(rect_code code, const rect_error& error) {
    return unexpected<Error>(Error{static_cast<Code>(code), error.text});
}

inline unexpected<Error> failed(Code code, std::string text) {
    return unexpected<Error>(Error{code, std::move(text)});
}

inline expected<void> done(rect_code code, const rect_error& error) {
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
