// Errors: codes, texts, and how to find out why.
#include "check.hpp"
#include "messages.hpp"

namespace {

struct Vector32 {
    float x, y, z;
};

}  // namespace

SM2_STRUCT(Vector32, "robot/Vector", x, y, z);

int main() {
    sm2::NodeOptions nowhere;
    nowhere.socket = "/nonexistent/sm2.sock";
    const std::string text =
        error_of(SM2_NO_MANAGER, [&] { return sm2::Node("errors", nowhere); });
    CHECK(has(text, "/nonexistent/sm2.sock") && has(text, "sm2 manager"));
    try {
        const sm2::Node node("errors", nowhere);
    } catch (const sm2::Error& error) {
        CHECK(error.system_error() == 2);
        CHECK(std::string(error.name()) == "SM2_NO_MANAGER");
    }

    const sm2::Node node("errors");
    node.wait_connected(soon);
    error_of(SM2_NAME_TAKEN, [] { return sm2::Node("errors"); });
    error_of(SM2_BAD_NAME, [&] { return node.publisher<double>("a b"); });
    sm2::PublisherOptions deep;
    deep.depth = 5000;
    error_of(SM2_BAD_QOS, [&] { return node.publisher<double>("errors/deep", deep); });

    // The same name with other fields is another type, and the text shows both.
    const auto publisher = node.publisher<robot::Vector>("errors/vector");
    const std::string both =
        error_of(SM2_TYPE_MISMATCH, [&] { return node.subscriber<Vector32>("errors/vector"); });
    CHECK(has(both, "here: robot/Vector") && has(both, "plain:struct{x:f32,y:f32,z:f32,}"));
    CHECK(has(both, "there: robot/Vector") && has(both, "plain:struct{x:f64,y:f64,z:f64,}"));

    // A reliable subscriber matches no best-effort publisher.
    sm2::SubscriberOptions reliable;
    reliable.reliable = 1;
    const auto subscriber = node.subscriber<robot::Vector>("errors/vector", reliable);
    error_of(SM2_TIMED_OUT, [&] { publisher.wait_for_subscribers(1, std::chrono::nanoseconds(0)); });
    CHECK(has(subscriber.why(), "reliable"));
    CHECK(has(publisher.why(), "reliable"));
    return 0;
}
