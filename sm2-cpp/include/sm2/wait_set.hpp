// Waiting for any of many sources, and ending all waits.
#ifndef SM2_WAIT_SET_HPP
#define SM2_WAIT_SET_HPP

#include <optional>

#include "sm2/service.hpp"
#include "sm2/topic.hpp"

namespace sm2 {

// Ends all waits of a program: set its handle() in NodeOptions, and pass it to WaitSet::end_with().
class Shutdown {
public:
    Shutdown() : shutdown_(detail::make<Owner>(sm2_shutdown_new)) {}

    // Ends all waits, now and later, with SM2_SHUTDOWN. May be called in a signal handler.
    void request() const noexcept { sm2_shutdown_request(shutdown_.get()); }

    bool is_requested() const {
        bool requested = false;
        detail::check(sm2_shutdown_is_requested(shutdown_.get(), &requested));
        return requested;
    }

    // Readable once the shutdown was requested.
    int descriptor() const { return detail::descriptor(shutdown_, sm2_shutdown_descriptor); }

    // The handle of the C library.
    const sm2_shutdown_t* handle() const noexcept { return shutdown_.get(); }

private:
    using Owner = detail::Handle<sm2_shutdown_t, sm2_shutdown_free>;
    Owner shutdown_;
};

// A tick of a timer.
struct Tick {
    std::uint64_t number;
    // The time when it was due, of the monotonic clock.
    std::chrono::nanoseconds due;
    // How many earlier ticks were skipped.
    std::uint64_t missed;
};

// A source that is ready.
struct Ready {
    std::uint64_t tag;
    std::optional<Tick> tick;
    // Of a descriptor of the program.
    bool readable;
    bool writable;
};

// Waits for any of many sources in one thread, without callbacks. Each source has a tag, which is unique in the set.
class WaitSet {
public:
    WaitSet() : set_(detail::make<Owner>(sm2_wait_set_new)) {}

    // A subscriber is reported until try_recv() finds nothing.
    template <typename T>
    void add(const Subscriber<T>& subscriber, std::uint64_t tag) {
        detail::check(sm2_wait_set_add_subscriber(set_.get(), subscriber.handle(), tag));
    }

    // A server is reported until try_recv() finds nothing.
    template <typename Q, typename R>
    void add(const Server<Q, R>& server, std::uint64_t tag) {
        detail::check(sm2_wait_set_add_server(set_.get(), server.handle(), tag));
    }

    // A publisher is reported while try_publish() would find room.
    template <typename T>
    void add(const Publisher<T>& publisher, std::uint64_t tag) {
        detail::check(sm2_wait_set_add_publisher(set_.get(), publisher.handle(), tag));
    }

    // A call is reported once, and leaves the set; then try_wait() has its result.
    template <typename R>
    void add(const Call<R>& call, std::uint64_t tag) {
        detail::check(sm2_wait_set_add_call(set_.get(), call.handle(), tag));
    }

    // Ticks once in each period, without drift. With `burst`, each missed tick is reported.
    void add_timer(std::chrono::nanoseconds period, std::uint64_t tag, bool burst = false) {
        detail::check(
            sm2_wait_set_add_timer(set_.get(), detail::nanoseconds(period), burst, tag));
    }

    // Ticks `frequency` times in each second, without drift.
    void add_timer_hz(std::uint32_t frequency, std::uint64_t tag, bool burst = false) {
        detail::check(sm2_wait_set_add_timer_hz(set_.get(), frequency, burst, tag));
    }

    // Ticks once, and leaves the set.
    void add_timer_once(std::chrono::nanoseconds delay, std::uint64_t tag) {
        detail::check(sm2_wait_set_add_timer_once(set_.get(), detail::nanoseconds(delay), tag));
    }

    // A descriptor of the program, which stays open until it is removed.
    void add_descriptor(int fd, bool readable, bool writable, std::uint64_t tag) {
        detail::check(sm2_wait_set_add_descriptor(set_.get(), fd, readable, writable, tag));
    }

    // Ends every wait once the shutdown is requested.
    void end_with(const Shutdown& shutdown) {
        detail::check(sm2_wait_set_end_with(set_.get(), shutdown.handle()));
    }

    void remove(std::uint64_t tag) { detail::check(sm2_wait_set_remove(set_.get(), tag)); }

    // Waits for the next source that is ready; nothing after the time limit.
    std::optional<Ready> wait(std::chrono::nanoseconds timeout = forever) {
        sm2_ready_t ready{};
        ready.size = sizeof ready;
        if (!detail::found(sm2_wait_set_wait(set_.get(), detail::nanoseconds(timeout), &ready))) {
            return std::nullopt;
        }
        Ready source{ready.tag, std::nullopt, ready.readable != 0, ready.writable != 0};
        if (ready.tick != 0) {
            const auto due = static_cast<std::int64_t>(ready.tick_due_ns);
            source.tick = Tick{ready.tick, std::chrono::nanoseconds(due), ready.ticks_missed};
        }
        return source;
    }

private:
    using Owner = detail::Handle<sm2_wait_set_t, sm2_wait_set_free>;
    Owner set_;
};

}  // namespace sm2

#endif
