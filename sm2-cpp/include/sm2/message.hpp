// Types of messages, and their schemas.
//
// | T | carries | in Rust |
// | --- | --- | --- |
// | a struct with SM2_STRUCT | the struct in place | a type with #[derive(Message)] |
// | std::int8_t to std::uint64_t, float, double | the number | the number |
// | U[], for one of these | any number of them | [U] |
// | std::byte[] | bytes | [u8] |
// | std::string | text | str |
// | a type with SM2_ROS_TYPE (ros.hpp) | a message of ROS 2 in CDR | the type of sm2-ros |
#ifndef SM2_MESSAGE_HPP
#define SM2_MESSAGE_HPP

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <string>
#include <string_view>
#include <type_traits>

#include "sm2/error.hpp"
#include "sm2/span.hpp"
#include "sm2/struct_fields.hpp"

namespace sm2 {

// What SM2_STRUCT says about a struct.
template <typename T>
struct Fields;

namespace detail {

template <typename T, typename = void>
struct has_fields : std::false_type {};
template <typename T>
struct has_fields<T, std::void_t<decltype(Fields<T>::name)>> : std::true_type {};

template <typename T>
constexpr bool is_character =
    std::is_same_v<T, char> || std::is_same_v<T, wchar_t> || std::is_same_v<T, char16_t> ||
    std::is_same_v<T, char32_t>;

template <typename T>
constexpr bool is_number = (std::is_integral_v<T> && !std::is_same_v<T, bool> &&
                            !is_character<T>) ||
                           std::is_same_v<T, float> || std::is_same_v<T, double>;

// Whether T is a number or a struct with SM2_STRUCT: a type that is read where the sender wrote it.
template <typename T>
constexpr bool is_plain = is_number<T> || has_fields<T>::value;

// Describes a type of a field, as Annex A of SPEC.md defines schema texts.
template <typename T, typename = void>
struct Describe {
    static_assert(!std::is_same_v<T, bool> && !std::is_enum_v<T>,
                  "a field of a message cannot be a bool or an enumeration, because another process may send "
                  "any bits: use std::uint8_t");
    static_assert(!is_character<T>, "use std::int8_t or std::uint8_t in place of a character");
    static_assert(is_plain<T>, "a field of a message is a number, an array, or a struct with SM2_STRUCT");
};

template <typename T>
struct Describe<T, std::enable_if_t<is_number<T>>> {
    static std::string text() {
        const char* kind = std::is_floating_point_v<T> ? "f" : std::is_signed_v<T> ? "i" : "u";
        return kind + std::to_string(8 * sizeof(T));
    }
};

template <typename T, std::size_t N>
std::string describe_array() {
    char count[17];
    std::snprintf(count, sizeof count, "%016zx", N);
    return "array[" + Describe<T>::text() + ";" + count + "]";
}

template <typename T, std::size_t N>
struct Describe<T[N]> {
    static std::string text() { return describe_array<T, N>(); }
};

template <typename T, std::size_t N>
struct Describe<std::array<T, N>> {
    static std::string text() { return describe_array<T, N>(); }
};

template <typename T>
struct Describe<T, std::enable_if_t<has_fields<T>::value>> {
    static std::string text() {
        std::string text = "struct{";
        Fields<T>::describe(text);
        return text + "}";
    }
};

// Appends a field of a structure.
template <typename T>
void describe_field(std::string& text, const char* name) {
    text.append(name).append(":").append(Describe<T>::text()).append(",");
}

struct FieldPlace {
    std::size_t offset;
    std::size_t size;
};

// Whether the fields fill the struct in their order: no padding, and none left out.
template <std::size_t N>
constexpr bool fill_the_struct(const FieldPlace (&fields)[N], std::size_t size) {
    std::size_t end = 0;
    for (const FieldPlace& field : fields) {
        if (field.offset != end) {
            return false;
        }
        end += field.size;
    }
    return end == size;
}

template <typename T>
std::string message_name() {
    if constexpr (is_number<T>) {
        return Describe<T>::text();
    } else {
        return Fields<T>::name;
    }
}

// A type that is declared to the Manager; null for bytes.
class DeclaredType {
public:
    DeclaredType(std::string name, std::string schema)
        : name_(std::move(name)), schema_(std::move(schema)), type_{} {
        type_.size = sizeof type_;
        type_.name = name_.c_str();
        type_.schema = schema_.c_str();
    }
    DeclaredType(const DeclaredType&) = delete;
    DeclaredType& operator=(const DeclaredType&) = delete;

