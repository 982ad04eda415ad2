/// @file
/// Owns what all objects have in common: they have a handle of the library's, may be moved and not copied, and end with it.
#ifndef RECT_HANDLE_HPP
#define RECT_HANDLE_HPP

#include <atomic>
#include <cstdint>

#include "error.hpp"
#include "sanitizer.hpp"

namespace rect {
inline namespace RECT_ABI {

/// Something of the library's, which ends when this does. What was moved from, or ended by hand, gives Code::handle.
class Handle {
public:
    /// Takes over what C has given.
    explicit Handle(std::uint64_t id = 0) noexcept : id_(id) {}
    /// Takes over another's.
    Handle(Handle&& other) noexcept : id_(other.id_.exchange(0)) {}
    /// Ends its own, and takes over another's.
    Handle& operator=(Handle&& other) noexcept {
        if (this != &other) {
            drop();
            id_ = other.id_.exchange(0);
        }
        return *this;
    }
    Handle(const Handle&) = delete;
    Handle& operator=(const Handle&) = delete;
    ~Handle() { drop(); }

    /// Ends it now. No callback of it runs any more when this returns, except the one that calls this. May be called by
    /// several threads, and again.
    void drop() noexcept {
        auto id = id_.exchange(0);
        rect_drop(&id, nullptr);
        detail::acquire_all();
    }

    /// Its number in C; 0 when there is nothing any more.
    [[nodiscard]] std::uint64_t id() const noexcept { return id_; }

private:
    std::atomic<std::uint64_t> id_;
};

/// @cond
namespace detail {

/// What a call gives, or why it does not.
template <class T, class Make>
expected<T> got(rect_code code, const rect_error& error, Make make) {
    if (code == RECT_CODE_OK) {
        return make();
    }
    return failed(code, error);
}

}  // namespace detail
/// @endcond

}  // namespace RECT_ABI
}  // namespace rect

#endif
