// SM2 nodes for programs in C++17: a header-only library over sm2.h.
//
// Every handle is a move-only value that frees itself, in any order. Errors are exceptions of the type `sm2::Error`. A
// time limit is a `std::chrono` duration; `sm2::forever` is no limit, and 0 does not wait.
//
// Threads. Methods that are `const` may be called from several threads at the same time. A value is moved, assigned
// or destroyed by one thread, while no other one uses it. Samples, loans, requests and replies may be moved to another
// thread.
#ifndef SM2_SM2_HPP
#define SM2_SM2_HPP

#include "sm2/error.hpp"
#include "sm2/message.hpp"
#include "sm2/node.hpp"
#include "sm2/options.hpp"
#include "sm2/ros.hpp"
#include "sm2/service.hpp"
#include "sm2/span.hpp"
#include "sm2/topic.hpp"
#include "sm2/wait_set.hpp"

#endif
