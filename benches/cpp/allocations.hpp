// Counts what is allocated on the heap in the whole process, the library's included.
#ifndef RECT_BENCHES_ALLOCATIONS_HPP
#define RECT_BENCHES_ALLOCATIONS_HPP

#include <cstdint>

// How many allocations there were so far.
std::uint64_t allocations() noexcept;

#endif
