/* Receives the poses of talker.c in an event loop of its own, until a signal or MESSAGES: poll_loop [MESSAGES] */
#define _POSIX_C_SOURCE 200809L
#include <errno.h>
#include <poll.h>
#include <signal.h>

#include "check.h"
#include "pose.h"

static sm2_shutdown_t *shutdown_handle;

/* The call is allowed in a signal handler. */
static void on_signal(int number) {
    (void)number;
    sm2_shutdown_request(shutdown_handle);
}

/* Takes all messages that are there. Returns their number. */
static long take_all(sm2_subscriber_t *subscriber, sm2_sample_t **sample) {
    long taken = 0;
    for (;;) {
        const void *data;
        size_t len;
        sm2_status_t status = sm2_subscriber_recv(subscriber, 0, sample);
        if (status == SM2_TIMED_OUT) {
            return taken;
        }
        CHECK(status);
        CHECK(sm2_sample_data(*sample, &data, &len));
        if (len == sizeof(pose_t)) {
            printf("%.1f\n", ((const pose_t *)data)->x);
            taken++;
        }
    }
}

int main(int argc, char **argv) {
    long messages = argc > 1 ? strtol(argv[1], NULL, 10) : 10;
    sm2_node_t *node;
    sm2_subscriber_t *subscriber;
    sm2_sample_t *sample = NULL;
    struct pollfd sources[2] = {{.fd = -1, .events = POLLIN, .revents = 0},
                                {.fd = -1, .events = POLLIN, .revents = 0}};

    CHECK(sm2_shutdown_new(&shutdown_handle));
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);

    CHECK(sm2_node_connect("poll-loop", NULL, &node));
    sm2_subscriber_options_t options = {.size = sizeof options};
    CHECK(sm2_subscriber_options_init(&options));
    options.reliable = 1;
    CHECK(sm2_subscriber_new(node, "pose", &POSE_TYPE, &options, &subscriber));
    CHECK(sm2_subscriber_descriptor(subscriber, &sources[0].fd));
    CHECK(sm2_shutdown_descriptor(shutdown_handle, &sources[1].fd));

    while (messages > 0 && !(sources[1].revents & POLLIN)) {
        if (poll(sources, 2, -1) < 0 && errno != EINTR) {
            perror("poll");
            return 1;
        }
        messages -= take_all(subscriber, &sample);
    }

    sm2_sample_free(sample);
    sm2_subscriber_free(subscriber);
    sm2_node_free(node);
    sm2_shutdown_free(shutdown_handle);
    return 0;
}
