// The same types in C++ and in Rust: tests/peer.rs of sm2-c is the other side.
#include <vector>

#include "check.hpp"
#include "messages.hpp"

namespace {

struct Pose {
    double x;
    float heading;
    float other;
};

}  // namespace

SM2_STRUCT(Pose, "robot/Pose", x, heading, other);

int main() {
    const sm2::Node node("cpp-peer");
    const auto imu = node.subscriber<robot::Imu>("peer/imu");
    const auto vectors = node.publisher<robot::Vector[]>("peer/vectors");
    const auto sums = node.client<double[], double>("peer/sum");
    imu.wait_for_publishers(1, soon);
    vectors.wait_for_subscribers(1, soon);
    sums.wait_for_servers(1, soon);

    // A type of Rust with the same name and other fields.
    const std::string text =
        error_of(SM2_TYPE_MISMATCH, [&] { return node.subscriber<Pose>("peer/pose"); });
    CHECK(has(text, "plain:struct{x:f64,heading:f64,}"));
    CHECK(has(text, "plain:struct{x:f64,heading:f32,other:f32,}"));

    const double numbers[] = {0.5, 1.5};
    CHECK(*sums.call(numbers, soon) == 2.0);
    const auto sample = imu.recv(soon);
    CHECK(sample && sample.publisher() == "rust-peer");
    CHECK(sample->stamp_ns == 7 && sample->acceleration.y == -9.81);
    CHECK(sample->orientation[3] == 4.0F && sample->temperature[0] == -40 && sample->state == 3);
    const std::vector<robot::Vector> sent{{}, {}, {2.5, 0.0, -1.0}};
    vectors.publish(sent);
    CHECK(vectors.flush(soon));
    return 0;
}
