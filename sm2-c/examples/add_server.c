/* Adds numbers for its clients: add_server [REQUESTS] */
#include "check.h"

int main(int argc, char **argv) {
    long requests = argc > 1 ? strtol(argv[1], NULL, 10) : 3;
    sm2_node_t *node;
    sm2_server_t *server;
    sm2_request_t *request = NULL;

    CHECK(sm2_node_connect("adder", NULL, &node));
    CHECK(sm2_server_new(node, "add", NULL, NULL, NULL, &server));

    for (long i = 0; i < requests; i++) {
        const void *data;
        size_t len;
        CHECK(sm2_server_recv(server, 60 * SECOND_NS, &request));
        CHECK(sm2_request_data(request, &data, &len));
        if (len == 0 || len % sizeof(int64_t) != 0) {
            CHECK(sm2_request_fail(request, "the request is not a list of 64-bit numbers"));
            continue;
        }
        const int64_t *numbers = data;
        int64_t sum = 0;
        for (size_t n = 0; n < len / sizeof(int64_t); n++) {
            sum += numbers[n];
        }
        CHECK(sm2_request_reply(request, &sum, sizeof sum));
    }

    sm2_request_free(request);
    sm2_server_free(server);
    sm2_node_free(node);
    return 0;
}
