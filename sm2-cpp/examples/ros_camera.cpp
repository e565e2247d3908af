// Publishes images of ROS 2: ros_camera [IMAGES]
#include <cstdio>
#include <cstdlib>

#include "ros_image.hpp"

int main(int argc, char** argv) try {
    using namespace std::chrono_literals;
    const unsigned long images = argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 20;
    const sm2::Node node("ros_camera");
    sm2::PublisherOptions options;
    options.reliable = 1;
    // The viewer gets every image: the camera waits for it as long as this takes.
    options.wait_share_percent = 100;
    options.publish_timeout(60s);
    const auto publisher = node.publisher<demo::Image>("ros/image", options);
    publisher.wait_for_subscribers(1, 60s);

    demo::Image image;
    image.frame_id = "front";
    image.height = 480;
    image.width = image.step = 640;
    image.encoding = "mono8";
    for (unsigned long number = 0; number < images; number++) {
        image.data.assign(480 * 640, static_cast<std::uint8_t>(number));
        eprosima::fastcdr::FastBuffer buffer;
        publisher.publish(demo::encode(image, buffer));
    }
    return publisher.flush(60s) ? 0 : 1;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
