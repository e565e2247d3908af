/* One end of a ping-pong with 64 bytes: pingpong ping|pong ROUNDS. The ping prints the median time of a round in ns. */
#include <string.h>

#include "../examples/check.h"

typedef struct end {
    sm2_node_t *node;
    sm2_publisher_t *publisher;
    sm2_subscriber_t *subscriber;
    sm2_sample_t *sample;
} end_t;

static int by_value(const void *a, const void *b) {
    uint64_t x = *(const uint64_t *)a;
    uint64_t y = *(const uint64_t *)b;
    return x < y ? -1 : x > y;
}

static void receive(end_t *end, unsigned char *to) {
    const void *data;
    size_t len;
    CHECK(sm2_subscriber_recv(end->subscriber, 60 * SECOND_NS, &end->sample));
    CHECK(sm2_sample_data(end->sample, &data, &len));
    memcpy(to, data, 64);
}

int main(int argc, char **argv) {
    if (argc != 3) {
        return 2;
    }
    int is_ping = strcmp(argv[1], "ping") == 0;
    size_t rounds = strtoul(argv[2], NULL, 10);
    uint64_t *times = calloc(rounds, sizeof *times);
    unsigned char bytes[64] = {0};
    end_t end = {NULL, NULL, NULL, NULL};
    if (times == NULL) {
        return 1;
    }

    CHECK(sm2_node_connect(argv[1], NULL, &end.node));
    CHECK(sm2_publisher_new(end.node, is_ping ? "ping" : "pong", NULL, NULL, &end.publisher));
    CHECK(sm2_subscriber_new(end.node, is_ping ? "pong" : "ping", NULL, NULL, &end.subscriber));
    CHECK(sm2_publisher_wait_for_subscribers(end.publisher, 1, 60 * SECOND_NS));
    CHECK(sm2_subscriber_wait_for_publishers(end.subscriber, 1, 60 * SECOND_NS));

    for (size_t round = 0; round < rounds; round++) {
        if (is_ping) {
            uint64_t start = sm2_now_ns();
            CHECK(sm2_publisher_publish(end.publisher, bytes, sizeof bytes, NULL));
            receive(&end, bytes);
            times[round] = sm2_now_ns() - start;
        } else {
            receive(&end, bytes);
            CHECK(sm2_publisher_publish(end.publisher, bytes, sizeof bytes, NULL));
        }
    }
    if (is_ping) {
        qsort(times, rounds, sizeof *times, by_value);
        printf("%llu\n", (unsigned long long)times[rounds / 2]);
    }
    CHECK(sm2_publisher_flush(end.publisher, 60 * SECOND_NS));
    free(times);
    sm2_sample_free(end.sample);
    sm2_subscriber_free(end.subscriber);
    sm2_publisher_free(end.publisher);
    sm2_node_free(end.node);
    return 0;
}
