/* The rules of structs: programs that know fewer fields, or more, than the library. */
#include <string.h>

#include "../examples/check.h"

static int failures = 0;

#define EXPECT(condition)                                                                          \
    do {                                                                                           \
        if (!(condition)) {                                                                        \
            fprintf(stderr, "%s:%d: not so: %s\n", __FILE__, __LINE__, #condition);                \
            failures++;                                                                            \
        }                                                                                          \
    } while (0)

/* The struct of a later version. */
typedef struct later_options {
    sm2_subscriber_options_t known;
    uint64_t added;
} later_options_t;

static void sizes_are_checked(void) {
    sm2_subscriber_options_t options;
    memset(&options, 0, sizeof options);
    EXPECT(sm2_subscriber_options_init(NULL) == SM2_MISUSE);
    EXPECT(sm2_subscriber_options_init(&options) == SM2_MISUSE);
    EXPECT(strstr(sm2_last_error(), "sizeof(sm2_subscriber_options_t)") != NULL);
    options.size = SIZE_MAX;
    EXPECT(sm2_subscriber_options_init(&options) == SM2_MISUSE);
}

/* A program that was built with a header without the last fields. */
static void an_older_program_runs(sm2_node_t *node) {
    sm2_subscriber_options_t options;
    sm2_subscriber_t *subscriber;
    memset(&options, 0xff, sizeof options);
    options.size = offsetof(sm2_subscriber_options_t, max_borrowed);
    CHECK(sm2_subscriber_options_init(&options));
    EXPECT(options.depth == 8);
    EXPECT(options.max_borrowed == 0xffff && options.reserved == 0xff);
    options.depth = 3;
    CHECK(sm2_subscriber_new(node, "older", NULL, &options, &subscriber));
    sm2_subscriber_free(subscriber);
}

/* A program that was built with a header that has more fields. */
static void a_newer_program_runs_without_new_options(sm2_node_t *node) {
    later_options_t options;
    sm2_subscriber_t *subscriber;
    options.known.size = sizeof options;
    CHECK(sm2_subscriber_options_init(&options.known));
    EXPECT(options.added == 0);
    CHECK(sm2_subscriber_new(node, "newer", NULL, &options.known, &subscriber));
    sm2_subscriber_free(subscriber);
    options.added = 1;
    EXPECT(sm2_subscriber_new(node, "newer", NULL, &options.known, &subscriber) == SM2_MISUSE);
    EXPECT(strstr(sm2_last_error(), "update the library") != NULL);
    EXPECT(subscriber == NULL);
}

/* A call with a wrong place for its result does nothing. */
static void a_wrong_result_is_found_first(sm2_node_t *node) {
    sm2_publisher_t *publisher;
    sm2_publish_result_t result = {.size = 0};
    sm2_publisher_counters_t counters = {.size = sizeof counters};
    CHECK(sm2_publisher_new(node, "results", NULL, NULL, &publisher));
    EXPECT(sm2_publisher_publish(publisher, "x", 1, &result) == SM2_MISUSE);
    CHECK(sm2_publisher_counters(publisher, &counters));
    EXPECT(counters.unheard == 0);
    result.size = sizeof result;
    CHECK(sm2_publisher_publish(publisher, "x", 1, &result));
    EXPECT(result.links == 0 && result.missed == 0);
    CHECK(sm2_publisher_counters(publisher, &counters));
    EXPECT(counters.unheard == 1 && counters.offered == 0);
    sm2_publisher_free(publisher);
}

int main(void) {
    sm2_node_t *node;
    EXPECT(sm2_abi_version() == SM2_ABI_VERSION);
    CHECK(sm2_node_connect("structs", NULL, &node));
    sizes_are_checked();
    an_older_program_runs(node);
    a_newer_program_runs_without_new_options(node);
    a_wrong_result_is_found_first(node);
    sm2_node_free(node);
    return failures == 0 ? 0 : 1;
}
