// Counts the heap allocations of the whole process, including those of libraries.
#ifndef RECT_BENCHES_ALLOCATIONS_HPP
#define RECT_BENCHES_ALLOCATIONS_HPP

#include <cstdint>

// Returns the number of allocations so far.
std::uint64_t allocations() noexcept;

#endif
