// Replaces malloc, calloc and realloc, also for libraries: counts the calls, and forwards them to libc.
#include "allocations.hpp"

#include <atomic>
#include <cstddef>

extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* old, std::size_t size);
}

namespace {

std::atomic<std::uint64_t> count{0};

}  // namespace

std::uint64_t allocations() noexcept { return count; }

extern "C" void* malloc(std::size_t size) {
    ++count;
    return __libc_malloc(size);
}

extern "C" void* calloc(std::size_t items, std::size_t size) {
    ++count;
    return __libc_calloc(items, size);
}

extern "C" void* realloc(void* old, std::size_t size) {
    ++count;
    return __libc_realloc(old, size);
}
