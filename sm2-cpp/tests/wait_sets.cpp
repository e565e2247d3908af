// Wait sets, and ending all waits.
#include <unistd.h>

#include <csignal>
#include <thread>

#include "check.hpp"

namespace {

enum Source : std::uint64_t { messages, requests, results, ticks, bytes, once };

void all_sources(const sm2::Node& node) {
    const auto publisher = node.publisher<double>("wait_sets/speed");
    const auto subscriber = node.subscriber<double>("wait_sets/speed");
    const auto server = node.server<double, double>("wait_sets/twice");
    const auto client = node.client<double, double>("wait_sets/twice");
    publisher.wait_for_subscribers(1, soon);
    client.wait_for_servers(1, soon);
    int ends[2];
    CHECK(pipe(ends) == 0);

    sm2::WaitSet set;
    CHECK(!set.wait(std::chrono::nanoseconds(0)));
    set.add(subscriber, messages);
    set.add(server, requests);
    set.add_descriptor(ends[0], true, false, bytes);
    publisher.publish(2.5);
    const auto ready = set.wait(soon);
    CHECK(ready && ready->tag == messages && !ready->tick);
    CHECK(*subscriber.try_recv() == 2.5);
    CHECK(!subscriber.try_recv());

    sm2::Call<double> call = client.send(4.0, soon);
    CHECK(set.wait(soon)->tag == requests);
    set.add(call, results);
    auto request = server.try_recv();
    request.reply(2.0 * *request);
    CHECK(!server.try_recv());
    CHECK(set.wait(soon)->tag == results);
    CHECK(*call.try_wait() == 8.0);

    CHECK(write(ends[1], "x", 1) == 1);
    const auto readable = set.wait(soon);
    CHECK(readable && readable->tag == bytes && readable->readable && !readable->writable);
    set.remove(bytes);
    error_of(SM2_MISUSE, [&] { set.remove(bytes); });
    close(ends[0]);
    close(ends[1]);
}

void timers() {
    sm2::WaitSet set;
    set.add_timer(std::chrono::milliseconds(1), ticks, true);
    for (std::uint64_t number = 1; number <= 5; number++) {
        const auto ready = set.wait(soon);
        CHECK(ready && ready->tag == ticks);
        CHECK(ready->tick->number == number && ready->tick->missed == 0);
        CHECK(ready->tick->due <= std::chrono::steady_clock::now().time_since_epoch());
    }
    set.remove(ticks);
    set.add_timer_hz(1000, ticks);
    CHECK(set.wait(soon)->tick->number >= 1);
    set.remove(ticks);
    set.add_timer_once(std::chrono::milliseconds(1), once);
    CHECK(set.wait(soon)->tag == once);
    // It has left the set, so its tag is free.
    set.add_timer_once(std::chrono::milliseconds(1), once);
    error_of(SM2_MISUSE, [&] { set.add_timer(std::chrono::seconds(1), once); });
}

const sm2::Shutdown* signalled = nullptr;

void a_shutdown_ends_all_waits() {
    const sm2::Shutdown shutdown;
    sm2::NodeOptions options;
    options.shutdown = shutdown.handle();
    const sm2::Node node("wait-sets-ends", options);
    const auto subscriber = node.subscriber<double>("wait_sets/silent");
    sm2::WaitSet set;
    set.add(subscriber, messages);
    set.end_with(shutdown);
    CHECK(!shutdown.is_requested());

    std::thread receiver([&] { error_of(SM2_SHUTDOWN, [&] { return subscriber.recv(); }); });
    std::thread waiter([&] { error_of(SM2_SHUTDOWN, [&] { return set.wait(); }); });
    signalled = &shutdown;
    std::signal(SIGUSR1, [](int) { signalled->request(); });
    CHECK(std::raise(SIGUSR1) == 0);
    receiver.join();
    waiter.join();
    CHECK(shutdown.is_requested());
    CHECK(!subscriber.try_recv());
}

}  // namespace

int main() {
    const sm2::Node node("wait-sets");
    all_sources(node);
    timers();
    a_shutdown_ends_all_waits();
    return 0;
}
