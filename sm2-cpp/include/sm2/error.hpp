// Errors, time limits, and handles that free themselves.
#ifndef SM2_ERROR_HPP
#define SM2_ERROR_HPP

#include <chrono>
#include <memory>
#include <stdexcept>
#include <string>

#include "sm2.h"

namespace sm2 {

// A failed call: what() has the text of the Rust library, which says what happened, where, and what to do.
class Error : public std::runtime_error {
public:
    // The error of the thread's last call.
    explicit Error(sm2_status_t code)
        : std::runtime_error(sm2_last_error()), code_(code), system_error_(sm2_last_errno()) {}

    Error(sm2_status_t code, const std::string& text) : std::runtime_error(text), code_(code) {}

    // The kind of error, such as SM2_NO_MANAGER.
    sm2_status_t code() const noexcept { return code_; }

    // The name of the code, such as "SM2_NO_MANAGER".
    const char* name() const noexcept { return sm2_status_name(code_); }

    // The `errno` of the operating system; 0 if it did not cause the error.
    int system_error() const noexcept { return system_error_; }

private:
    sm2_status_t code_;
    int system_error_ = 0;
};

// No time limit.
constexpr std::chrono::nanoseconds forever = std::chrono::nanoseconds::max();

namespace detail {

// Throws unless the call succeeded.
inline void check(sm2_status_t status) {
    if (status != SM2_OK) {
        throw Error(status);
    }
}

// Returns whether the call found something within its time limit. Throws after all other errors.
inline bool found(sm2_status_t status) {
    if (status == SM2_TIMED_OUT) {
        return false;
    }
    check(status);
    return true;
}

// The nanoseconds of a time limit or period. A negative one is 0.
constexpr std::uint64_t nanoseconds(std::chrono::nanoseconds time) noexcept {
    if (time == forever) {
        return SM2_FOREVER;
    }
    return time.count() < 0 ? 0 : static_cast<std::uint64_t>(time.count());
}

template <typename T, void (*Free)(T*)>
struct Freer {
    void operator()(T* handle) const noexcept { Free(handle); }
};

// A handle of the C library that frees itself.
template <typename T, void (*Free)(T*)>
using Handle = std::unique_ptr<T, Freer<T, Free>>;

// Calls a function that makes a handle.
template <typename Owner, typename Make>
Owner make(Make&& call) {
    typename Owner::pointer handle = nullptr;
    check(call(&handle));
    return Owner(handle);
}

// Calls a function that makes a handle or uses the one that is there. Returns its status.
template <typename Owner, typename Fill>
sm2_status_t fill(Owner& owner, Fill&& call) {
    typename Owner::pointer handle = owner.release();
    const sm2_status_t status = call(&handle);
    owner.reset(handle);
    return status;
}

// A text that the C library made.
template <typename Call>
std::string text(Call&& call) {
    char* text = nullptr;
    check(call(&text));
    const std::unique_ptr<char, Freer<char, sm2_text_free>> owner(text);
    return std::string(text);
}

template <typename Handle, typename Call>
int descriptor(const Handle& handle, Call&& call) {
    int fd = -1;
    check(call(handle.get(), &fd));
    return fd;
}

}  // namespace detail
}  // namespace sm2

#endif
