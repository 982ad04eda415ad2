/// @file
/// Wraps C++ functions as callbacks of C, and reports exceptions that they throw.
#ifndef RECT_CALLBACK_HPP
#define RECT_CALLBACK_HPP

#include <atomic>
#include <cstdio>
#include <exception>
#include <type_traits>
#include <utility>

#include "abi.hpp"
#include "sanitizer.hpp"

namespace rect {
inline namespace RECT_ABI {

/// A function that is called with the text of an exception that a callback has thrown.
using OnCallbackError = void (*)(const char* what) noexcept;

/// @cond
namespace detail {

inline std::atomic<OnCallbackError>& on_callback_error() noexcept {
    static std::atomic<OnCallbackError> function{nullptr};
    return function;
}

inline void report(const char* what) noexcept {
    if (const auto function = on_callback_error().load()) {
        function(what);
    } else {
        std::fprintf(stderr, "rect: a callback has thrown an exception: %s\n", what);
    }
}

/// Runs a function and reports an exception that it throws. Returns whether there was none.
template <class Run>
bool guarded(Run run) noexcept {
    try {
        run();
        return true;
    } catch (const std::exception& error) {
        report(error.what());
    } catch (...) {
        report("an exception that is not a std::exception");
    }
    return false;
}

/// A C++ function that is passed to C. C owns it, and deletes it with `release`.
template <class F>
class Callback {
public:
    template <class G>
    explicit Callback(G&& function) : function_(new F(std::forward<G>(function))) {
        detail::release(function_);
    }

    /// Returns the `context` for C.
    [[nodiscard]] void* context() const noexcept { return function_; }

    /// The `release` function for C.
    static void release(void* context) noexcept {
        acquire(context);
        delete static_cast<F*>(context);
    }

    /// The `callback` function for C. Converts the C struct to a `View`.
    template <class Raw, class View>
    static void call(const Raw* raw, void* context) noexcept {
        acquire(context);
        guarded([&] { (*static_cast<F*>(context))(View(*raw)); });
        detail::release(context);
        release_all();
    }

private:
    F* function_;
};

}  // namespace detail
/// @endcond

/// Sets the function that receives the exceptions of callbacks; `nullptr` writes them to stderr, which is the default. The
/// function may be called on several threads at once.
inline void on_callback_error(OnCallbackError function) noexcept { detail::on_callback_error() = function; }

}  // namespace RECT_ABI
}  // namespace rect

#endif
