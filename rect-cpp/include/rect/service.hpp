/// @file
/// Owns asking services, and serving.
#ifndef RECT_SERVICE_HPP
#define RECT_SERVICE_HPP

#include <chrono>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "callback.hpp"
#include "payload.hpp"

namespace rect {
inline namespace RECT_ABI {

/// An answer.
class Reply {
public:
    /// Takes over what C has given.
    explicit Reply(const rect_reply& raw) noexcept : payload(raw.payload), handle_(raw.id), from_(raw.from) {}

    /// What it says.
    PayloadView payload;

    /// Who answers.
    [[nodiscard]] std::string_view from() const noexcept { return detail::view(from_); }

private:
    Handle handle_;
    rect_text from_;
};

/// The answers to one request, as they come. Dropped, it cancels the request.
class Replies : public Handle {
public:
    using Handle::Handle;

    /// The next answer. Code::service: this one is an error, and there may be more; Code::end: all have answered;
    /// Code::timed_out: the time of the request is over, and some have not.
    [[nodiscard]] expected<Reply> next() const {
        rect_reply reply;
        rect_error error;
        const auto code = rect_replies_next({id()}, &reply, &error);
        return detail::got<Reply>(code, error, [&] { return Reply(reply); });
    }
};

/// A request, which belongs to the function that is called with it.
class Request {
public:
    /// As C has it.
    explicit Request(const rect_request& raw) noexcept : payload(raw.payload), raw_(raw) {}

    /// What is asked.
    PayloadView payload;

    /// Who asks; empty: a stock program, which does not say.
    [[nodiscard]] std::string_view from() const noexcept { return detail::view(raw_.from); }
    /// How long an answer is of use still.
    [[nodiscard]] std::chrono::milliseconds remaining() const noexcept {
        return std::chrono::milliseconds(raw_.remaining_ms);
    }

private:
    rect_request raw_;
};

/// What a service throws, or returns as `rect::unexpected<rect::Refusal>`, to answer with an error: the asker gets its text.
/// What `rect::must` throws is answered so, too.
class Refusal : public std::runtime_error {
public:
    using std::runtime_error::runtime_error;
};

/// A service that answers by a function, until this ends; that waits for calls that are under way. It may be ended in its own
/// function, whose answer is not sent then.
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
    const rect_payload payload{text.data(), text.size(), raw("text/plain")};
    rect_error error;
    if (rect_request_refuse(request, &payload, &error) != RECT_CODE_OK) {
        report(error.text);
    }
}

template <class T>
void answer(std::uint64_t request, const T& value) {
    if constexpr (is_expected<T>::value) {
        if (value) {
            answer(request, *value);
        } else {
            refuse(request, refusal_text(value.error()));
        }
    } else {
        const auto said = with_payload(value, [&](const rect_payload& payload) {
            rect_error error;
            return done(rect_request_reply(request, &payload, &error), error);
        });
        if (!said) {
            refuse(request, said.error().text);
        }
    }
}

/// For C: answers a request by a function of the program's.
template <class F>
void serve(const rect_request* raw, void* context) noexcept {
    acquire(context);
    const bool is_answered = guarded([&] {
        try {
            answer(raw->id, (*static_cast<F*>(context))(Request(*raw)));
        } catch (const Refusal& refusal) {
            refuse(raw->id, refusal.what());
        } catch (const Failed& failed) {
            refuse(raw->id, failed.what());
        }
    });
    if (!is_answered) {
        guarded([&] { refuse(raw->id, "the service has a fault"); });
    }
    release(context);
    release_all();
}

}  // namespace detail
/// @endcond

}  // namespace RECT_ABI
}  // namespace rect

#endif
