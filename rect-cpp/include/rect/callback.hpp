/// @file
/// Owns callbacks: what they throw never leaves them.
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

/// Called with what a callback has thrown.
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
        std::fprintf(stderr, "rect: a callback has thrown: %s\n", what);
    }
}

/// Runs it; what it throws is reported.
template <class Run>
bool guarded(Run run) noexcept {
    try {
        run();
        return true;
    } catch (const std::exception& error) {
        report(error.what());
    } catch (...) {
        report("something that is no std::exception");
    }
    return false;
}

/// A function on its way to C, which takes it over.
template <class F>
class Callback {
public:
    template <class G>
    explicit Callback(G&& function) : function_(new F(std::forward<G>(function))) {
        detail::release(function_);
    }

    /// For C, as `context`.
    [[nodiscard]] void* context() const noexcept { return function_; }

    /// For C, as `release`.
    static void done(void* context) noexcept {
        acquire(context);
        delete static_cast<F*>(context);
    }

    /// For C, as `callback`: shows what C has as `View`.
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

/// From now on this function is told what callbacks have thrown, instead of stderr; `nullptr`: stderr again. It may be called
/// on several threads at once.
inline void on_callback_error(OnCallbackError function) noexcept { detail::on_callback_error() = function; }

}  // namespace RECT_ABI
}  // namespace rect

#endif
