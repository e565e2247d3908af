// Publishers and subscribers.
#ifndef SM2_TOPIC_HPP
#define SM2_TOPIC_HPP

#include <string>
#include <string_view>
#include <utility>

#include "sm2/error.hpp"
#include "sm2/message.hpp"
#include "sm2/options.hpp"

namespace sm2 {

// The result of a publication: how many subscribers accepted the message, how many reliable ones miss it, and how many
// accept none of its length.
struct Published {
    std::uint64_t links;
    std::uint64_t missed;
    std::uint64_t too_long;
};

namespace detail {

template <typename Call>
Published published(Call&& call) {
    sm2_publish_result_t result{};
    result.size = sizeof result;
    check(call(&result));
    return {result.links, result.missed, result.too_long};
}

}  // namespace detail

// A message that is written in the memory that its subscribers read. Its values are unspecified at first.
template <typename T>
class Loan {
public:
    // Makes an empty loan, for Publisher::loan_into().
    Loan() noexcept = default;
    Loan(Loan&& other) noexcept
        : loan_(std::move(other.loan_)),
          data_(std::exchange(other.data_, nullptr)),
          len_(std::exchange(other.len_, 0)) {}
    Loan& operator=(Loan&& other) noexcept {
        loan_ = std::move(other.loan_);
        data_ = std::exchange(other.data_, nullptr);
        len_ = std::exchange(other.len_, 0);
        return *this;
    }

    // Whether there is memory to write: not after publish().
    explicit operator bool() const noexcept { return data_ != nullptr; }

    // The message, a reference or a span. Throws if the loan is spent.
    auto get() {
        if (data_ == nullptr) {
            throw Error(SM2_MISUSE, "the loan is spent: it was published; take a new one");
        }
        return Element::of(data_, len_);
    }
    decltype(auto) operator*() { return Element::value(get()); }
    auto operator->() { return get(); }

    // Sends the message without a copy. The loan is empty then, also after an error.
    Published publish() {
        data_ = nullptr;
        return detail::published(
            [&](sm2_publish_result_t* result) { return sm2_loan_publish(loan_.get(), result); });
    }

private:
    template <typename U>
    friend class Publisher;

    // A pointer to a single value, or a span of many.
    template <typename U>
    struct One {
        static U* of(void* data, std::size_t) noexcept { return static_cast<U*>(data); }
        static U& value(U* pointer) noexcept { return *pointer; }
    };
    template <typename U>
    struct One<U[]> {
        static span<U> of(void* data, std::size_t len) noexcept {
            return {static_cast<U*>(data), len / sizeof(U)};
        }
        static span<U> value(span<U> all) noexcept { return all; }
    };
    using Element = One<typename Message<T>::Loaned>;

    void take(const sm2_publisher_t* publisher, std::size_t len) {
        data_ = nullptr;
        detail::check(detail::fill(
            loan_, [&](sm2_loan_t** loan) { return sm2_publisher_loan(publisher, len, loan); }));
        detail::check(sm2_loan_data(loan_.get(), &data_, &len_));
    }

    detail::Handle<sm2_loan_t, sm2_loan_free> loan_;
    void* data_ = nullptr;
    std::size_t len_ = 0;
};

// Sends messages of the type T to all subscribers of a topic. Node::publisher() makes it.
template <typename T>
class Publisher {
    // Whether a loan has any number of elements.
    template <typename U>
    static constexpr bool is_list = std::is_array_v<typename Message<U>::Loaned>;

public:
    // Sends one message. Waits only for reliable subscribers, for at most the option publish_timeout.
    Published publish(typename Message<T>::Argument message) const {
        const detail::Bytes bytes = Message<T>::bytes(message);
        return detail::published([&](sm2_publish_result_t* result) {
            return sm2_publisher_publish(publisher_.get(), bytes.data, bytes.len, result);
        });
    }

    // Sends one message to all subscribers, or to none and returns false: a reliable one has no room.
    bool try_publish(typename Message<T>::Argument message) const {
        const detail::Bytes bytes = Message<T>::bytes(message);
        return detail::found(
            sm2_publisher_try_publish(publisher_.get(), bytes.data, bytes.len, nullptr));
    }

