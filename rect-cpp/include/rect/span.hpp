/// @file
/// Defines `rect::span`: `std::span` if the standard library has it, otherwise the part of it that RECT needs.
#ifndef RECT_SPAN_HPP
#define RECT_SPAN_HPP

#include "abi.hpp"

#if RECT_HAS_STD_SPAN
#include <span>
#else
#include <cstddef>
#include <type_traits>
#include <utility>
#endif

namespace rect {
inline namespace RECT_ABI {

#if RECT_HAS_STD_SPAN

/// A view of contiguous items that belong to another object.
template <class T>
using span = std::span<T>;

#else

/// A view of contiguous items that belong to another object: the part of C++20's `std::span` that RECT needs, for C++17.
template <class T>
class span {
    template <class C>
    using data_of = decltype(std::declval<C&>().data());
    template <class C>
    using fits = std::enable_if_t<std::is_convertible_v<std::remove_pointer_t<data_of<C>> (*)[], T (*)[]> &&
                                  std::is_convertible_v<decltype(std::declval<C&>().size()), std::size_t>>;

public:
    /// The type of the items.
    using element_type = T;
    /// The type of the items without `const`.
    using value_type = std::remove_cv_t<T>;
    /// The type of the size.
    using size_type = std::size_t;

    /// Creates an empty span.
    constexpr span() noexcept = default;
    /// Refers to `size` items from `data` on.
    constexpr span(T* data, std::size_t size) noexcept : data_(data), size_(size) {}
    /// Refers to all items of an array.
    template <std::size_t N>
    constexpr span(T (&array)[N]) noexcept : data_(array), size_(N) {}
    /// Refers to all items of a container.
    template <class C, class = fits<C>>
    constexpr span(C& container) noexcept : data_(container.data()), size_(container.size()) {}
    /// Refers to all items of a constant container, which must outlive the span.
    template <class C, class = fits<const C>>
    constexpr span(const C& container) noexcept : data_(container.data()), size_(container.size()) {}

    /// Returns the address of the first item.
    [[nodiscard]] constexpr T* data() const noexcept { return data_; }
    /// Returns the number of items.
    [[nodiscard]] constexpr std::size_t size() const noexcept { return size_; }
    /// Returns the size of the items in bytes.
    [[nodiscard]] constexpr std::size_t size_bytes() const noexcept { return size_ * sizeof(T); }
    /// Returns whether there are no items.
    [[nodiscard]] constexpr bool empty() const noexcept { return size_ == 0; }
    /// Returns the item at `index`, which must be less than `size()`.
    [[nodiscard]] constexpr T& operator[](std::size_t index) const noexcept { return data_[index]; }
    /// Returns the first item. The span must not be empty.
    [[nodiscard]] constexpr T& front() const noexcept { return data_[0]; }
    /// Returns the last item. The span must not be empty.
    [[nodiscard]] constexpr T& back() const noexcept { return data_[size_ - 1]; }
    /// Returns an iterator to the first item.
    [[nodiscard]] constexpr T* begin() const noexcept { return data_; }
    /// Returns an iterator past the last item.
    [[nodiscard]] constexpr T* end() const noexcept { return data_ + size_; }

private:
    T* data_ = nullptr;
    std::size_t size_ = 0;
};

#endif

}  // namespace RECT_ABI
}  // namespace rect

#endif
