// Nodes.
#ifndef SM2_NODE_HPP
#define SM2_NODE_HPP

#include <string>

#include "sm2/service.hpp"
#include "sm2/topic.hpp"

namespace sm2 {

// A node of a domain. It ends with its last publisher, subscriber, server, client and message.
class Node {
public:
    // Connects to the Manager of the domain that the environment or the options name.
    explicit Node(const std::string& name, const NodeOptions& options = NodeOptions())
        : node_(detail::make<Owner>([&](sm2_node_t** node) {
              return sm2_node_connect(name.c_str(), &options, node);
          })) {}

    // Declares a publisher of messages of the type T.
    template <typename T>
    Publisher<T> publisher(const std::string& topic,
                           const PublisherOptions& options = PublisherOptions()) const {
        return Publisher<T>(node_.get(), topic, options);
    }

    // Declares a subscriber to messages of the type T.
    template <typename T>
    Subscriber<T> subscriber(const std::string& topic,
                             const SubscriberOptions& options = SubscriberOptions()) const {
        return Subscriber<T>(node_.get(), topic, options);
    }

    // Declares a server that answers requests of the type Q with replies of the type R.
    template <typename Q, typename R>
    Server<Q, R> server(const std::string& service,
                        const ServerOptions& options = ServerOptions()) const {
        return Server<Q, R>(node_.get(), service, options);
    }

    // Declares a client that sends requests of the type Q and gets replies of the type R.
    template <typename Q, typename R>
    Client<Q, R> client(const std::string& service,
                        const ClientOptions& options = ClientOptions()) const {
        return Client<Q, R>(node_.get(), service, options);
    }

    // Waits until a Manager has answered all declarations. Throws SM2_NO_MANAGER after the time limit.
    void wait_connected(std::chrono::nanoseconds timeout = forever) const {
        detail::check(sm2_node_wait_connected(node_.get(), detail::nanoseconds(timeout)));
    }

    // Drives a node without a background thread.
    void spin_some() const { detail::check(sm2_node_spin_some(node_.get())); }

    // Readable when a node without a background thread has work to do.
    int descriptor() const { return detail::descriptor(node_, sm2_node_descriptor); }

    // The handle of the C library.
    const sm2_node_t* handle() const noexcept { return node_.get(); }

private:
    using Owner = detail::Handle<sm2_node_t, sm2_node_free>;
    Owner node_;
};

}  // namespace sm2

#endif
