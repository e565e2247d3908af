// Sends frames of 10 MB, or checks every byte of them: frames out|in FRAMES. The receiver prints frames per second.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "sm2/sm2.hpp"

namespace {

constexpr std::size_t len = 10000000;
constexpr std::chrono::seconds soon{60};

void send(const sm2::Node& node, unsigned long frames) {
    sm2::PublisherOptions options;
    options.publish_timeout(soon);
    options.reliable = 1;
    options.wait_share_percent = 100;
    const auto publisher = node.publisher<std::uint8_t[]>("frames", options);
    publisher.wait_for_subscribers(1, soon);
    const std::vector<std::uint8_t> frame(len, 7);
    sm2::Loan<std::uint8_t[]> loan;
    for (unsigned long i = 0; i < frames; i++) {
        publisher.loan_into(loan, len);
        std::memcpy((*loan).data(), frame.data(), len);
        loan.publish();
    }
    publisher.flush(soon);
}

int receive(const sm2::Node& node, unsigned long frames) {
    sm2::SubscriberOptions options;
    options.reliable = 1;
    const auto subscriber = node.subscriber<std::uint8_t[]>("frames", options);
    const std::vector<std::uint8_t> frame(len, 7);
    sm2::Sample<std::uint8_t[]> sample;
    std::uint64_t start = 0;
    for (unsigned long i = 0; i < frames; i++) {
        if (!subscriber.recv_into(sample, soon) ||
            std::memcmp((*sample).data(), frame.data(), len) != 0) {
            return 1;
        }
        // The first frames allocate the memory.
        if (i == frames / 10) {
            start = sm2_now_ns();
        }
    }
    const double seconds = static_cast<double>(sm2_now_ns() - start) / 1e9;
    std::printf("%.1f\n", static_cast<double>(frames - frames / 10 - 1) / seconds);
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    if (argc != 3) {
        return 2;
    }
    const bool is_out = std::string(argv[1]) == "out";
    const unsigned long frames = std::strtoul(argv[2], nullptr, 10);
    const sm2::Node node(argv[1]);
    if (is_out) {
        send(node, frames);
        return 0;
    }
    return receive(node, frames);
}