    // Allocates memory for one message, which is written in place.
    template <typename U = T, typename = std::enable_if_t<!is_list<U>>>
    Loan<T> loan() const {
        Loan<T> loan;
        loan_into(loan);
        return loan;
    }

    // Allocates memory for a message of `count` elements.
    template <typename U = T, typename = std::enable_if_t<is_list<U>>>
    Loan<T> loan(std::size_t count) const {
        Loan<T> loan;
        loan_into(loan, count);
        return loan;
    }

    // As loan(), with the handle of an earlier loan: a loop allocates nothing.
    template <typename U = T, typename = std::enable_if_t<!is_list<U>>>
    void loan_into(Loan<T>& loan) const {
        loan.take(publisher_.get(), sizeof(T));
    }
    template <typename U = T, typename = std::enable_if_t<is_list<U>>>
    void loan_into(Loan<T>& loan, std::size_t count) const {
        using Element = std::remove_extent_t<typename Message<T>::Loaned>;
        if (count > static_cast<std::size_t>(-1) / sizeof(Element)) {
            throw Error(SM2_TOO_LONG, "no message has " + std::to_string(count) + " elements");
        }
        loan.take(publisher_.get(), count * sizeof(Element));
    }

    // Waits until `count` subscribers are linked. Throws SM2_TIMED_OUT after the time limit.
    void wait_for_subscribers(std::size_t count, std::chrono::nanoseconds timeout = forever) const {
        detail::check(sm2_publisher_wait_for_subscribers(publisher_.get(), count,
                                                         detail::nanoseconds(timeout)));
    }

    // Waits until no message waits in the publisher. Returns whether that is so.
    bool flush(std::chrono::nanoseconds timeout = forever) const {
        return detail::found(sm2_publisher_flush(publisher_.get(), detail::nanoseconds(timeout)));
    }

    void assert_liveliness() const {
        detail::check(sm2_publisher_assert_liveliness(publisher_.get()));
    }

    sm2_publisher_counters_t counters() const {
        sm2_publisher_counters_t counters{};
        counters.size = sizeof counters;
        detail::check(sm2_publisher_counters(publisher_.get(), &counters));
        return counters;
    }

    // Explains why there are no links; empty if no subscriber comes close.
    std::string why() const {
        return detail::text([&](char** text) { return sm2_publisher_why(publisher_.get(), text); });
    }

    // Readable when a reliable subscriber may have room again.
    int descriptor() const { return detail::descriptor(publisher_, sm2_publisher_descriptor); }

    // The handle of the C library.
    const sm2_publisher_t* handle() const noexcept { return publisher_.get(); }

private:
    friend class Node;
    using Owner = detail::Handle<sm2_publisher_t, sm2_publisher_free>;

    Publisher(const sm2_node_t* node, const std::string& topic, const PublisherOptions& options)
        : publisher_(detail::make<Owner>([&](sm2_publisher_t** publisher) {
              return sm2_publisher_new(node, topic.c_str(), Message<T>::type(), &options, publisher);
          })) {}

    Owner publisher_;
};

// A received message. Its bytes do not change while the sample exists, which may outlive its subscriber and its node.
template <typename T>
class Sample {
public:
    // Makes an empty sample, for Subscriber::recv_into().
    Sample() noexcept = default;
    Sample(Sample&& other) noexcept
        : sample_(std::move(other.sample_)),
          data_(std::exchange(other.data_, nullptr)),
          len_(std::exchange(other.len_, 0)) {}
    Sample& operator=(Sample&& other) noexcept {
        sample_ = std::move(other.sample_);
        data_ = std::exchange(other.data_, nullptr);
        len_ = std::exchange(other.len_, 0);
        return *this;
    }

    // Whether it has a message.
    explicit operator bool() const noexcept { return data_ != nullptr; }

    // The message: a reference to it, or a view of its elements or characters. Throws if there is none.
    typename Message<T>::View operator*() const {
        if (data_ == nullptr) {
            throw Error(SM2_MISUSE, "the sample is empty: receive a message first");
        }
        return Message<T>::view(data_, len_);
    }
    template <typename U = T, typename = std::enable_if_t<detail::is_plain<U>>>
    const U* operator->() const {
        return &**this;
    }

