/// @file
/// Owns `rect::span`: `std::span` where the standard has it, otherwise as much of it as RECT needs.
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

/// Items that are somewhere, without owning them.
template <class T>
using span = std::span<T>;

#else

/// Items that are somewhere, without owning them: `std::span` of C++20, for C++17.
template <class T>
class span {
    template <class C>
    using data_of = decltype(std::declval<C&>().data());
    template <class C>
    using fits = std::enable_if_t<std::is_convertible_v<std::remove_pointer_t<data_of<C>> (*)[], T (*)[]> &&
                                  std::is_convertible_v<decltype(std::declval<C&>().size()), std::size_t>>;

public:
    /// What it is of.
    using element_type = T;
    /// The same, without `const`.
    using value_type = std::remove_cv_t<T>;
    /// What its length is.
    using size_type = std::size_t;

    /// Nothing.
    constexpr span() noexcept = default;
    /// `size` items from `data` on.
    constexpr span(T* data, std::size_t size) noexcept : data_(data), size_(size) {}
    /// All of an array.
    template <std::size_t N>
    constexpr span(T (&array)[N]) noexcept : data_(array), size_(N) {}
    /// All of a container.
    template <class C, class = fits<C>>
    constexpr span(C& container) noexcept : data_(container.data()), size_(container.size()) {}
    /// All of a container, that lives at least as long.
    template <class C, class = fits<const C>>
    constexpr span(const C& container) noexcept : data_(container.data()), size_(container.size()) {}

    /// The first.
    [[nodiscard]] constexpr T* data() const noexcept { return data_; }
    /// How many.
    [[nodiscard]] constexpr std::size_t size() const noexcept { return size_; }
    /// How many bytes they take.
    [[nodiscard]] constexpr std::size_t size_bytes() const noexcept { return size_ * sizeof(T); }
    /// Whether there is none.
    [[nodiscard]] constexpr bool empty() const noexcept { return size_ == 0; }
    /// The one at `index`, which has to be there.
    [[nodiscard]] constexpr T& operator[](std::size_t index) const noexcept { return data_[index]; }
    /// The first one, which has to be there.
    [[nodiscard]] constexpr T& front() const noexcept { return data_[0]; }
    /// The last one, which has to be there.
    [[nodiscard]] constexpr T& back() const noexcept { return data_[size_ - 1]; }
    /// Where it begins.
    [[nodiscard]] constexpr T* begin() const noexcept { return data_; }
    /// Where it ends.
    [[nodiscard]] constexpr T* end() const noexcept { return data_ + size_; }

private:
    T* data_ = nullptr;
    std::size_t size_ = 0;
};

#endif

}  // namespace RECT_ABI
}  // namespace rect

#endif
