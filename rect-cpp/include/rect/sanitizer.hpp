/// @file
/// Informs the thread sanitizer of the order that the library's locks guarantee between the calls of a callback, its
/// release, and the thread that drops it. The sanitizer cannot see these locks, because the library is Rust and built
/// without it.
#ifndef RECT_SANITIZER_HPP
#define RECT_SANITIZER_HPP

#include "abi.hpp"

/// @cond
#if defined(__SANITIZE_THREAD__)
#define RECT_THREAD_SANITIZER 1
#elif defined(__has_feature)
#if __has_feature(thread_sanitizer)
#define RECT_THREAD_SANITIZER 1
#endif
#endif

#if defined(RECT_THREAD_SANITIZER)
extern "C" void __tsan_acquire(void* address);
extern "C" void __tsan_release(void* address);
#endif

namespace rect {
inline namespace RECT_ABI {
namespace detail {

/// Orders everything that any thread did before its `release` of the same address before what follows.
inline void acquire([[maybe_unused]] void* context) noexcept {
#if defined(RECT_THREAD_SANITIZER)
    __tsan_acquire(context);
#endif
}

inline void release([[maybe_unused]] void* context) noexcept {
#if defined(RECT_THREAD_SANITIZER)
    __tsan_release(context);
#endif
}

/// The address that stands for all dropped objects.
inline char dropped = 0;

/// Called after dropping an object, which has waited for its callbacks.
inline void acquire_all() noexcept { acquire(&dropped); }
inline void release_all() noexcept { release(&dropped); }

}  // namespace detail
}  // namespace RECT_ABI
}  // namespace rect
/// @endcond

#endif
