// Options with their defaults. The fields are those of sm2.h; the methods set times.
#ifndef SM2_OPTIONS_HPP
#define SM2_OPTIONS_HPP

#include "sm2/error.hpp"

namespace sm2 {
namespace detail {

// A struct of options whose defaults the library sets.
template <typename Options, sm2_status_t (*Init)(Options*)>
struct Defaults : Options {
    Defaults() : Options{} {
        this->size = sizeof(Options);
        check(Init(this));
    }
};

}  // namespace detail

struct NodeOptions : detail::Defaults<sm2_node_options_t, sm2_node_options_init> {
    NodeOptions& manager_timeout(std::chrono::nanoseconds timeout) noexcept {
        manager_timeout_ns = detail::nanoseconds(timeout);
        return *this;
    }
    NodeOptions& startup_timeout(std::chrono::nanoseconds timeout) noexcept {
        startup_timeout_ns = detail::nanoseconds(timeout);
        return *this;
    }
};

struct PublisherOptions : detail::Defaults<sm2_publisher_options_t, sm2_publisher_options_init> {
    PublisherOptions& publish_timeout(std::chrono::nanoseconds timeout) noexcept {
        publish_timeout_ns = detail::nanoseconds(timeout);
        return *this;
    }
    PublisherOptions& deadline(std::chrono::nanoseconds period) noexcept {
        deadline_ns = detail::nanoseconds(period);
        return *this;
    }
    PublisherOptions& liveliness(std::chrono::nanoseconds lease) noexcept {
        liveliness_ns = detail::nanoseconds(lease);
        return *this;
    }
    PublisherOptions& lifespan(std::chrono::nanoseconds age) noexcept {
        lifespan_ns = detail::nanoseconds(age);
        return *this;
    }
    PublisherOptions& keep_idle(std::chrono::nanoseconds idle) noexcept {
        keep_idle_ns = detail::nanoseconds(idle);
        return *this;
    }
};

struct SubscriberOptions : detail::Defaults<sm2_subscriber_options_t, sm2_subscriber_options_init> {
    SubscriberOptions& deadline(std::chrono::nanoseconds period) noexcept {
        deadline_ns = detail::nanoseconds(period);
        return *this;
    }
    SubscriberOptions& liveliness(std::chrono::nanoseconds lease) noexcept {
        liveliness_ns = detail::nanoseconds(lease);
        return *this;
    }
    SubscriberOptions& spin(std::chrono::nanoseconds time) noexcept {
        spin_ns = detail::nanoseconds(time);
        return *this;
    }
};

struct ServerOptions : detail::Defaults<sm2_server_options_t, sm2_server_options_init> {
    ServerOptions& spin(std::chrono::nanoseconds time) noexcept {
        spin_ns = detail::nanoseconds(time);
        return *this;
    }
};

struct ClientOptions : detail::Defaults<sm2_client_options_t, sm2_client_options_init> {
    ClientOptions& spin(std::chrono::nanoseconds time) noexcept {
        spin_ns = detail::nanoseconds(time);
        return *this;
    }
};

}  // namespace sm2

#endif
