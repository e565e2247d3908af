// Messages that are written in place, and read there.
#include <thread>
#include <vector>

#include "check.hpp"
#include "messages.hpp"

namespace {

void a_struct(const sm2::Node& node) {
    const auto publisher = node.publisher<robot::Imu>("loans/imu");
    const auto subscriber = node.subscriber<robot::Imu>("loans/imu");
    publisher.wait_for_subscribers(1, soon);
    sm2::Loan<robot::Imu> loan = publisher.loan();
    *loan = robot::Imu{};
    loan->stamp_ns = 5;
    CHECK(loan.publish().links == 1);
    CHECK(!loan);
    error_of(SM2_MISUSE, [&] { return loan->stamp_ns; });
    error_of(SM2_MISUSE, [&] { loan.publish(); });
    CHECK(subscriber.recv(soon)->stamp_ns == 5);

    // A loan that is dropped sends nothing: the next message is number 2.
    { const auto dropped = publisher.loan(); }
    publisher.loan_into(loan);
    *loan = robot::Imu{};
    sm2::Loan<robot::Imu> moved = std::move(loan);
    CHECK(moved && !loan);
    moved->stamp_ns = 6;
    moved.publish();
    const auto sample = subscriber.recv(soon);
    CHECK(sample->stamp_ns == 6 && sample.sequence() == 2);
}

// Images go from one thread to another, and are released by a third.
void images_between_threads(const sm2::Node& node) {
    constexpr std::size_t len = 1000000;
    constexpr std::uint8_t frames = 50;
    sm2::PublisherOptions offered;
    offered.publish_timeout(soon);
    offered.reliable = 1;
    offered.wait_share_percent = 100;
    const auto publisher = node.publisher<std::uint8_t[]>("loans/images", offered);
    sm2::SubscriberOptions demanded;
    demanded.reliable = 1;
    demanded.max_borrowed = 4;
    const auto subscriber = node.subscriber<std::uint8_t[]>("loans/images", demanded);
    publisher.wait_for_subscribers(1, soon);

    std::thread camera([&] {
        sm2::Loan<std::uint8_t[]> loan;
        for (std::uint8_t frame = 0; frame < frames; frame++) {
            publisher.loan_into(loan, len);
            CHECK((*loan).size() == len);
            for (std::uint8_t& pixel : *loan) {
                pixel = frame;
            }
            CHECK(loan.publish().missed == 0);
        }
    });
    for (std::uint8_t frame = 0; frame < frames; frame++) {
        auto sample = subscriber.recv(soon);
        CHECK(sample);
        std::thread viewer([frame, sample = std::move(sample)] {
            CHECK((*sample).size() == len);
            for (const std::uint8_t pixel : *sample) {
                CHECK(pixel == frame);
            }
        });
        viewer.join();
    }
    camera.join();
}

// The loan of a publisher that is destroyed can still be written and published.
void a_loan_outlives_its_publisher(const sm2::Node& node) {
    const auto subscriber = node.subscriber<double[]>("loans/late");
    sm2::Loan<double[]> loan;
    {
        const auto publisher = node.publisher<double[]>("loans/late");
        publisher.wait_for_subscribers(1, soon);
        loan = publisher.loan(3);
    }
    (*loan)[0] = (*loan)[1] = (*loan)[2] = 0.25;
    CHECK(loan.publish().links == 1);
    CHECK((*subscriber.recv(soon))[2] == 0.25);
}

void a_text(const sm2::Node& node) {
    const auto publisher = node.publisher<std::string>("loans/text");
    const auto subscriber = node.subscriber<std::string>("loans/text");
    publisher.wait_for_subscribers(1, soon);
    auto loan = publisher.loan(2);
    (*loan)[0] = 'h';
    (*loan)[1] = 'i';
    loan.publish();
    CHECK(*subscriber.recv(soon) == "hi");
}

void impossible_lengths(const sm2::Node& node) {
    const auto publisher = node.publisher<double[]>("loans/long");
    error_of(SM2_TOO_LONG, [&] { return publisher.loan(std::size_t{1} << 62); });
    error_of(SM2_TOO_LONG, [&] { return publisher.loan(std::size_t{1} << 50); });
    CHECK((*publisher.loan(0)).empty());
}

}  // namespace

int main() {
    const sm2::Node node("loans");
    a_struct(node);
    images_between_threads(node);
    a_loan_outlives_its_publisher(node);
    a_text(node);
    impossible_lengths(node);
    return 0;
}
