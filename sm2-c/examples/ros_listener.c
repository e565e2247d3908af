/* Prints the texts of ros_talker.c: ros_listener [MESSAGES] */
#include <string.h>

#include "ros_text.h"

int main(int argc, char **argv) {
    long messages = argc > 1 ? strtol(argv[1], NULL, 10) : 10;
    char *schema = text_schema();
    sm2_type_t type = {.size = sizeof type, .name = TEXT_NAME, .schema = schema};
    sm2_node_t *node;
    sm2_subscriber_t *subscriber;
    sm2_sample_t *sample = NULL;

    CHECK(sm2_node_connect("ros_listener", NULL, &node));
    sm2_subscriber_options_t options = {.size = sizeof options};
    CHECK(sm2_subscriber_options_init(&options));
    options.reliable = 1;
    CHECK(sm2_subscriber_new(node, "chatter", &type, &options, &subscriber));

    for (long i = 0; i < messages; i++) {
        const void *data;
        size_t len;
        CHECK(sm2_subscriber_recv(subscriber, 60 * SECOND_NS, &sample));
        CHECK(sm2_sample_data(sample, &data, &len));
        /* A publisher declares the type, but its program may send any bytes. */
        if (len <= TEXT_AT || memcmp(data, ENCAPSULATION, 4) != 0) {
            fprintf(stderr, "no text in little endian\n");
            return 1;
        }
        /* The text ends with its NUL, which is not printed. */
        printf("%.*s\n", (int)(len - TEXT_AT - 1), (const char *)data + TEXT_AT);
    }

    sm2_sample_free(sample);
    sm2_subscriber_free(subscriber);
    sm2_node_free(node);
    sm2_text_free(schema);
    return 0;
}
