// A view of consecutive objects, as std::span of C++20.
#ifndef SM2_SPAN_HPP
#define SM2_SPAN_HPP

#include <array>
#include <cstddef>
#include <type_traits>
#include <utility>

namespace sm2 {

template <typename T>
class span {
public:
    using element_type = T;
    using value_type = std::remove_cv_t<T>;
    using iterator = T*;

    constexpr span() noexcept = default;
    constexpr span(T* data, std::size_t size) noexcept : data_(data), size_(size) {}

    template <std::size_t N>
    constexpr span(T (&array)[N]) noexcept : data_(array), size_(N) {}

    // Of every container with data() and size(), such as std::vector, std::array and std::string.
    template <typename Container,
              typename = std::enable_if_t<std::is_convertible_v<
                  std::remove_pointer_t<decltype(std::declval<Container&>().data())> (*)[],
                  T (*)[]>>>
    constexpr span(Container& container) noexcept
        : data_(container.data()), size_(container.size()) {}

    template <typename Container,
              typename = std::enable_if_t<
                  std::is_const_v<T> &&
                  std::is_convertible_v<std::remove_pointer_t<
                                            decltype(std::declval<const Container&>().data())> (*)[],
                                        T (*)[]>>,
              typename = void>
    constexpr span(const Container& container) noexcept
        : data_(container.data()), size_(container.size()) {}

    constexpr T* data() const noexcept { return data_; }
    constexpr std::size_t size() const noexcept { return size_; }
    constexpr std::size_t size_bytes() const noexcept { return size_ * sizeof(T); }
    constexpr bool empty() const noexcept { return size_ == 0; }
    constexpr T* begin() const noexcept { return data_; }
    constexpr T* end() const noexcept { return data_ + size_; }
    constexpr T& operator[](std::size_t index) const noexcept { return data_[index]; }

private:
    T* data_ = nullptr;
    std::size_t size_ = 0;
};

}  // namespace sm2

#endif
