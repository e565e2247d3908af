// Publishing and receiving all kinds of messages, by copy.
#include <cstring>
#include <vector>

#include "check.hpp"
#include "messages.hpp"

namespace {

// A pair of linked interfaces.
template <typename T>
struct Pair {
    sm2::Publisher<T> publisher;
    sm2::Subscriber<T> subscriber;

    Pair(const sm2::Node& node, const std::string& topic)
        : publisher(node.publisher<T>(topic)), subscriber(node.subscriber<T>(topic)) {
        publisher.wait_for_subscribers(1, soon);
        subscriber.wait_for_publishers(1, soon);
    }
};

void structs(const sm2::Node& node) {
    const Pair<robot::Imu> imu(node, "topics/imu");
    robot::Imu message{};
    message.stamp_ns = 7;
    message.acceleration.y = -9.81;
    message.temperature[2] = -40;
    const sm2::Published published = imu.publisher.publish(message);
    CHECK(published.links == 1 && published.missed == 0 && published.too_long == 0);
    const sm2::Sample<robot::Imu> sample = imu.subscriber.recv(soon);
    CHECK(sample);
    CHECK(std::memcmp(&*sample, &message, sizeof message) == 0);
    CHECK(sample->acceleration.y < -9.0);
    CHECK(sample.sequence() == 1 && sample.lost() == 0);
    CHECK(sample.publisher() == "topics");
    CHECK(sample.source_time() <= std::chrono::steady_clock::now().time_since_epoch());
    const sm2_sample_info_t info = sample.info();
    CHECK(std::string(info.type_name, info.type_name_len) == "robot/Imu");
    CHECK(reinterpret_cast<std::uintptr_t>(&*sample) % 64 == 0);
}

void numbers_lists_text_and_bytes(const sm2::Node& node) {
    const Pair<double> speed(node, "topics/speed");
    speed.publisher.publish(1.5);
    CHECK(*speed.subscriber.recv(soon) == 1.5);

    const Pair<float[]> scan(node, "topics/scan");
    const std::vector<float> ranges{1.0F, 2.0F, 4.0F};
    scan.publisher.publish(ranges);
    const auto received = scan.subscriber.recv(soon);
    CHECK((*received).size() == 3 && (*received)[2] == 4.0F);
    scan.publisher.publish({});
    CHECK((*scan.subscriber.recv(soon)).empty());

    const Pair<std::string> chatter(node, "topics/chatter");
    chatter.publisher.publish("hello");
    CHECK(*chatter.subscriber.recv(soon) == "hello");

    const Pair<std::byte[]> raw(node, "topics/raw");
    const std::array<std::byte, 2> bytes{std::byte{1}, std::byte{2}};
    raw.publisher.publish(bytes);
    CHECK((*raw.subscriber.recv(soon))[1] == std::byte{2});
}

void handles_are_used_again_and_moved(const sm2::Node& node) {
    const Pair<std::uint32_t> count(node, "topics/count");
    sm2::Sample<std::uint32_t> sample;
    CHECK(!sample);
    error_of(SM2_MISUSE, [&] { return *sample; });
    for (std::uint32_t i = 0; i < 20; i++) {
        count.publisher.publish(i);
        CHECK(count.subscriber.recv_into(sample, soon));
        CHECK(*sample == i);
    }
    CHECK(!count.subscriber.recv_into(sample, std::chrono::nanoseconds(0)));
    CHECK(!sample);
    CHECK(!count.subscriber.try_recv());

    count.publisher.publish(99);
    sample = count.subscriber.recv(soon);
    sm2::Sample<std::uint32_t> moved = std::move(sample);
    CHECK(moved && *moved == 99);
    CHECK(!sample);
    moved.release();
    CHECK(!moved);
    CHECK(count.publisher.counters().offered == 21);
    CHECK(count.publisher.flush(soon));
    CHECK(count.publisher.counters().delivered == 21);
    CHECK(count.subscriber.counters().lost == 0 && count.subscriber.counters().links == 1);
}

void a_message_of_another_length_is_an_error(const sm2::Node& node) {
    const auto subscriber = node.subscriber<robot::Vector>("topics/vector");
    // A publisher may declare a type and send other bytes.
    sm2_publisher_t* liar = nullptr;
    CHECK(sm2_publisher_new(node.handle(), "topics/vector", sm2::Message<robot::Vector>::type(),
                            nullptr, &liar) == SM2_OK);
    CHECK(sm2_publisher_wait_for_subscribers(liar, 1, sm2::detail::nanoseconds(soon)) == SM2_OK);
    CHECK(sm2_publisher_publish(liar, "abc", 3, nullptr) == SM2_OK);
    const std::string text = error_of(SM2_UNREADABLE, [&] { return subscriber.recv(soon); });
    CHECK(text == "a message of type robot/Vector cannot have 3 bytes: check who publishes it");
    sm2_publisher_free(liar);
}

// Short messages do not count as borrowed. Each stays as it is, and where it is, while the program holds it.
void short_samples_are_held(const sm2::Node& node) {
    constexpr std::size_t count = 100;
    const Pair<robot::Vector> pair(node, "topics/held");
    std::vector<sm2::Sample<robot::Vector>> samples;
    std::vector<const robot::Vector*> places;
    for (std::size_t i = 0; i < count; i++) {
        pair.publisher.publish(robot::Vector{static_cast<double>(i), 0.0, 1.0});
        samples.push_back(pair.subscriber.recv(soon));
        CHECK(samples.back());
        places.push_back(&*samples.back());
        CHECK(reinterpret_cast<std::uintptr_t>(places.back()) % 64 == 0);
    }
    for (std::size_t i = 0; i < count; i++) {
        CHECK(&*samples[i] == places[i]);
        CHECK(samples[i]->x == static_cast<double>(i) && samples[i]->z == 1.0);
    }
}

void samples_outlive_everything() {
    sm2::Sample<robot::Vector[]> sample;
    {
        const sm2::Node node("topics-short");
        const Pair<robot::Vector[]> pair(node, "topics/short");
        const std::vector<robot::Vector> many(10000, robot::Vector{1.0, 2.0, 3.0});
        pair.publisher.publish(many);
        sample = pair.subscriber.recv(soon);
    }
    CHECK((*sample).size() == 10000);
    for (const robot::Vector& vector : *sample) {
        CHECK(vector.x == 1.0 && vector.z == 3.0);
    }
}

}  // namespace

int main() {
    const sm2::Node node("topics");
    structs(node);
    numbers_lists_text_and_bytes(node);
    handles_are_used_again_and_moved(node);
    a_message_of_another_length_is_an_error(node);
    short_samples_are_held(node);
    samples_outlive_everything();
    return 0;
}
