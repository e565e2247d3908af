// Messages of ROS 2: sm2-python/examples/ros_peer.rs is the other side, whose types are generated from the definitions.
// It returns each message with one change.
#include <cstring>
#include <vector>

#include "check.hpp"

namespace {

struct Text;
struct Image;
struct Unknown;
struct NoFolder;

using Bytes = std::vector<unsigned char>;

// "hello", then its length with the NUL at the end, behind the 4 bytes of the encapsulation.
const Bytes hello = {0, 1, 0, 0, 6, 0, 0, 0, 'h', 'e', 'l', 'l', 'o', 0};
const Bytes hello_echo = {0, 1, 0, 0, 7, 0, 0, 0, 'h', 'e', 'l', 'l', 'o', '!', 0};

// The time 7 s 9 ns, the frame, height 1 and width 2, the encoding, no big endian, step 2, and two bytes of data.
const Bytes image = {0, 1, 0,   0,   7,   0,   0,   0,   9, 0, 0, 0, 6, 0, 0, 0, 'f', 'r', 'o', 'n',
                     't', 0, 0,   0,   1,   0,   0,   0,   2, 0, 0, 0, 6, 0, 0, 0, 'm', 'o', 'n', 'o',
                     '8', 0, 0,   0,   2,   0,   0,   0,   2, 0, 0, 0, 170, 187};
constexpr std::size_t width_at = 28;

sm2::span<const std::byte> bytes(const Bytes& message) {
    return {reinterpret_cast<const std::byte*>(message.data()), message.size()};
}

Bytes copy(sm2::span<const std::byte> message) {
    const auto* first = reinterpret_cast<const unsigned char*>(message.data());
    return Bytes(first, first + message.size());
}

}  // namespace

SM2_ROS_TYPE(Text, "std_msgs/msg/String");
SM2_ROS_TYPE(Image, "sensor_msgs/msg/Image");
SM2_ROS_TYPE(Unknown, "std_msgs/msg/Nothing");
SM2_ROS_TYPE(NoFolder, "std_msgs/msg/String", "/no/such/folder");

int main() {
    const sm2::Node node("cpp-ros");
    const auto texts = node.publisher<Text>("ros/string");
    const auto images = node.publisher<Image>("ros/image");
    const auto text_echo = node.subscriber<Text>("ros/string/echo");
    const auto image_echo = node.subscriber<Image>("ros/image/echo");
    texts.wait_for_subscribers(1, soon);
    images.wait_for_subscribers(1, soon);
    text_echo.wait_for_publishers(1, soon);
    image_echo.wait_for_publishers(1, soon);

    texts.publish(bytes(hello));
    const auto text = text_echo.recv(soon);
    CHECK(text && copy(*text) == hello_echo);

    // The encoding is written in the memory that the subscribers read.
    auto loan = images.loan(image.size());
    std::memcpy(loan.get().data(), image.data(), image.size());
    loan.publish();
    Bytes wider = image;
    wider[width_at] += 1;
    const auto echo = image_echo.recv(soon);
    CHECK(echo && copy(*echo) == wider);

    // The peer's subscriber has the hash of ROS 2, so another type does not get it.
    const std::string other =
        error_of(SM2_TYPE_MISMATCH, [&] { return node.publisher<Image>("ros/string"); });
    CHECK(has(other, "std_msgs/msg/String") && has(other, "sensor_msgs/msg/Image"));
    const std::string nothing =
        error_of(SM2_BAD_SCHEMA, [&] { return node.publisher<Unknown>("ros/unknown"); });
    CHECK(has(nothing, "std_msgs/msg/Nothing"));
    const std::string folder =
        error_of(SM2_IO, [&] { return node.publisher<NoFolder>("ros/unknown"); });
    CHECK(has(folder, "/no/such/folder"));
    return 0;
}
