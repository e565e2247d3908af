/* Prints the poses of talker.c: listener [MESSAGES] */
#include "check.h"
#include "pose.h"

int main(int argc, char **argv) {
    long messages = argc > 1 ? strtol(argv[1], NULL, 10) : 10;
    sm2_node_t *node;
    sm2_subscriber_t *subscriber;
    sm2_sample_t *sample = NULL;

    CHECK(sm2_node_connect("listener", NULL, &node));
    sm2_subscriber_options_t options = {.size = sizeof options};
    CHECK(sm2_subscriber_options_init(&options));
    options.reliable = 1;
    CHECK(sm2_subscriber_new(node, "pose", &POSE_TYPE, &options, &subscriber));

    for (long i = 0; i < messages; i++) {
        const void *data;
        size_t len;
        sm2_sample_info_t info = {.size = sizeof info};
        CHECK(sm2_subscriber_recv(subscriber, 60 * SECOND_NS, &sample));
        CHECK(sm2_sample_data(sample, &data, &len));
        CHECK(sm2_sample_info(sample, &info));
        /* A publisher declares the type, but its program may send any bytes. */
        if (len != sizeof(pose_t)) {
            fprintf(stderr, "a pose cannot have %zu bytes\n", len);
            return 1;
        }
        const pose_t *pose = data;
        printf("%.*s: %.1f %.1f\n", (int)info.publisher_len, info.publisher, pose->x, pose->y);
    }

    sm2_sample_free(sample);
    sm2_subscriber_free(subscriber);
    sm2_node_free(node);
    return 0;
}
