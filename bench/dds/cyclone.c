/* Cyclone DDS: a sequence of bytes, reliable; subscribers wait with a waitset.
 *
 * Mode "tuned": larger datagrams and socket buffers, as its documentation advises for large
 * messages. */
#include "bench_dds.h"

#include <dds/dds.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

struct bench_participant {
  dds_entity_t entity;
};

struct bench_publisher {
  dds_entity_t writer;
  uint8_t *buffer;
};

struct bench_subscriber {
  dds_entity_t reader;
  dds_entity_t waitset;
};

/* The output of `idlc` for `struct Message { sequence<octet> data; };`. */
typedef struct {
  dds_sequence_t data;
} message;

static const uint32_t message_ops[] = {
    DDS_OP_ADR | DDS_OP_TYPE_SEQ | DDS_OP_SUBTYPE_1BY, offsetof(message, data), DDS_OP_RTS};

static const dds_topic_descriptor_t message_type = {
    .m_size = sizeof(message),
    .m_align = _Alignof(message),
    .m_flagset = 0,
    .m_nkeys = 0,
    .m_typename = "bench::Message",
    .m_keys = NULL,
    .m_nops = 2,
    .m_ops = message_ops,
    .m_meta = "",
};

/* The length of the shortest large message. */
#define LARGE (256 * 1024)

static _Thread_local char error[256];

static int failed(const char *action, dds_return_t code) {
  snprintf(error, sizeof error, "%s: %s", action, dds_strretcode(code));
  return -1;
}

const char *bench_error(void) { return error; }

/* Only the loopback interface, so that the traffic of a run does not leave the machine. */
#define INTERFACE                                                                                  \
  "<General><Interfaces><NetworkInterface name=\"lo\" multicast=\"true\"/></Interfaces>"
#define TUNED                                                                                      \
  "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize>"

bench_participant *bench_open(uint32_t domain, const char *mode) {
  int tuned = strcmp(mode, "tuned") == 0;
  char config[1024];
  snprintf(config, sizeof config, "<CycloneDDS><Domain id=\"any\">%s%s</General>%s</Domain></CycloneDDS>",
           INTERFACE, tuned ? TUNED : "",
           tuned ? "<Internal><SocketReceiveBufferSize max=\"10MB\"/></Internal>" : "");
  dds_entity_t entity = dds_create_domain(domain, config);
  if (entity < 0) {
    failed("configure the domain", entity);
    return NULL;
  }
  entity = dds_create_participant(domain, NULL, NULL);
  if (entity < 0) {
    failed("create a participant", entity);
    return NULL;
  }
  bench_participant *participant = malloc(sizeof *participant);
  participant->entity = entity;
  return participant;
}

/* Reliable. Large messages and lossless topics keep all: with keep-last, a writer that is faster
 * than its readers would replace messages before they are sent, and few would arrive. Small messages
 * are keep-last, so that writers do not wait for readers that come and go. */
static dds_qos_t *qos(const bench_topic *topic) {
  const int keep_all = topic->lossless || topic->max_len >= LARGE;
  const int32_t samples = topic->depth < 4 ? 4 : (int32_t)topic->depth;
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(20));
  dds_qset_history(qos, keep_all ? DDS_HISTORY_KEEP_ALL : DDS_HISTORY_KEEP_LAST, samples);
  dds_qset_resource_limits(qos, samples, DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
  return qos;
}

static dds_entity_t create_topic(bench_participant *participant, const bench_topic *topic) {
  return dds_create_topic(participant->entity, &message_type, topic->name, NULL, NULL);
}

bench_publisher *bench_publish_on(bench_participant *participant, const bench_topic *topic) {
  dds_entity_t type = create_topic(participant, topic);
  if (type < 0) {
    failed("create a topic", type);
    return NULL;
  }
  dds_qos_t *wanted = qos(topic);
  dds_entity_t writer = dds_create_writer(participant->entity, type, wanted, NULL);
  dds_delete_qos(wanted);
  if (writer < 0) {
    failed("create a writer", writer);
    return NULL;
  }
  bench_publisher *publisher = malloc(sizeof *publisher);
  publisher->writer = writer;
  publisher->buffer = malloc(topic->max_len);
  return publisher;
}

int bench_matched(bench_publisher *publisher) {
  dds_publication_matched_status_t status;
  dds_return_t code = dds_get_publication_matched_status(publisher->writer, &status);
  return code < 0 ? failed("look for subscribers", code) : (int)status.current_count;
}

int bench_publish(bench_publisher *publisher, size_t len, bench_write write, void *context) {
  write(context, publisher->buffer, len);
  message sample = {.data = {._maximum = (uint32_t)len,
                             ._length = (uint32_t)len,
                             ._buffer = publisher->buffer,
                             ._release = false}};
  dds_return_t code = dds_write(publisher->writer, &sample);
  return code < 0 ? failed("write", code) : 0;
}

bench_subscriber *bench_subscribe_to(bench_participant *participant, const bench_topic *topic) {
  dds_entity_t type = create_topic(participant, topic);
  if (type < 0) {
    failed("create a topic", type);
    return NULL;
  }
  dds_qos_t *wanted = qos(topic);
  dds_entity_t reader = dds_create_reader(participant->entity, type, wanted, NULL);
  dds_delete_qos(wanted);
  if (reader < 0) {
    failed("create a reader", reader);
    return NULL;
  }
  dds_entity_t waitset = dds_create_waitset(participant->entity);
  dds_return_t code = dds_set_status_mask(reader, DDS_DATA_AVAILABLE_STATUS);
  if (waitset > 0 && code >= 0)
    code = dds_waitset_attach(waitset, reader, reader);
  if (waitset < 0 || code < 0) {
    failed("create a waitset", waitset < 0 ? waitset : code);
    return NULL;
  }
  bench_subscriber *subscriber = malloc(sizeof *subscriber);
  subscriber->reader = reader;
  subscriber->waitset = waitset;
  return subscriber;
}

/* Takes one message without another copy; returns 1 if there is none. */
static int take(bench_subscriber *subscriber, bench_read read, void *context, int *done) {
  void *samples[1] = {NULL};
  dds_sample_info_t info[1];
  dds_return_t count = dds_take(subscriber->reader, samples, info, 1, 1);
  if (count < 0)
    return failed("take", count);
  if (count == 0)
    return 1;
  if (info[0].valid_data) {
    const message *sample = samples[0];
    *done = read(context, sample->data._buffer, sample->data._length);
  }
  dds_return_t code = dds_return_loan(subscriber->reader, samples, count);
  return code < 0 ? failed("return a loan", code) : 0;
}

int bench_pump(bench_subscriber *subscriber, uint64_t timeout_ns, bench_read read, void *context) {
  dds_time_t until = dds_time() + (dds_duration_t)timeout_ns;
  for (;;) {
    int done = 0;
    int taken = take(subscriber, read, context, &done);
    if (taken < 0)
      return -1;
    if (done)
      return 0;
    if (taken == 0)
      continue;
    dds_return_t woken = dds_waitset_wait_until(subscriber->waitset, NULL, 0, until);
    if (woken < 0)
      return failed("wait", woken);
    if (woken == 0)
      return 0;
  }
}
