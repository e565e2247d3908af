// Servers and clients.
#ifndef SM2_SERVICE_HPP
#define SM2_SERVICE_HPP

#include <string>
#include <string_view>
#include <utility>

#include "sm2/error.hpp"
#include "sm2/message.hpp"
#include "sm2/options.hpp"

namespace sm2 {

// A request of the type Q, which is answered with a message of the type R. Its client learns of a failure if it is
// destroyed without an answer.
template <typename Q, typename R>
class Request {
public:
    // Makes an empty request, for Server::recv_into().
    Request() noexcept = default;

    // Whether it has a request that is not answered yet.
    explicit operator bool() const noexcept { return request_ != nullptr && is_held_; }

    // The message: a reference to it, or a view. Throws if the request is answered.
    typename Message<Q>::View operator*() const {
        const void* data = nullptr;
        std::size_t len = 0;
        detail::check(sm2_request_data(request_.get(), &data, &len));
        return Message<Q>::view(data, len);
    }
    template <typename U = Q, typename = std::enable_if_t<detail::is_plain<U>>>
    const U* operator->() const {
        return &**this;
    }

    // Sends the reply, and does not wait.
    void reply(typename Message<R>::Argument message) {
        const detail::Bytes bytes = Message<R>::bytes(message);
        is_held_ = false;
        detail::check(sm2_request_reply(request_.get(), bytes.data, bytes.len));
    }

    // Answers that the request failed.
    void fail(const std::string& reason) {
        is_held_ = false;
        detail::check(sm2_request_fail(request_.get(), reason.c_str()));
    }

    // Whether the client does not want the reply any more.
    bool is_cancelled() const {
        bool cancelled = false;
        detail::check(sm2_request_is_cancelled(request_.get(), &cancelled));
        return cancelled;
    }

    // The name of the client's node, valid until the answer.
    std::string_view client() const {
        sm2_request_info_t info{};
        info.size = sizeof info;
        detail::check(sm2_request_info(request_.get(), &info));
        return {info.client, info.client_len};
    }

private:
    template <typename A, typename B>
    friend class Server;

    bool take(const sm2_server_t* server, std::chrono::nanoseconds timeout) {
        is_held_ = false;
        if (!detail::found(detail::fill(request_, [&](sm2_request_t** request) {
                return sm2_server_recv(server, detail::nanoseconds(timeout), request);
            }))) {
            return false;
        }
        is_held_ = true;
        const void* data = nullptr;
        std::size_t len = 0;
        detail::check(sm2_request_data(request_.get(), &data, &len));
        try {
            Message<Q>::check(len);
        } catch (const Error& error) {
            fail(error.what());
            throw;
        }
        return true;
    }

    detail::Handle<sm2_request_t, sm2_request_free> request_;
    bool is_held_ = false;
};

// Receives requests of the type Q and replies with messages of the type R. Node::server() makes it.
template <typename Q, typename R>
class Server {
public:
    // Waits for the next request. Returns an empty one after the time limit.
    Request<Q, R> recv(std::chrono::nanoseconds timeout = forever) const {
        Request<Q, R> request;
        recv_into(request, timeout);
        return request;
    }

    // Returns the next request; an empty one if none has arrived.
    Request<Q, R> try_recv() const { return recv(std::chrono::nanoseconds(0)); }

    // As recv(), with the handle of an earlier request. Returns whether there is one.
    bool recv_into(Request<Q, R>& request, std::chrono::nanoseconds timeout = forever) const {
        return request.take(server_.get(), timeout);
    }

    // Waits until `count` clients are linked. Throws SM2_TIMED_OUT after the time limit.
    void wait_for_clients(std::size_t count, std::chrono::nanoseconds timeout = forever) const {
        detail::check(
            sm2_server_wait_for_clients(server_.get(), count, detail::nanoseconds(timeout)));
    }

    // Explains why there are no links; empty if no client comes close.
    std::string why() const {
        return detail::text([&](char** text) { return sm2_server_why(server_.get(), text); });
    }

    // Readable when try_recv() may have a request.
    int descriptor() const { return detail::descriptor(server_, sm2_server_descriptor); }

    // The handle of the C library.
    const sm2_server_t* handle() const noexcept { return server_.get(); }

private:
    friend class Node;
    using Owner = detail::Handle<sm2_server_t, sm2_server_free>;

    Server(const sm2_node_t* node, const std::string& service, const ServerOptions& options)
        : server_(detail::make<Owner>([&](sm2_server_t** server) {
              return sm2_server_new(node, service.c_str(), Message<Q>::type(), Message<R>::type(),
                                    &options, server);
          })) {}

    Owner server_;
};

// A reply of the type R. Its bytes do not change while it exists.
template <typename R>
class Reply {
public:
    // Makes an empty reply, for Client::call_into().
    Reply() noexcept = default;
    Reply(Reply&& other) noexcept
        : reply_(std::move(other.reply_)),
          data_(std::exchange(other.data_, nullptr)),
          len_(std::exchange(other.len_, 0)) {}
    Reply& operator=(Reply&& other) noexcept {
        reply_ = std::move(other.reply_);
        data_ = std::exchange(other.data_, nullptr);
        len_ = std::exchange(other.len_, 0);
        return *this;
    }

