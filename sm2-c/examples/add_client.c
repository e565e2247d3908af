/* Calls the service of add_server.c: one call that waits, one in a wait set, and one that fails. */
#include "check.h"

/* Reads the number in a reply. */
static int64_t sum_of(const sm2_reply_t *reply) {
    const void *data;
    size_t len;
    CHECK(sm2_reply_data(reply, &data, &len));
    if (len != sizeof(int64_t)) {
        fprintf(stderr, "a sum cannot have %zu bytes\n", len);
        exit(1);
    }
    return *(const int64_t *)data;
}

int main(void) {
    const int64_t numbers[] = {1, 2, 39};
    sm2_node_t *node;
    sm2_client_t *client;
    sm2_wait_set_t *set;
    sm2_call_t *call = NULL;
    sm2_reply_t *reply = NULL;

    CHECK(sm2_node_connect("calculator", NULL, &node));
    CHECK(sm2_client_new(node, "add", NULL, NULL, NULL, &client));
    CHECK(sm2_client_wait_for_servers(client, 1, 60 * SECOND_NS));

    CHECK(sm2_client_call(client, numbers, sizeof numbers, 60 * SECOND_NS, &reply));
    printf("waited: %lld\n", (long long)sum_of(reply));

    CHECK(sm2_wait_set_new(&set));
    CHECK(sm2_client_send(client, numbers, 2 * sizeof *numbers, 60 * SECOND_NS, &call));
    CHECK(sm2_wait_set_add_call(set, call, 7));
    sm2_ready_t ready = {.size = sizeof ready};
    CHECK(sm2_wait_set_wait(set, SM2_FOREVER, &ready));
    CHECK(sm2_call_try_wait(call, &reply));
    printf("source %llu: %lld\n", (unsigned long long)ready.tag, (long long)sum_of(reply));

    sm2_status_t status = sm2_client_call(client, "?", 1, 60 * SECOND_NS, &reply);
    printf("%s: %s\n", sm2_status_name(status), sm2_last_error());

    sm2_reply_free(reply);
    sm2_call_free(call);
    sm2_wait_set_free(set);
    sm2_client_free(client);
    sm2_node_free(node);
    return status == SM2_CALL_FAILED ? 0 : 1;
}
