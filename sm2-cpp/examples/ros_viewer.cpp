// Prints the images of ros_camera.cpp: ros_viewer [IMAGES]
#include <cstdio>
#include <cstdlib>
#include <numeric>

#include "ros_image.hpp"

int main(int argc, char** argv) try {
    using namespace std::chrono_literals;
    const unsigned long images = argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 20;
    const sm2::Node node("ros_viewer");
    sm2::SubscriberOptions options;
    options.reliable = 1;
    const auto subscriber = node.subscriber<demo::Image>("ros/image", options);
    for (unsigned long number = 0; number < images; number++) {
        const auto sample = subscriber.recv(60s);
        if (!sample) {
            std::fprintf(stderr, "no image\n");
            return 1;
        }
        const demo::Image image = demo::decode(*sample);
        const auto sum = std::accumulate(image.data.begin(), image.data.end(), 0.0);
        std::printf("%ux%u of %s: %.1f\n", image.width, image.height, image.frame_id.c_str(),
                    sum / static_cast<double>(image.data.size()));
    }
    return 0;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
