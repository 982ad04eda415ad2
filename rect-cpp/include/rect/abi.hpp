/// @file
/// Selects the inline namespace, which differs between C++17, C++20 and C++23. Types differ between these standards
/// (`std::span`, `std::expected`); separate namespaces permit linking object files of several standards together.
#ifndef RECT_ABI_HPP
#define RECT_ABI_HPP

/// @cond
#if defined(__has_include)
#if __has_include(<version>)
#include <version>
#endif
#endif

#if defined(__cpp_lib_expected) && __cpp_lib_expected >= 202202L
#define RECT_HAS_STD_EXPECTED 1
#else
#define RECT_HAS_STD_EXPECTED 0
#endif

#if defined(__cpp_lib_span) && __cpp_lib_span >= 202002L
#define RECT_HAS_STD_SPAN 1
#else
#define RECT_HAS_STD_SPAN 0
#endif

#if RECT_HAS_STD_EXPECTED
#define RECT_ABI cxx23
#elif RECT_HAS_STD_SPAN
#define RECT_ABI cxx20
#else
#define RECT_ABI cxx17
#endif
/// @endcond

#endif
