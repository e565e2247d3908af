// A driver: measures distances, writes them into shared memory, and obeys a service: driver [SCANS]
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "scan.hpp"

namespace {

// Stands in for the device.
void measure(demo::Scan& scan, std::uint64_t number) {
    scan.stamp_ns = sm2_now_ns();
    for (std::size_t i = 0; i < scan.ranges_m.size(); i++) {
        scan.ranges_m[i] = 2.0F + std::sin(static_cast<float>(number + i) / 10.0F);
    }
}

}  // namespace

int main(int argc, char** argv) try {
    using namespace std::chrono_literals;
    const unsigned long scans = argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 20;
    enum : std::uint64_t { tick, command };

    const sm2::Node node("laser");
    sm2::PublisherOptions options;
    options.reliable = 1;
    // The processor gets every scan: the driver waits for it as long as this takes.
    options.wait_share_percent = 100;
    options.publish_timeout(60s);
    const auto publisher = node.publisher<demo::Scan>("scan", options);
    const auto server = node.server<std::uint8_t, std::string>("laser/power");
    publisher.wait_for_subscribers(1, 60s);

    sm2::WaitSet set;
    set.add_timer_hz(100, tick);
    set.add(server, command);
    bool is_on = false;
    sm2::Loan<demo::Scan> scan;
    for (unsigned long sent = 0; sent < scans;) {
        const auto ready = set.wait(60s);
        if (!ready) {
            std::fprintf(stderr, "nobody switches the laser on\n");
            return 1;
        }
        if (ready->tag == command) {
            while (auto request = server.try_recv()) {
                is_on = *request != 0;
                request.reply(is_on ? "on" : "off");
            }
        } else if (is_on) {
            publisher.loan_into(scan);
            measure(*scan, ready->tick->number);
            scan.publish();
            sent++;
        }
    }
    return publisher.flush(60s) ? 0 : 1;
} catch (const sm2::Error& error) {
    std::fprintf(stderr, "%s: %s\n", error.name(), error.what());
    return 1;
}
