/// @file
/// Defines the base class of all objects of the library: they own a handle, can be moved but not copied, and release the
/// handle when they are destroyed.
#ifndef RECT_HANDLE_HPP
#define RECT_HANDLE_HPP

#include <atomic>
#include <cstdint>

#include "error.hpp"
#include "sanitizer.hpp"

namespace rect {
inline namespace RECT_ABI {

/// The owner of an object of the library, which is dropped when its owner is destroyed. Calls on an object that was moved
/// from or dropped fail with Code::handle.
class Handle {
public:
    /// Takes ownership of a handle of rect.h.
    explicit Handle(std::uint64_t id = 0) noexcept : id_(id) {}
    /// Takes over the handle of another object.
    Handle(Handle&& other) noexcept : id_(other.id_.exchange(0)) {}
    /// Drops the current object and takes over the handle of another one.
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

    /// Drops the object now. When this returns, no callback of the object runs any more, except one that called this
    /// function. May be called repeatedly, and by several threads at once.
    void drop() noexcept {
        auto id = id_.exchange(0);
        rect_drop(&id, nullptr);
        detail::acquire_all();
    }

    /// Returns the handle as a number for functions of rect.h; 0 if the object was dropped or moved from.
    [[nodiscard]] std::uint64_t handle_id() const noexcept { return id_; }

private:
    std::atomic<std::uint64_t> id_;
};

/// @cond
namespace detail {

/// Returns the value that `make` creates if the call succeeded, otherwise its error.
template <class T, class Make>
expected<T> value_or_error(rect_code code, const rect_error& error, Make make) {
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