    // Whether it has a message.
    explicit operator bool() const noexcept { return data_ != nullptr; }

    // The message: a reference to it, or a view. Throws if there is none.
    typename Message<R>::View operator*() const {
        if (data_ == nullptr) {
            throw Error(SM2_MISUSE, "the reply is empty: no call has stored a reply in it");
        }
        return Message<R>::view(data_, len_);
    }
    template <typename U = R, typename = std::enable_if_t<detail::is_plain<U>>>
    const U* operator->() const {
        return &**this;
    }

    // The name of the server's node, valid as long as this reply.
    std::string_view server() const {
        const char* name = nullptr;
        std::size_t len = 0;
        detail::check(sm2_reply_server(reply_.get(), &name, &len));
        return {name, len};
    }

private:
    template <typename A, typename B>
    friend class Client;
    template <typename A>
    friend class Call;

    // Stores the reply that a call of the C library finds. Returns whether there is one.
    template <typename Ask>
    bool take(Ask&& ask) {
        data_ = nullptr;
        if (!detail::found(detail::fill(reply_, ask))) {
            return false;
        }
        const void* data = nullptr;
        detail::check(sm2_reply_data(reply_.get(), &data, &len_));
        Message<R>::check(len_);
        data_ = data;
        return true;
    }

    detail::Handle<sm2_reply_t, sm2_reply_free> reply_;
    const void* data_ = nullptr;
    std::size_t len_ = 0;
};

// A pending call, which is cancelled if it is destroyed before its result.
template <typename R>
class Call {
public:
    // Waits for the reply, until the deadline of the call. There is no further result then.
    Reply<R> wait() {
        Reply<R> reply;
        reply.take([&](sm2_reply_t** place) { return sm2_call_wait(call_.get(), place); });
        return reply;
    }

    // Returns the reply; an empty one if it has not arrived.
    Reply<R> try_wait() {
        Reply<R> reply;
        reply.take([&](sm2_reply_t** place) { return sm2_call_try_wait(call_.get(), place); });
        return reply;
    }

    // Cancels the call at its server.
    void cancel() { detail::check(sm2_call_cancel(call_.get())); }

    // The handle of the C library.
    const sm2_call_t* handle() const noexcept { return call_.get(); }

private:
    template <typename A, typename B>
    friend class Client;
    using Owner = detail::Handle<sm2_call_t, sm2_call_free>;

    explicit Call(Owner call) noexcept : call_(std::move(call)) {}

    Owner call_;
};

// Sends requests of the type Q to the servers of a service, and gets replies of the type R. Node::client() makes it.
template <typename Q, typename R>
class Client {
public:
    // Sends a request and waits for the reply. Throws SM2_DEADLINE_EXCEEDED after the time limit.
    Reply<R> call(typename Message<Q>::Argument request,
                  std::chrono::nanoseconds timeout = forever) const {
        Reply<R> reply;
        call_into(reply, request, timeout);
        return reply;
    }

    // As call(), with the handle of an earlier reply, which is released first: a loop allocates nothing.
    void call_into(Reply<R>& reply, typename Message<Q>::Argument request,
                   std::chrono::nanoseconds timeout = forever) const {
        const detail::Bytes bytes = Message<Q>::bytes(request);
        reply.take([&](sm2_reply_t** place) {
            return sm2_client_call(client_.get(), bytes.data, bytes.len,
                                   detail::nanoseconds(timeout), place);
        });
    }

    // Sends a request with a deadline. The returned call waits for the reply.
    Call<R> send(typename Message<Q>::Argument request,
                 std::chrono::nanoseconds timeout = forever) const {
        const detail::Bytes bytes = Message<Q>::bytes(request);
        return Call<R>(detail::make<typename Call<R>::Owner>([&](sm2_call_t** call) {
            return sm2_client_send(client_.get(), bytes.data, bytes.len,
                                   detail::nanoseconds(timeout), call);
        }));
    }

    // Waits until `count` servers are linked. Throws SM2_TIMED_OUT after the time limit.
    void wait_for_servers(std::size_t count, std::chrono::nanoseconds timeout = forever) const {
        detail::check(
            sm2_client_wait_for_servers(client_.get(), count, detail::nanoseconds(timeout)));
    }

    // Explains why there are no links; empty if no server comes close.
    std::string why() const {
        return detail::text([&](char** text) { return sm2_client_why(client_.get(), text); });
    }

    // Readable when a pending call may have a result.
    int descriptor() const { return detail::descriptor(client_, sm2_client_descriptor); }

private:
    friend class Node;
    using Owner = detail::Handle<sm2_client_t, sm2_client_free>;

    Client(const sm2_node_t* node, const std::string& service, const ClientOptions& options)
        : client_(detail::make<Owner>([&](sm2_client_t** client) {
              return sm2_client_new(node, service.c_str(), Message<Q>::type(), Message<R>::type(),
                                    &options, client);
          })) {}

    Owner client_;
};

}  // namespace sm2

#endif
