/* Shows how errors are handled: a code to decide by, and a text for people. */
#include <string.h>

#include "check.h"
#include "pose.h"

static int failures = 0;

/* Prints the code and the text of a call, and notes if the code is another one than expected. */
static void expect(sm2_status_t status, sm2_status_t expected) {
    const char *text = status == SM2_OK ? "" : sm2_last_error();
    printf("%s: %s\n", sm2_status_name(status), text);
    if (status != expected) {
        fprintf(stderr, "expected %s\n", sm2_status_name(expected));
        failures++;
    }
}

int main(void) {
    sm2_node_t *node;
    sm2_node_t *second;
    sm2_publisher_t *publisher;
    sm2_subscriber_t *subscriber;
    sm2_sample_t *sample = NULL;
    sm2_loan_t *loan = NULL;

    /* A Manager that is not there. */
    sm2_node_options_t nowhere = {.size = sizeof nowhere};
    CHECK(sm2_node_options_init(&nowhere));
    nowhere.socket = "/nonexistent/sm2.sock";
    expect(sm2_node_connect("errors", &nowhere, &node), SM2_NO_MANAGER);
    if (node != NULL) {
        failures++;
    }
    CHECK(sm2_node_connect("errors", NULL, &node));
    expect(sm2_node_connect("errors", NULL, &second), SM2_NAME_TAKEN);
    expect(sm2_publisher_new(node, "a topic", NULL, NULL, &publisher), SM2_BAD_NAME);

    /* A topic has one type; the text shows both schemas. */
    const sm2_type_t other = {.size = sizeof other,
                              .name = "demo/Pose",
                              .schema = "plain:struct{x:f32,y:f32,}",
                              .hash = 0};
    CHECK(sm2_publisher_new(node, "errors/pose", &POSE_TYPE, NULL, &publisher));
    expect(sm2_subscriber_new(node, "errors/pose", &other, NULL, &subscriber), SM2_TYPE_MISMATCH);
    if (strstr(sm2_last_error(), POSE_TYPE.schema) == NULL ||
        strstr(sm2_last_error(), other.schema) == NULL) {
        fprintf(stderr, "both schemas expected\n");
        failures++;
    }

    /* Nothing is there. */
    CHECK(sm2_subscriber_new(node, "errors/pose", &POSE_TYPE, NULL, &subscriber));
    CHECK(sm2_publisher_wait_for_subscribers(publisher, 1, 60 * SECOND_NS));
    expect(sm2_subscriber_recv(subscriber, 0, &sample), SM2_TIMED_OUT);

    /* A loan is published once. */
    CHECK(sm2_publisher_loan(publisher, sizeof(pose_t), &loan));
    CHECK(sm2_loan_publish(loan, NULL));
    expect(sm2_loan_publish(loan, NULL), SM2_MISUSE);

    /* A program that keeps its samples gets no further ones. Copies of short messages do not count, but loans do. */
    sm2_sample_t *kept[5] = {NULL, NULL, NULL, NULL, NULL};
    for (int i = 0; i < 5; i++) {
        sm2_loan_free(loan);
        loan = NULL;
        CHECK(sm2_publisher_loan(publisher, sizeof(pose_t), &loan));
        CHECK(sm2_loan_publish(loan, NULL));
        if (i < 4) {
            CHECK(sm2_subscriber_recv(subscriber, 60 * SECOND_NS, &kept[i]));
        }
    }
    expect(sm2_subscriber_recv(subscriber, 60 * SECOND_NS, &kept[4]), SM2_BORROW_LIMIT);

    /* Handles are freed in any order: the samples still have their messages. */
    sm2_node_free(node);
    sm2_publisher_free(publisher);
    sm2_subscriber_free(subscriber);
    for (int i = 0; i < 4; i++) {
        sm2_sample_free(kept[i]);
    }
    sm2_loan_free(loan);
    return failures == 0 ? 0 : 1;
}