    const sm2_type_t* get() const noexcept { return &type_; }

private:
    std::string name_;
    std::string schema_;
    sm2_type_t type_;
};

// The bytes of a message.
struct Bytes {
    const void* data;
    std::size_t len;
};

[[noreturn]] inline void wrong_length(const char* name, std::size_t len) {
    throw Error(SM2_UNREADABLE, "a message of type " + std::string(name) + " cannot have " +
                                    std::to_string(len) + " bytes: check who publishes it");
}

}  // namespace detail

// How a type of messages is sent and read. A received message gives a `View`, and a call that sends one takes an
// `Argument`. A loan is a `Loaned`: one value, or an array of any length.
template <typename T>
struct Message {
    static_assert(detail::is_plain<T>,
                  "T is not a message: add SM2_STRUCT for a struct; use a number, U[], std::byte[] or std::string");
    static_assert(std::is_trivially_copyable_v<T>, "a message is trivially copyable");
    using View = const T&;
    using Argument = const T&;
    using Loaned = T;

    static const sm2_type_t* type() {
        static const detail::DeclaredType type(detail::message_name<T>(), schema());
        return type.get();
    }
    static std::string schema() { return "plain:" + detail::Describe<T>::text(); }
    static detail::Bytes bytes(const T& message) noexcept { return {&message, sizeof(T)}; }
    static const T& view(const void* data, std::size_t) noexcept {
        return *static_cast<const T*>(data);
    }
    static void check(std::size_t len) {
        if (len != sizeof(T)) {
            detail::wrong_length(type()->name, len);
        }
    }
};

// Any number of plain values.
template <typename T>
struct Message<T[]> {
    static_assert(detail::is_plain<T>, "the elements of a list are numbers or structs with SM2_STRUCT");
    static_assert(std::is_trivially_copyable_v<T>, "a message is trivially copyable");
    using View = span<const T>;
    using Argument = span<const T>;
    using Loaned = T[];

    static const sm2_type_t* type() {
        // A list of u8 is the type of raw bytes.
        if constexpr (std::is_same_v<T, std::uint8_t>) {
            return nullptr;
        } else {
            static const detail::DeclaredType type(detail::message_name<T>() + "-list", schema());
            return type.get();
        }
    }
    static std::string schema() { return "plain:list[" + detail::Describe<T>::text() + "]"; }
    static detail::Bytes bytes(span<const T> message) noexcept {
        return {message.data(), message.size_bytes()};
    }
    static span<const T> view(const void* data, std::size_t len) noexcept {
        return {static_cast<const T*>(data), len / sizeof(T)};
    }
    static void check(std::size_t len) {
        if (len % sizeof(T) != 0) {
            detail::wrong_length((detail::message_name<T>() + "-list").c_str(), len);
        }
    }
};

// Raw bytes.
template <>
struct Message<std::byte[]> {
    using View = span<const std::byte>;
    using Argument = span<const std::byte>;
    using Loaned = std::byte[];

    static const sm2_type_t* type() noexcept { return nullptr; }
    static detail::Bytes bytes(span<const std::byte> message) noexcept {
        return {message.data(), message.size()};
    }
    static span<const std::byte> view(const void* data, std::size_t len) noexcept {
        return {static_cast<const std::byte*>(data), len};
    }
    static void check(std::size_t) noexcept {}
};

// Text. The view is that of the sender: whether it is UTF-8 is not checked.
template <>
struct Message<std::string> {
    using View = std::string_view;
    using Argument = std::string_view;
    using Loaned = char[];

    static const sm2_type_t* type() {
        static const detail::DeclaredType type("text", "plain:string");
        return type.get();
    }
    static detail::Bytes bytes(std::string_view message) noexcept {
        return {message.data(), message.size()};
    }
    static std::string_view view(const void* data, std::size_t len) noexcept {
        return {static_cast<const char*>(data), len};
    }
    static void check(std::size_t) noexcept {}
};

}  // namespace sm2

// Makes a struct a message: SM2_STRUCT(robot::Imu, "sensor/Imu", stamp_ns, acceleration, gyro), outside of all namespaces.
// All fields are named, in the order of their declaration, at most 32. Padding does not compile: name it as a field of
// its own, such as std::uint8_t padding[4]. A type of Rust with the same name and fields is the same type.
#define SM2_STRUCT(Type, type_name, ...)                                                           \
    template <>                                                                                    \
    struct sm2::Fields<Type> {                                                                     \
        static constexpr const char* name = type_name;                                             \
        static_assert(std::is_standard_layout_v<Type>, #Type " has no standard layout");           \
        static_assert(std::is_trivially_copyable_v<Type>, #Type " is not trivially copyable");     \
        static constexpr sm2::detail::FieldPlace places[] = {                                      \
            SM2_FOR_EACH_FIELD(SM2_FIELD_PLACE, Type, __VA_ARGS__)};                               \
        static_assert(sm2::detail::fill_the_struct(places, sizeof(Type)),                          \
                      #Type " has padding, or fields are left out or not in their order");         \
        static void describe(std::string& text) {                                                  \
            SM2_FOR_EACH_FIELD(SM2_FIELD_TEXT, Type, __VA_ARGS__)                                  \
        }                                                                                          \
    }

#define SM2_FIELD_PLACE(Type, field) {offsetof(Type, field), sizeof(Type::field)},
#define SM2_FIELD_TEXT(Type, field) sm2::detail::describe_field<decltype(Type::field)>(text, #field);

#endif
