// Options of nodes and interfaces: a Manager of its own, no background thread, no rings, limits of lengths.
#include <dirent.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstring>
#include <vector>

#include "check.hpp"
#include "messages.hpp"

namespace {

// A node that brings its Manager along, in a folder of its own.
void a_manager_of_its_own() {
    char folder[] = "/tmp/sm2-cpp-XXXXXX";
    CHECK(mkdtemp(folder) != nullptr);
    const std::string socket = std::string(folder) + "/socket";
    {
        sm2::NodeOptions options;
        options.socket = socket.c_str();
        options.embed_manager = 1;
        const sm2::Node node("options", options);
        const auto publisher = node.publisher<double>("speed");
        const auto subscriber = node.subscriber<double>("speed");
        publisher.wait_for_subscribers(1, soon);
        publisher.publish(1.0);
        CHECK(*subscriber.recv(soon) == 1.0);
    }
    // The Manager leaves only its lock.
    DIR* opened = opendir(folder);
    CHECK(opened != nullptr);
    while (const dirent* entry = readdir(opened)) {
        unlink((std::string(folder) + "/" + entry->d_name).c_str());
    }
    closedir(opened);
    CHECK(rmdir(folder) == 0);
}

// Without rings, short messages come in datagrams: they are copied to be aligned, and the copy is used again.
void short_messages_without_rings_are_aligned() {
    sm2::NodeOptions options;
    options.ring_lane = 0;
    const sm2::Node node("options-sockets", options);
    const auto publisher = node.publisher<std::uint8_t[]>("options/bytes");
    const auto subscriber = node.subscriber<std::uint8_t[]>("options/bytes");
    publisher.wait_for_subscribers(1, soon);
    sm2::Sample<std::uint8_t[]> sample;
    for (std::size_t len : {1U, 64U, 65U, 3U, 4000U, 100U, 5000U, 0U}) {
        std::vector<std::uint8_t> bytes(len);
        for (std::size_t i = 0; i < len; i++) {
            bytes[i] = static_cast<std::uint8_t>(i * 7 + len);
        }
        publisher.publish(bytes);
        CHECK(subscriber.recv_into(sample, soon));
        const auto received = *sample;
        CHECK(received.size() == len);
        CHECK(len == 0 || std::memcmp(received.data(), bytes.data(), len) == 0);
        CHECK(len == 0 || reinterpret_cast<std::uintptr_t>(received.data()) % 64 == 0);
    }
}

// A program with an event loop of its own drives the node.
void without_a_background_thread() {
    sm2::NodeOptions options;
    options.background = 0;
    const sm2::Node node("options-driven", options);
    const auto publisher = node.publisher<double>("options/driven");
    const auto subscriber = node.subscriber<double>("options/driven");
    publisher.wait_for_subscribers(1, soon);
    publisher.publish(0.5);
    pollfd source{subscriber.descriptor(), POLLIN, 0};
    sm2::Sample<double> sample;
    while (!subscriber.recv_into(sample, std::chrono::nanoseconds(0))) {
        CHECK(poll(&source, 1, 60000) == 1);
        node.spin_some();
    }
    CHECK(*sample == 0.5);
    CHECK(node.descriptor() >= 0);
}

void a_subscriber_limits_the_length() {
    const sm2::Node node("options-lengths");
    const auto publisher = node.publisher<std::string>("options/text");
    sm2::SubscriberOptions options;
    options.max_len = 1024;
    const auto subscriber = node.subscriber<std::string>("options/text", options);
    publisher.wait_for_subscribers(1, soon);
    CHECK(publisher.publish(std::string(2000, 'x')).too_long == 1);
    CHECK(publisher.publish("short").too_long == 0);
    const auto sample = subscriber.recv(soon);
    CHECK(*sample == "short" && sample.sequence() == 2);
}

void latched_messages_come_first() {
    const sm2::Node node("options-latched");
    sm2::PublisherOptions options;
    options.latched = 2;
    options.deadline(std::chrono::hours(1)).lifespan(std::chrono::hours(1)).keep_idle(sm2::forever);
    const auto publisher = node.publisher<std::int32_t>("options/latched", options);
    for (std::int32_t i = 1; i <= 3; i++) {
        publisher.publish(i);
    }
    const auto subscriber = node.subscriber<std::int32_t>("options/latched");
    CHECK(*subscriber.recv(soon) == 2);
    CHECK(*subscriber.recv(soon) == 3);
}

}  // namespace

int main() {
    a_manager_of_its_own();
    short_messages_without_rings_are_aligned();
    without_a_background_thread();
    a_subscriber_limits_the_length();
    latched_messages_come_first();
    return 0;
}
