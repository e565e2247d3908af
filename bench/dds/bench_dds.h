/* The functions of a DDS implementation for sm2-bench.
 *
 * Each implementation is compiled into a library of its own on first use. Functions that can fail
 * return -1 (or NULL), and bench_error then returns the reason. A participant, its publishers and
 * its subscribers exist as long as the process. */
#ifndef BENCH_DDS_H
#define BENCH_DDS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Writes all bytes of a message. */
typedef void (*bench_write)(void *context, uint8_t *message, size_t len);
/* Handles a message; if the result is not 0, bench_pump returns. */
typedef int (*bench_read)(void *context, const uint8_t *message, size_t len);

typedef struct bench_participant bench_participant;
typedef struct bench_publisher bench_publisher;
typedef struct bench_subscriber bench_subscriber;

typedef struct bench_topic {
  const char *name;
  size_t max_len;
  /* The number of messages that a subscriber's queue holds. */
  uint32_t depth;
  /* Not 0 if nothing may be dropped. */
  int lossless;
} bench_topic;

/* The reason why the last call of this thread failed. */
const char *bench_error(void);
/* `mode` is the part of the peer's name after its first dash, or empty. */
bench_participant *bench_open(uint32_t domain, const char *mode);
bench_publisher *bench_publish_on(bench_participant *participant, const bench_topic *topic);
/* The number of connected subscribers. */
int bench_matched(bench_publisher *publisher);
int bench_publish(bench_publisher *publisher, size_t len, bench_write write, void *context);
bench_subscriber *bench_subscribe_to(bench_participant *participant, const bench_topic *topic);
/* Passes messages to `read`, until `read` returns another value than 0 or the timeout is over. */
int bench_pump(bench_subscriber *subscriber, uint64_t timeout_ns, bench_read read, void *context);

#ifdef __cplusplus
}
#endif

#endif
