// Switches the laser of driver.cpp on, and prints the nearest distance of each scan: processor [SCANS]
#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include "scan.hpp"

int main(int argc, char** argv) try {
    using namespace std::chrono_literals;
    const unsigned long scans = argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 20;

    const sm2::Node node("processor");
    sm2::SubscriberOptions options;
    options.reliable = 1;
    const auto subscriber = node.subscriber<demo::Scan>("scan", options);
    const auto power = node.client<std::uint8_t, std::string>("laser/power");
    power.wait_for_servers(1, 60s);
    subscriber.wait_for_publishers(1, 60s);
    const auto answer = power.call(1, 60s);
    std::printf("laser %.*s\n", static_cast<int>((*answer).size()), (*answer).data());

    sm2::Sample<demo::Scan> scan;
    for (unsigned long taken = 0; taken < scans; taken++) {
        if (!subscriber.recv_into(scan, 60s)) {
            std::fprintf(stderr, "no scan in 60 s\n");
            return 1;
        }
        const auto nearest = std::min_element(scan->ranges_m.begin(), scan->ranges_m.end());
        std::printf("%.3f m\n", static_cast<double>(*nearest));
    }
    return 0;
} catch (const sm2::Error& error) {
    std::fprintf(stderr, "%s: %s\n", error.name(), error.what());
    return 1;
}
