// SM2 in C++ for sm2-bench: pooled and reliable. Short messages are copied; longer ones are written into loans.
#include "bench_dds.h"

#include <array>
#include <exception>
#include <string>

#include <unistd.h>

#include <sm2/sm2.hpp>

struct bench_participant {
  sm2::Node node;
};

struct bench_publisher {
  sm2::Publisher<std::uint8_t[]> publisher;
  sm2::Loan<std::uint8_t[]> loan;
};

struct bench_subscriber {
  sm2::Subscriber<std::uint8_t[]> subscriber;
  sm2::Sample<std::uint8_t[]> sample;
};

namespace {

// The longest message that is copied, in bytes: copying it is faster than taking a loan.
constexpr std::size_t SHORT = 1024;
// Timeout of reliable messages.
constexpr std::chrono::seconds TIMEOUT{20};

thread_local std::string reason;

// Calls a function, and turns an exception into the result `failure` and the text of bench_error.
template <typename Result, typename Call>
Result guarded(Result failure, Call &&call) {
  try {
    return call();
  } catch (const std::exception &error) {
    reason = error.what();
    return failure;
  }
}

std::uint16_t depth(const bench_topic *topic) {
  return static_cast<std::uint16_t>(topic->depth < 1 ? 1 : topic->depth > 1024 ? 1024 : topic->depth);
}

}  // namespace

const char *bench_error(void) { return reason.c_str(); }

// The mode is the path of the Manager's socket.
bench_participant *bench_open(uint32_t, const char *mode) {
  return guarded<bench_participant *>(nullptr, [&] {
    const std::string name = "bench-" + std::to_string(getpid());
    sm2::NodeOptions options;
    options.socket = mode;
    return new bench_participant{sm2::Node(name, options)};
  });
}

bench_publisher *bench_publish_on(bench_participant *participant, const bench_topic *topic) {
  return guarded<bench_publisher *>(nullptr, [&] {
    sm2::PublisherOptions options;
    options.depth = depth(topic);
    options.reliable = true;
    options.publish_timeout_ns = std::chrono::nanoseconds(TIMEOUT).count();
    return new bench_publisher{participant->node.publisher<std::uint8_t[]>(topic->name, options), {}};
  });
}

int bench_matched(bench_publisher *publisher) {
  return guarded(-1, [&] {
    int count = 0;
    try {
      for (;; count++) publisher->publisher.wait_for_subscribers(static_cast<std::size_t>(count) + 1, std::chrono::nanoseconds(0));
    } catch (const sm2::Error &error) {
      if (error.code() != SM2_TIMED_OUT) throw;
    }
    return count;
  });
}

int bench_publish(bench_publisher *publisher, size_t len, bench_write write, void *context) {
  return guarded(-1, [&] {
    sm2::Published published{};
    if (len <= SHORT) {
      std::array<std::uint8_t, SHORT> message;
      write(context, message.data(), len);
      published = publisher->publisher.publish({message.data(), len});
    } else {
      publisher->publisher.loan_into(publisher->loan, len);
      write(context, publisher->loan.get().data(), len);
      published = publisher->loan.publish();
    }
    if (published.missed == 0) return 0;
    reason = "a subscriber missed a message";
    return -1;
  });
}

bench_subscriber *bench_subscribe_to(bench_participant *participant, const bench_topic *topic) {
  return guarded<bench_subscriber *>(nullptr, [&] {
    sm2::SubscriberOptions options;
    options.depth = depth(topic);
    options.reliable = true;
    options.max_borrowed = 1;
    return new bench_subscriber{participant->node.subscriber<std::uint8_t[]>(topic->name, options), {}};
  });
}

int bench_pump(bench_subscriber *subscriber, uint64_t timeout_ns, bench_read read, void *context) {
  return guarded(-1, [&] {
    const auto until = std::chrono::steady_clock::now() + std::chrono::nanoseconds(timeout_ns);
    for (;;) {
      const auto left = until - std::chrono::steady_clock::now();
      if (left <= left.zero() || !subscriber->subscriber.recv_into(subscriber->sample, left)) return 0;
      const auto message = *subscriber->sample;
      const int done = read(context, message.data(), message.size());
      subscriber->sample.release();
      if (done != 0) return 0;
    }
  });
}
