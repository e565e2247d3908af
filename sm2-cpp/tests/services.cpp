// Services: calls that wait, calls in the background, failures.
#include <thread>
#include <vector>

#include "check.hpp"
#include "messages.hpp"

namespace {

using Numbers = double[];

void calls(const sm2::Node& node) {
    const auto server = node.server<Numbers, double>("services/sum");
    const auto client = node.client<Numbers, double>("services/sum");
    client.wait_for_servers(1, soon);
    server.wait_for_clients(1, soon);
    std::thread answers([&] {
        sm2::Request<Numbers, double> request;
        for (int i = 0; i < 3; i++) {
            CHECK(server.recv_into(request, soon));
            CHECK(request && request.client() == "services");
            CHECK(!request.is_cancelled());
            if ((*request).empty()) {
                request.fail("no numbers");
                CHECK(!request);
                error_of(SM2_MISUSE, [&] { request.reply(1.0); });
                continue;
            }
            double sum = 0.0;
            for (const double number : *request) {
                sum += number;
            }
            request.reply(sum);
        }
    });
    const std::vector<double> numbers{1.0, 2.0, 3.5};
    sm2::Reply<double> reply = client.call(numbers, soon);
    CHECK(reply && *reply == 6.5);
    CHECK(reply.server() == "services");
    const double two[] = {1.0, 1.0};
    client.call_into(reply, two, soon);
    CHECK(*reply == 2.0);
    const std::string text =
        error_of(SM2_CALL_FAILED, [&] { client.call_into(reply, sm2::span<const double>(), soon); });
    CHECK(has(text, "no numbers"));
    CHECK(!reply);
    answers.join();
}

void calls_in_the_background(const sm2::Node& node) {
    const auto server = node.server<robot::Vector, std::string>("services/name");
    const auto client = node.client<robot::Vector, std::string>("services/name");
    client.wait_for_servers(1, soon);
    sm2::Call<std::string> call = client.send(robot::Vector{1.0, 0.0, 0.0}, soon);
    CHECK(!call.try_wait());
    sm2::Request<robot::Vector, std::string> request = server.recv(soon);
    CHECK(request->x == 1.0);
    request.reply("forward");
    CHECK(*call.wait() == "forward");
    error_of(SM2_MISUSE, [&] { return call.wait(); });

    // A cancelled call, whose server is told.
    sm2::Call<std::string> cancelled = client.send(robot::Vector{}, soon);
    request = server.recv(soon);
    CHECK(request);
    cancelled.cancel();
    while (!request.is_cancelled()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    request.reply("late");
    // The reply or the cancellation comes first.
    try {
        CHECK(*cancelled.wait() == "late");
    } catch (const sm2::Error& error) {
        CHECK(error.code() == SM2_CANCELLED);
    }

    // A request that is dropped fails.
    sm2::Call<std::string> dropped = client.send(robot::Vector{}, soon);
    { CHECK(server.recv(soon)); }
    error_of(SM2_CALL_FAILED, [&] { return dropped.wait(); });
}

// A reply may be in the memory of its request, which is short or long.
void replies_in_the_memory_of_their_requests(const sm2::Node& node) {
    const auto server = node.server<Numbers, Numbers>("services/echo");
    const auto client = node.client<Numbers, Numbers>("services/echo");
    client.wait_for_servers(1, soon);
    for (const std::size_t count : {std::size_t{2}, std::size_t{13}, std::size_t{200}}) {
        const std::vector<double> numbers(count, 0.5);
        sm2::Call<Numbers> call = client.send(numbers, soon);
        sm2::Request<Numbers, Numbers> request = server.recv(soon);
        CHECK(request && reinterpret_cast<std::uintptr_t>((*request).data()) % 64 == 0);
        request.reply(*request);
        const sm2::Reply<Numbers> reply = call.wait();
        CHECK((*reply).size() == count && (*reply)[count - 1] == 0.5);
        CHECK(reinterpret_cast<std::uintptr_t>((*reply).data()) % 64 == 0);
    }
}

void without_a_server(const sm2::Node& node) {
    const auto client = node.client<double, double>("services/none");
    error_of(SM2_NO_SERVER, [&] { return client.call(1.0, soon); });
    error_of(SM2_TIMED_OUT, [&] { client.wait_for_servers(1, std::chrono::nanoseconds(0)); });
    CHECK(client.why().empty());
    // A service with other types is no server, and the text shows them.
    const auto server = node.server<float, float>("services/other");
    const std::string text = error_of(SM2_TYPE_MISMATCH, [&] {
        return node.client<double, float>("services/other");
    });
    CHECK(has(text, "plain:f32") && has(text, "plain:f64"));
}

}  // namespace

int main() {
    const sm2::Node node("services");
    calls(node);
    calls_in_the_background(node);
    replies_in_the_memory_of_their_requests(node);
    without_a_server(node);
    return 0;
}
