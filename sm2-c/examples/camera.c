/* Publishes images that are written in the shared memory that subscribers read: camera [FRAMES] */
#include <string.h>

#include "check.h"

#define WIDTH 640
#define HEIGHT 480

int main(int argc, char **argv) {
    long frames = argc > 1 ? strtol(argv[1], NULL, 10) : 100;
    sm2_node_t *node;
    sm2_publisher_t *publisher;
    sm2_loan_t *loan = NULL;

    CHECK(sm2_node_connect("camera", NULL, &node));
    /* Subscribers that keep up get every frame, and the publisher does not run away from them. */
    sm2_publisher_options_t options = {.size = sizeof options};
    CHECK(sm2_publisher_options_init(&options));
    options.reliable = 1;
    options.wait_share_percent = 100;
    options.publish_timeout_ns = 60 * SECOND_NS;
    CHECK(sm2_publisher_new(node, "image", NULL, &options, &publisher));
    CHECK(sm2_publisher_wait_for_subscribers(publisher, 1, 60 * SECOND_NS));

    for (long frame = 0; frame < frames; frame++) {
        void *pixels;
        size_t len;
        CHECK(sm2_publisher_loan(publisher, WIDTH * HEIGHT, &loan));
        CHECK(sm2_loan_data(loan, &pixels, &len));
        memset(pixels, (int)(frame & 0xff), len);
        CHECK(sm2_loan_publish(loan, NULL));
    }
    CHECK(sm2_publisher_flush(publisher, 60 * SECOND_NS));

    sm2_loan_free(loan);
    sm2_publisher_free(publisher);
    sm2_node_free(node);
    return 0;
}
