/* Receives the images of camera.c and reads them in place: viewer [FRAMES] */
#include "check.h"

int main(int argc, char **argv) {
    long frames = argc > 1 ? strtol(argv[1], NULL, 10) : 100;
    sm2_node_t *node;
    sm2_subscriber_t *subscriber;
    sm2_sample_t *sample = NULL;

    CHECK(sm2_node_connect("viewer", NULL, &node));
    sm2_subscriber_options_t options = {.size = sizeof options};
    CHECK(sm2_subscriber_options_init(&options));
    options.reliable = 1;
    CHECK(sm2_subscriber_new(node, "image", NULL, &options, &subscriber));

    for (long frame = 0; frame < frames; frame++) {
        const void *data;
        size_t len;
        /* Releases the image before, and waits for the next one. */
        CHECK(sm2_subscriber_recv(subscriber, 60 * SECOND_NS, &sample));
        CHECK(sm2_sample_data(sample, &data, &len));
        const unsigned char *pixels = data;
        for (size_t i = 0; i < len; i++) {
            if (pixels[i] != (unsigned char)(frame & 0xff)) {
                fprintf(stderr, "frame %ld: wrong pixel %zu\n", frame, i);
                return 1;
            }
        }
    }
    printf("%ld frames\n", frames);

    sm2_sample_free(sample);
    sm2_subscriber_free(subscriber);
    sm2_node_free(node);
    return 0;
}
