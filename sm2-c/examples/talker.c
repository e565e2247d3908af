/* Publishes the pose of a robot ten times a second: talker [MESSAGES] */
#include "check.h"
#include "pose.h"

int main(int argc, char **argv) {
    long messages = argc > 1 ? strtol(argv[1], NULL, 10) : 10;
    sm2_node_t *node;
    sm2_publisher_t *publisher;
    sm2_wait_set_t *set;

    CHECK(sm2_node_connect("talker", NULL, &node));
    sm2_publisher_options_t options = {.size = sizeof options};
    CHECK(sm2_publisher_options_init(&options));
    options.reliable = 1;
    /* The listener gets every pose: the talker waits for it as long as this takes. */
    options.wait_share_percent = 100;
    options.publish_timeout_ns = 60 * SECOND_NS;
    CHECK(sm2_publisher_new(node, "pose", &POSE_TYPE, &options, &publisher));
    CHECK(sm2_publisher_wait_for_subscribers(publisher, 1, 60 * SECOND_NS));

    CHECK(sm2_wait_set_new(&set));
    CHECK(sm2_wait_set_add_timer_hz(set, 10, false, 1));
    for (long i = 0; i < messages; i++) {
        sm2_ready_t ready = {.size = sizeof ready};
        CHECK(sm2_wait_set_wait(set, SM2_FOREVER, &ready));
        pose_t pose = {.x = (double)i, .y = 0.5 * (double)i, .heading = 0.0};
        CHECK(sm2_publisher_publish(publisher, &pose, sizeof pose, NULL));
    }
    CHECK(sm2_publisher_flush(publisher, 60 * SECOND_NS));

    sm2_wait_set_free(set);
    sm2_publisher_free(publisher);
    sm2_node_free(node);
    return 0;
}