    // The number of the publication, from 1.
    std::uint64_t sequence() const { return info().sequence; }

    // The time of publication, of the monotonic clock (std::chrono::steady_clock).
    std::chrono::nanoseconds source_time() const {
        return std::chrono::nanoseconds(static_cast<std::int64_t>(info().source_time_ns));
    }

    // How many messages of this publisher were lost since the sample before.
    std::uint64_t lost() const { return info().lost; }

    // The name of the publisher's node, valid as long as this message.
    std::string_view publisher() const {
        const sm2_sample_info_t all = info();
        return {all.publisher, all.publisher_len};
    }

    // All that is known about the message.
    sm2_sample_info_t info() const {
        sm2_sample_info_t info{};
        info.size = sizeof info;
        detail::check(sm2_sample_info(sample_.get(), &info));
        return info;
    }

    // Releases the message, so that its publisher can use the memory again.
    void release() noexcept {
        data_ = nullptr;
        if (sample_ != nullptr) {
            sm2_sample_release(sample_.get());
        }
    }

private:
    template <typename U>
    friend class Subscriber;

    bool take(const sm2_subscriber_t* subscriber, std::chrono::nanoseconds timeout) {
        data_ = nullptr;
        if (!detail::found(detail::fill(sample_, [&](sm2_sample_t** sample) {
                return sm2_subscriber_recv(subscriber, detail::nanoseconds(timeout), sample);
            }))) {
            return false;
        }
        const void* data = nullptr;
        detail::check(sm2_sample_data(sample_.get(), &data, &len_));
        try {
            Message<T>::check(len_);
        } catch (...) {
            release();
            throw;
        }
        data_ = data;
        return true;
    }

    detail::Handle<sm2_sample_t, sm2_sample_free> sample_;
    const void* data_ = nullptr;
    std::size_t len_ = 0;
};

// Receives messages of the type T from all publishers of a topic. Node::subscriber() makes it.
template <typename T>
class Subscriber {
public:
    // Waits for the next message. Returns an empty sample after the time limit.
    Sample<T> recv(std::chrono::nanoseconds timeout = forever) const {
        Sample<T> sample;
        recv_into(sample, timeout);
        return sample;
    }

    // Returns the next message; an empty sample if none has arrived.
    Sample<T> try_recv() const { return recv(std::chrono::nanoseconds(0)); }

    // As recv(), with the handle of an earlier sample, which is released first: a loop allocates nothing. Returns
    // whether there is a message.
    bool recv_into(Sample<T>& sample, std::chrono::nanoseconds timeout = forever) const {
        return sample.take(subscriber_.get(), timeout);
    }

    // Waits until `count` publishers are linked. Throws SM2_TIMED_OUT after the time limit.
    void wait_for_publishers(std::size_t count, std::chrono::nanoseconds timeout = forever) const {
        detail::check(sm2_subscriber_wait_for_publishers(subscriber_.get(), count,
                                                         detail::nanoseconds(timeout)));
    }

    sm2_subscriber_counters_t counters() const {
        sm2_subscriber_counters_t counters{};
        counters.size = sizeof counters;
        detail::check(sm2_subscriber_counters(subscriber_.get(), &counters));
        return counters;
    }

    // Explains why there are no links; empty if no publisher comes close.
    std::string why() const {
        return detail::text([&](char** text) { return sm2_subscriber_why(subscriber_.get(), text); });
    }

    // Readable when try_recv() may have a message.
    int descriptor() const { return detail::descriptor(subscriber_, sm2_subscriber_descriptor); }

    // The handle of the C library.
    const sm2_subscriber_t* handle() const noexcept { return subscriber_.get(); }

private:
    friend class Node;
    using Owner = detail::Handle<sm2_subscriber_t, sm2_subscriber_free>;

    Subscriber(const sm2_node_t* node, const std::string& topic, const SubscriberOptions& options)
        : subscriber_(detail::make<Owner>([&](sm2_subscriber_t** subscriber) {
              return sm2_subscriber_new(node, topic.c_str(), Message<T>::type(), &options, subscriber);
          })) {}

    Owner subscriber_;
};

}  // namespace sm2

#endif
