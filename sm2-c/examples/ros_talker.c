/* Publishes texts of ROS 2, which programs in Rust and Python receive as std_msgs/msg/String: ros_talker [MESSAGES] */
#include <string.h>

#include "ros_text.h"

int main(int argc, char **argv) {
    long messages = argc > 1 ? strtol(argv[1], NULL, 10) : 10;
    char *schema = text_schema();
    sm2_type_t type = {.size = sizeof type, .name = TEXT_NAME, .schema = schema};
    sm2_node_t *node;
    sm2_publisher_t *publisher;

    CHECK(sm2_node_connect("ros_talker", NULL, &node));
    sm2_publisher_options_t options = {.size = sizeof options};
    CHECK(sm2_publisher_options_init(&options));
    options.reliable = 1;
    options.wait_share_percent = 100;
    options.publish_timeout_ns = 60 * SECOND_NS;
    CHECK(sm2_publisher_new(node, "chatter", &type, &options, &publisher));
    CHECK(sm2_publisher_wait_for_subscribers(publisher, 1, 60 * SECOND_NS));

    for (long i = 0; i < messages; i++) {
        unsigned char message[TEXT_AT + 40];
        uint32_t len = 1 + (uint32_t)snprintf((char *)message + TEXT_AT, 40, "hello %ld", i);
        memcpy(message, ENCAPSULATION, 4);
        for (int at = 0; at < 4; at++) {
            message[4 + at] = (unsigned char)(len >> (8 * at));
        }
        CHECK(sm2_publisher_publish(publisher, message, TEXT_AT + len, NULL));
    }
    CHECK(sm2_publisher_flush(publisher, 60 * SECOND_NS));

    sm2_publisher_free(publisher);
    sm2_node_free(node);
    sm2_text_free(schema);
    return 0;
}
