// Includes Catch2 of the system, version 2 (Debian 12) or 3, and gives the names that differ between them those of version 3.
#ifndef RECT_TESTS_CATCH_HPP
#define RECT_TESTS_CATCH_HPP

#if __has_include(<catch2/catch_all.hpp>)
#include <catch2/catch_all.hpp>

using Catch::Matchers::ContainsSubstring;
using EventListener = Catch::EventListenerBase;
#else
#define CATCH_CONFIG_ENABLE_BENCHMARKING
#define CATCH_CONFIG_EXTERNAL_INTERFACES
#include <catch2/catch.hpp>

inline auto ContainsSubstring(const std::string& text) { return Catch::Matchers::Contains(text); }
using EventListener = Catch::TestEventListenerBase;
#endif

#endif
