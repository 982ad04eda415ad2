/// @file
/// Owns what a thread sanitizer is told. The library's locks order a callback's calls, its release, and whoever drops it; a
/// sanitizer does not see that, since the library is Rust and not built with it.
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

/// What was done before `release` on any thread is done for who does this.
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

/// Stands for all that is dropped.
inline char dropped = 0;

/// Who drops something has waited for its callbacks.
inline void acquire_all() noexcept { acquire(&dropped); }
inline void release_all() noexcept { release(&dropped); }

}  // namespace detail
}  // namespace RECT_ABI
}  // namespace rect
/// @endcond

#endif
