// Checks of the tests, without a framework: a failed check prints its line and ends the program.
#ifndef CHECK_HPP
#define CHECK_HPP

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "sm2/sm2.hpp"

#define CHECK(condition)                                                                           \
    do {                                                                                           \
        if (!(condition)) {                                                                        \
            std::fprintf(stderr, "%s:%d: not so: %s\n", __FILE__, __LINE__, #condition);           \
            std::exit(1);                                                                          \
        }                                                                                          \
    } while (false)

// Whatever has to happen, happens within this time, or the test fails.
constexpr std::chrono::seconds soon{60};

// Checks that a call throws an error with this code. Returns its text.
template <typename Call>
std::string error_of(sm2_status_t code, Call&& call) {
    try {
        call();
    } catch (const sm2::Error& error) {
        if (error.code() == code) {
            return error.what();
        }
        std::fprintf(stderr, "another error: %s: %s\n", error.name(), error.what());
        std::exit(1);
    }
    std::fprintf(stderr, "no error, but %s expected\n", sm2_status_name(code));
    std::exit(1);
}

inline bool has(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
}

#endif
