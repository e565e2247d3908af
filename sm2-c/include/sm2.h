#ifndef SM2_H
#define SM2_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/*
 SM2 nodes for programs in C.

 Calls. Every call that can fail returns `SM2_OK` or a code, and `sm2_last_error()` returns the text of the thread's
 last error. After an error the call has changed nothing, unless its description says otherwise. No call calls back.
 The library ends the program only if there is no memory for its own data.

 Handles. A handle is made by a call and freed by the `..._free` function of its type, in any order: a message stays
 valid after its subscriber, its node, its publisher and the Manager have ended. A handle that is freed must not be used
 any more. The functions check arguments for NULL, but they cannot check other pointers.

 Structs. The first field of each struct is its size. Set it before any call:
 `sm2_ready_t ready = {.size = sizeof ready}`. Structs grow at their end in later versions, and programs that were built
 before still run with them.

 Texts. The program passes texts in UTF-8 that end with NUL. The library copies what it keeps.

 Time. Times are in nanoseconds of `CLOCK_MONOTONIC`. A time limit of 0 does not wait, and `SM2_FOREVER` has no limit.

 Threads. Each function states in which threads it may be called. Where it says "at the same time", several threads may
 use one handle in parallel. In all other cases only one thread uses a handle at a time.
 */

/*
 The version of the ABI that this header describes. A program that was built with it runs with every library of the
 same version.
 */
#define SM2_ABI_VERSION 1

/*
 A time without limit, in nanoseconds: `UINT64_MAX`.
 */
#define SM2_FOREVER UINT64_MAX

/*
 A size that the library chooses: `UINT64_MAX`.
 */
#define SM2_AUTOMATIC UINT64_MAX

/*
 The result of a call: `SM2_OK`, or the kind of error. `sm2_last_error()` returns the error's text.

 The numbers never change. Later versions of the library may add codes, so a program treats a code that it does not
 know as it treats `SM2_UNKNOWN`.
 */
enum sm2_status_t
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  /*
   The call did what it was asked for.
   */
  SM2_OK = 0,
  /*
   The time limit has passed without a result: no message, no reply, too few links. For a call with the limit 0:
   nothing is there now.
   */
  SM2_TIMED_OUT = 1,
  /*
   The program requested a shutdown while the call waited: see `sm2_shutdown_request()`.
   */
  SM2_SHUTDOWN = 2,
  /*
   An argument is NULL, not UTF-8, out of its range, or a handle that is spent.
   */
  SM2_MISUSE = 3,
  /*
   The operating system refused: `sm2_last_errno()` returns its error number.
   */
  SM2_IO = 4,
  /*
   A bug of this library: a panic was caught. Free the handles of the call and do not use them further.
   */
  SM2_PANIC = 5,
  /*
   An error that has no code in this version of the library.
   */
  SM2_UNKNOWN = 6,
  /*
   The name of a node, topic, service, type or domain is not legal.
   */
  SM2_BAD_NAME = 10,
  /*
   A value of the quality of service is out of its range, or contradicts another one.
   */
  SM2_BAD_QOS = 11,
  /*
   A schema text is malformed.
   */
  SM2_BAD_SCHEMA = 12,
  /*
   The topic or service carries other types. The text shows both.
   */
  SM2_TYPE_MISMATCH = 13,
  /*
   The domain has no Manager, or the Manager did not answer in time.
   */
  SM2_NO_MANAGER = 14,
  /*
   Another node of the domain has this name.
   */
  SM2_NAME_TAKEN = 15,
  /*
   The Manager refused the request: its access policy, its version or another rule.
   */
  SM2_REFUSED = 16,
  /*
   A quota of the Manager is used up.
   */
  SM2_QUOTA = 17,
  /*
   The message is longer than the protocol or its receiver allows.
   */
  SM2_TOO_LONG = 20,
  /*
   All memory of the publisher holds messages that subscribers have not released.
   */
  SM2_POOL_FULL = 21,
  /*
   Reliable subscribers missed the message.
   */
  SM2_MISSED = 22,
  /*
   The program holds as many messages, replies or calls as `max_borrowed` allows.
   */
  SM2_BORROW_LIMIT = 23,
  /*
   A message of another node could not be mapped, or is not of its declared type.
   */
  SM2_UNREADABLE = 24,
  /*
   No server of the service is linked.
   */
  SM2_NO_SERVER = 30,
  /*
   The server ended before it replied.
   */
  SM2_SERVER_GONE = 31,
  /*
   The deadline of the call has passed.
   */
  SM2_DEADLINE_EXCEEDED = 32,
  /*
   The program cancelled the call.
   */
  SM2_CANCELLED = 33,
  /*
   The server answered that the request failed. The text has its reason.
   */
  SM2_CALL_FAILED = 34,
  /*
   The client of the request is gone.
   */
  SM2_CLIENT_GONE = 35,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum sm2_status_t sm2_status_t;
#else
typedef int32_t sm2_status_t;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

/*
 A pending call: see `sm2_client_send()`.
 */
typedef struct sm2_call_t sm2_call_t;

/*
 Calls a service: see `sm2_client_new()`.
 */
typedef struct sm2_client_t sm2_client_t;

/*
 A message that is written in the memory that its subscribers read: see `sm2_publisher_loan()`.
 */
typedef struct sm2_loan_t sm2_loan_t;

/*
 A node of a domain: see `sm2_node_connect()`.
 */
typedef struct sm2_node_t sm2_node_t;

/*
 Sends the messages of a topic: see `sm2_publisher_new()`.
 */
typedef struct sm2_publisher_t sm2_publisher_t;

/*
 A reply: see `sm2_client_call()`.
 */
typedef struct sm2_reply_t sm2_reply_t;

/*
 A request, whose client waits for an answer: see `sm2_server_recv()`.
 */
typedef struct sm2_request_t sm2_request_t;

/*
 A received message: see `sm2_subscriber_recv()`.
 */
typedef struct sm2_sample_t sm2_sample_t;

/*
 Answers the calls of a service: see `sm2_server_new()`.
 */
typedef struct sm2_server_t sm2_server_t;

/*
 A handle that ends all waits of a program: see `sm2_shutdown_request()`.
 */
typedef struct sm2_shutdown_t sm2_shutdown_t;

/*
 Receives the messages of a topic: see `sm2_subscriber_new()`.
 */
typedef struct sm2_subscriber_t sm2_subscriber_t;

/*
 Waits for any of many sources: see `sm2_wait_set_new()`.
 */
typedef struct sm2_wait_set_t sm2_wait_set_t;

/*
 The type of a topic's messages, of requests or of replies. Two programs can communicate if name and schema are the
 same in both. A call that takes a type takes NULL for raw bytes.
 */
typedef struct sm2_type_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   The name, such as `sensor/Imu`: segments of `A-Z a-z 0-9 _ -`, joined by single `/`.
   */
  const char *name;
  /*
   The schema text, such as `plain:struct{stamp_ns:u64,gyro:array[f64;0000000000000003],}`: Annex A of SPEC.md
   defines it. Tools decode messages with it. NULL if only the hash is known.
   */
  const char *schema;
  /*
   The hash of the schema. Used only if `schema` is NULL.
   */
  uint64_t hash;
} sm2_type_t;

/*
 The options of a client. `sm2_client_options_init()` sets the defaults.
 */
typedef struct sm2_client_options_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   How long a thread that waits polls before it sleeps, in nanoseconds; 0 by default. `SM2_FOREVER`: it never
   sleeps.
   */
  uint64_t spin_ns;
  /*
   The longest reply that is accepted, in bytes; 1 GiB by default.
   */
  uint64_t max_len;
  /*
   Requests of up to this length are copied into datagrams, on links without a ring; 4,096 bytes by default.
   */
  uint32_t inline_max;
  /*
   How many pending calls and replies of each server the program may hold: 1 to 1,024; 64 by default. Short replies
   do not count, as for samples.
   */
  uint16_t max_borrowed;
  /*
   Whether every request and reply is sealed; 0 by default.
   */
  uint8_t sealed;
  /*
   Reserved: 0.
   */
  uint8_t reserved;
} sm2_client_options_t;

/*
 The result of one publication.
 */
typedef struct sm2_publish_result_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   How many subscribers accepted the message.
   */
  uint64_t links;
  /*
   How many reliable subscribers miss this message, because they had no room in time or do not accept its length.
   */
  uint64_t missed;
  /*
   How many subscribers miss this message because it is longer than their `max_len`.
   */
  uint64_t too_long;
} sm2_publish_result_t;

/*
 How a node connects. `sm2_node_options_init()` sets the defaults.
 */
typedef struct sm2_node_options_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   The domain; NULL, the default, for that of the environment (`SM2_SOCKET`, `SM2_DOMAIN`).
   */
  const char *domain;
  /*
   The path of the Manager's socket, in place of a domain; NULL by default.
   */
  const char *socket;
  /*
   A handle that ends every wait of the node; NULL by default. The node keeps what it needs of it.
   */
  const struct sm2_shutdown_t *shutdown;
  /*
   How long the Manager may take for each answer, in nanoseconds; 5 s by default.
   */
  uint64_t manager_timeout_ns;
  /*
   How long `sm2_node_connect()` waits for a Manager to start, in nanoseconds; 0, no waiting, by default.
   */
  uint64_t startup_timeout_ns;
  /*
   How many bytes the node maps of the memory of other nodes; 1 TiB by default.
   */
  uint64_t max_mapped_bytes;
  /*
   Whether a thread of the node does its control work: 1 yes, 0 no. -1, the default, for yes unless the environment
   has `SM2_BACKGROUND=off`. Without the thread, the program must call the node regularly.
   */
  int8_t background;
  /*
   Whether links may use rings in shared memory: 1 yes, 0 no. -1, the default, for yes unless the environment has
   `SM2_RING_LANE=off`.
   */
  int8_t ring_lane;
  /*
   Whether this process runs a Manager on a thread of its own if the domain has none, and otherwise stands by to
   take over: 1 yes, 0 no. 0 by default.
   */
  uint8_t embed_manager;
  /*
   Reserved: 0.
   */
  uint8_t reserved[5];
} sm2_node_options_t;

/*
 The quality of service of a publisher, and its memory. `sm2_publisher_options_init()` sets the defaults. Fields that
 are true or false have the values 1 and 0.
 */
typedef struct sm2_publisher_options_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   How long a publication waits for reliable subscribers without room, in nanoseconds; 100 ms by default. With 0 it
   never waits.
   */
  uint64_t publish_timeout_ns;
  /*
   Promises a message at least once in each such period, in nanoseconds; 0, no promise, by default.
   */
  uint64_t deadline_ns;
  /*
   Promises a sign of life within each such lease, in nanoseconds; 0, no promise, by default.
   */
  uint64_t liveliness_ns;
  /*
   The age that ends the delivery of messages, in nanoseconds; 0, none, by default.
   */
  uint64_t lifespan_ns;
  /*
   How long unused memory is kept, in nanoseconds; 5 s by default.
   */
  uint64_t keep_idle_ns;
  /*
   The most memory for messages, in bytes, besides reserved memory; `SM2_AUTOMATIC` by default.
   */
  uint64_t pool_limit_bytes;
  /*
   Reserves memory for messages of up to this length, in bytes; 0, no reservation, by default.
   */
  uint64_t max_len;
  /*
   For how many messages `max_len` reserves memory; 0, by default, for `depth + latched + 4`.
   */
  uint32_t slots;
  /*
   Messages of up to this length are copied into datagrams, on links without a ring; 4,096 bytes by default.
   */
  uint32_t inline_max;
  /*
   How many messages wait for each subscriber: 1 to 1,024; 8 by default.
   */
  uint16_t depth;
  /*
   How many messages new subscribers get first: 0 to 1,024; 0 by default.
   */
  uint16_t latched;
  /*
   Whether reliable delivery is offered; 0 by default.
   */
  uint8_t reliable;
  /*
   Whether every message is sealed, so that no process can change it; 0 by default.
   */
  uint8_t sealed;
  /*
   Whether reserved memory is made present at once; 0 by default.
   */
  uint8_t prefault;
  /*
   Whether reserved memory is locked; 0 by default.
   */
  uint8_t mlock;
  /*
   The share of the time that publications may wait for reliable subscribers, in per cent; 1 by default.
   */
  uint8_t wait_share_percent;
  /*
   Reserved: 0.
   */
  uint8_t reserved[7];
} sm2_publisher_options_t;

/*
 The fates of the messages of a publisher, summed over all current and past links: `offered = delivered + overwritten
 + discarded + no_room + closed + pool_limit + too_long + expired + in_flight`.
 */
typedef struct sm2_publisher_counters_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   Messages that were published while no subscriber was linked.
   */
  uint64_t unheard;
  /*
   Messages offered to a link.
   */
  uint64_t offered;
  /*
   Messages that the subscriber took and released.
   */
  uint64_t delivered;
  /*
   Messages that wait or are not released yet.
   */
  uint64_t in_flight;
  /*
   Messages that a newer one displaced before they were sent.
   */
  uint64_t overwritten;
  /*
   Messages that a newer one displaced at the subscriber, or that it dropped.
   */
  uint64_t discarded;
  /*
   Messages that a reliable subscriber had no room for in time.
   */
  uint64_t no_room;
  /*
   Messages that were lost with their link.
   */
  uint64_t closed;
  /*
   Messages that were not sent because the subscriber holds too much memory.
   */
  uint64_t pool_limit;
  /*
   Messages longer than the subscriber accepts.
   */
  uint64_t too_long;
  /*
   Messages older than their lifespan.
   */
  uint64_t expired;
  /*
   Periods of the deadline that passed without a message.
   */
  uint64_t missed_deadlines;
  /*
   How often the publisher stopped being alive.
   */
  uint64_t lost_liveliness;
  /*
   How long publications waited for reliable subscribers, in nanoseconds.
   */
  uint64_t waited_ns;
  /*
   The shared memory of the messages, in bytes.
   */
  uint64_t pool_bytes;
  /*
   The open links.
   */
  uint64_t links;
} sm2_publisher_counters_t;

/*
 The quality of service of a subscriber. `sm2_subscriber_options_init()` sets the defaults.
 */
typedef struct sm2_subscriber_options_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   Demands a message of each publisher at least once in each such period, in nanoseconds; 0, no demand, by default.
   */
  uint64_t deadline_ns;
  /*
   Demands a sign of life of each publisher within each such lease, in nanoseconds; 0, no demand, by default.
   */
  uint64_t liveliness_ns;
  /*
   How long a thread that waits polls before it sleeps, in nanoseconds; 0 by default. `SM2_FOREVER`: it never
   sleeps.
   */
  uint64_t spin_ns;
  /*
   The longest message that is accepted, in bytes; 1 GiB by default.
   */
  uint64_t max_len;
  /*
   How many messages of each publisher wait to be taken: 1 to 1,024; 8 by default.
   */
  uint16_t depth;
  /*
   How many samples of each publisher the program may hold: 1 to 1,024; 4 by default. Samples of up to 104
   bytes usually are copies, which do not count.
   */
  uint16_t max_borrowed;
  /*
   Whether reliable delivery is requested; 0 by default.
   */
  uint8_t reliable;
  /*
   Whether only sealed messages are accepted; 0 by default.
   */
  uint8_t sealed;
  /*
   Whether messages of every type are accepted: see `sm2_sample_info()`. 0 by default.
   */
  uint8_t any_type;
  /*
   Reserved: 0.
   */
  uint8_t reserved;
} sm2_subscriber_options_t;

/*
 The options of a server. `sm2_server_options_init()` sets the defaults.
 */
typedef struct sm2_server_options_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   How long a thread that waits polls before it sleeps, in nanoseconds; 0 by default. `SM2_FOREVER`: it never
   sleeps.
   */
  uint64_t spin_ns;
  /*
   The longest request that is accepted, in bytes; 1 GiB by default.
   */
  uint64_t max_len;
  /*
   Replies of up to this length are copied into datagrams, on links without a ring; 4,096 bytes by default.
   */
  uint32_t inline_max;
  /*
   How many requests of each client wait: 1 to 1,024; 64 by default.
   */
  uint16_t depth;
  /*
   How many requests of each client the program may hold: 1 to 1,024; 16 by default. Short ones do not count, as
   for samples.
   */
  uint16_t max_borrowed;
  /*
   Whether every request and reply is sealed; 0 by default.
   */
  uint8_t sealed;
  /*
   Reserved: 0.
   */
  uint8_t reserved[7];
} sm2_server_options_t;

/*
 Number, time, type and publisher of a message.
 */
typedef struct sm2_sample_info_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   The number of the publication, from 1.
   */
  uint64_t sequence;
  /*
   The time of publication, in nanoseconds of `CLOCK_MONOTONIC`.
   */
  uint64_t source_time_ns;
  /*
   How many messages of this publisher were lost since the sample before.
   */
  uint64_t lost;
  /*
   The hash of the type that the publisher declared; 0 for raw bytes.
   */
  uint64_t type_hash;
  /*
   The name of the type that the publisher declared; `bytes` for raw bytes. Has no NUL at its end, and is valid as
   long as the sample holds this message.
   */
  const char *type_name;
  /*
   The length of `type_name`.
   */
  size_t type_name_len;
  /*
   The name of the publisher's node, of the same kind as `type_name`.
   */
  const char *publisher;
  /*
   The length of `publisher`.
   */
  size_t publisher_len;
} sm2_sample_info_t;

/*
 Deadline and client of a request.
 */
typedef struct sm2_request_info_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   The time after which the client does not want the reply any more, in nanoseconds of `CLOCK_MONOTONIC`; 0 for
   none.
   */
  uint64_t deadline_ns;
  /*
   The name of the client's node. Has no NUL at its end, and is valid until the request is answered.
   */
  const char *client;
  /*
   The length of `client`.
   */
  size_t client_len;
} sm2_request_info_t;

/*
 The counters of a subscriber, summed over all publishers.
 */
typedef struct sm2_subscriber_counters_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   Messages that were lost. A loss counts once the next message of its publisher is taken.
   */
  uint64_t lost;
  /*
   Periods of the deadline that passed without a message.
   */
  uint64_t missed_deadlines;
  /*
   How often publishers stopped being alive.
   */
  uint64_t lost_liveliness;
  /*
   The open links.
   */
  uint64_t links;
} sm2_subscriber_counters_t;

/*
 A source of a wait set that is ready: see `sm2_wait_set_wait()`.
 */
typedef struct sm2_ready_t {
  /*
   The size of this struct, in bytes.
   */
  size_t size;
  /*
   The tag that was added with the source.
   */
  uint64_t tag;
  /*
   The number of a timer's tick, from 1; 0 for all other sources.
   */
  uint64_t tick;
  /*
   The time when the tick was due, in nanoseconds of `CLOCK_MONOTONIC`.
   */
  uint64_t tick_due_ns;
  /*
   How many earlier ticks were skipped.
   */
  uint64_t ticks_missed;
  /*
   Whether reading a descriptor of the program does not block: 1 or 0.
   */
  uint8_t readable;
  /*
   Whether writing a descriptor of the program does not block: 1 or 0.
   */
  uint8_t writable;
  /*
   Reserved: 0.
   */
  uint8_t reserved[6];
} sm2_ready_t;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 Returns the version of the library's ABI, to be compared with `SM2_ABI_VERSION`.

 Threads: any.
 */
uint32_t sm2_abi_version(void);

/*
 Returns the version of the library, such as `0.1.0`. The text is valid forever.

 Threads: any.
 */
const char *sm2_version(void);

/*
 Declares a client. `request` and `reply` are the types of requests and replies, both NULL for raw bytes. `options`
 is NULL for the defaults.

 Errors: `SM2_TYPE_MISMATCH`, `SM2_BAD_NAME`, `SM2_BAD_SCHEMA`, `SM2_BAD_QOS`, `SM2_NO_MANAGER`, `SM2_REFUSED`,
 `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_client_new(const struct sm2_node_t *node,
                            const char *service,
                            const struct sm2_type_t *request,
                            const struct sm2_type_t *reply,
                            const struct sm2_client_options_t *options,
                            struct sm2_client_t **client);

/*
 Frees a client; NULL is ignored. Its pending calls and replies keep it declared until they are freed.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_client_free(struct sm2_client_t *client);

/*
 Waits until at least `count` servers are linked, for at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).

 Errors: `SM2_TIMED_OUT`, `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_client_wait_for_servers(const struct sm2_client_t *client,
                                         size_t count,
                                         uint64_t timeout_ns);

/*
 Sends the `len` bytes at `data` to a server, and waits for the reply for at most `timeout_ns` nanoseconds
 (`SM2_FOREVER`: no limit). The server learns the deadline. If it ends, the call fails at once.

 `*reply` is NULL, or a reply of an earlier call, which is released first; the handle is used again.

 Errors: `SM2_NO_SERVER`, `SM2_SERVER_GONE`, `SM2_DEADLINE_EXCEEDED`, `SM2_CALL_FAILED`, `SM2_BORROW_LIMIT`,
 `SM2_TOO_LONG`, `SM2_POOL_FULL`, `SM2_UNREADABLE`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time with other replies.
 */
sm2_status_t sm2_client_call(const struct sm2_client_t *client,
                             const void *data,
                             size_t len,
                             uint64_t timeout_ns,
                             struct sm2_reply_t **reply);

/*
 Sends the `len` bytes at `data` to a server, with a deadline of `timeout_ns` nanoseconds from now (`SM2_FOREVER`:
 none). The reply is fetched with `sm2_call_wait()` or `sm2_call_try_wait()`, or with a wait set.

 Returns at once, except while the link to the first server is being opened. `*call` is NULL, or an earlier call,
 which is cancelled if it is pending; the handle is used again.

 Errors: `SM2_NO_SERVER`, `SM2_DEADLINE_EXCEEDED`, `SM2_BORROW_LIMIT`, `SM2_TOO_LONG`, `SM2_POOL_FULL`,
 `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time with other calls.
 */
sm2_status_t sm2_client_send(const struct sm2_client_t *client,
                             const void *data,
                             size_t len,
                             uint64_t timeout_ns,
                             struct sm2_call_t **call);

/*
 Stores a descriptor in `fd` that is readable when `sm2_call_try_wait()` of a pending call may have a result. The
 client keeps the descriptor; do not close it.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_client_descriptor(const struct sm2_client_t *client,
                                   int *fd);

/*
 Explains why the client has no links: stores a text in `text`, with a line for each server that comes close. The
 text is empty if there is none. Free it with `sm2_text_free()`.

 Errors: `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_client_why(const struct sm2_client_t *client,
                            char **text);

/*
 Waits for the reply of a call, until its deadline if it has one. The call is spent then, also after an error.

 `*reply` is NULL, or a reply of an earlier call, which is released first; the handle is used again.

 Errors: those of `sm2_client_call()`, and `SM2_CANCELLED`; `SM2_MISUSE` also if the call is spent.

 Threads: one at a time for each call, and for each reply.
 */
sm2_status_t sm2_call_wait(struct sm2_call_t *call,
                           struct sm2_reply_t **reply);

/*
 Stores the reply of a call if it has arrived, and does not wait: `SM2_TIMED_OUT` if the call is still pending. The
 call is spent after a reply and after every other error.

 Errors: those of `sm2_call_wait()`, and `SM2_TIMED_OUT`.

 Threads: one at a time for each call, and for each reply.
 */
sm2_status_t sm2_call_try_wait(struct sm2_call_t *call,
                               struct sm2_reply_t **reply);

/*
 Cancels a call at its server. Waiting for it then ends with `SM2_CANCELLED`, or with the reply if that arrives
 first.

 Errors: `SM2_MISUSE`, also if the call is spent.

 Threads: one at a time for each call.
 */
sm2_status_t sm2_call_cancel(const struct sm2_call_t *call);

/*
 Frees a call, which is cancelled if it is pending; NULL is ignored.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_call_free(struct sm2_call_t *call);

/*
 Stores the bytes of a reply in `data`, and their number in `len`. They are aligned to 64 bytes, and do not change
 until the reply is freed or used again.

 Errors: `SM2_MISUSE`, also if the reply is empty.

 Threads: any, at the same time.
 */
sm2_status_t sm2_reply_data(const struct sm2_reply_t *reply,
                            const void **data,
                            size_t *len);

/*
 Stores the name of the server's node in `server`, and its length in `len`. The text has no NUL at its end, and is
 valid as long as the reply.

 Errors: `SM2_MISUSE`, also if the reply is empty.

 Threads: any, at the same time.
 */
sm2_status_t sm2_reply_server(const struct sm2_reply_t *reply,
                              const char **server,
                              size_t *len);

/*
 Frees a reply; NULL is ignored.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_reply_free(struct sm2_reply_t *reply);

/*
 Allocates memory for one message of `len` bytes, which the program writes in place. The memory is aligned to 64
 bytes. Its content is unspecified: zeroes, or the bytes of an earlier message.

 `*loan` is NULL, or a loan of an earlier call. In the second case its memory is given back first, and the handle is
 used again, so that a loop does not allocate. After an error it stays spent.

 Errors: `SM2_TOO_LONG`, `SM2_POOL_FULL`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time with other loans.
 */
sm2_status_t sm2_publisher_loan(const struct sm2_publisher_t *publisher,
                                size_t len,
                                struct sm2_loan_t **loan);

/*
 Stores the memory of a loan in `data`, and its length in `len` (which may be NULL). The program may write to the
 memory until the loan is published or freed.

 Errors: `SM2_MISUSE`, also if the loan is spent.

 Threads: one at a time for each loan.
 */
sm2_status_t sm2_loan_data(struct sm2_loan_t *loan,
                           void **data,
                           size_t *len);

/*
 Sends the message of a loan to all subscribers without a copy. The loan is spent then, also after an error: its
 memory is not the program's any more. `result` may be NULL. The handle must still be freed, or used again.

 Waits as `sm2_publisher_publish()` does.

 Errors: `SM2_SHUTDOWN`, `SM2_IO`, `SM2_POOL_FULL`, `SM2_MISUSE`, also if the loan is spent.

 Threads: one at a time for each loan; not necessarily the one that took the loan.
 */
sm2_status_t sm2_loan_publish(struct sm2_loan_t *loan,
                              struct sm2_publish_result_t *result);

/*
 Frees a loan, and gives back its memory if it was not published; NULL is ignored.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_loan_free(struct sm2_loan_t *loan);

/*
 Writes the library's log to the standard error, from now on and in all threads: the reasons why links and sessions
 ended, and what SM2 does. Without this call there is no log. `level` is 1 for errors, 2 for warnings as well, 3 for
 information, 4 and 5 for details.

 Errors: `SM2_MISUSE` for another level, and for a second call.

 Threads: any.
 */
sm2_status_t sm2_log_to_stderr(uint32_t level);

/*
 Sets the default options. `options->size` must be set before, as for every struct.

 Threads: any.
 */
sm2_status_t sm2_node_options_init(struct sm2_node_options_t *options);

/*
 Connects a node to the Manager of its domain. The name must be unique in the domain. `options` may be NULL for the
 defaults.

 Messages flow on when the Manager ends; the node connects to the next one by itself. A child of `fork()` must not
 use the node, but may free its copies of all handles.

 Errors: `SM2_NO_MANAGER`, `SM2_NAME_TAKEN`, `SM2_BAD_NAME`, `SM2_REFUSED`, `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`,
 `SM2_MISUSE`.

 Threads: any. The node's background thread inherits the scheduling policy and the affinity of the calling thread.
 */
sm2_status_t sm2_node_connect(const char *name,
                              const struct sm2_node_options_t *options,
                              struct sm2_node_t **node);

/*
 Frees a handle of a node; NULL is ignored. The node ends with its last publisher, subscriber, server, client and
 message.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_node_free(struct sm2_node_t *node);

/*
 Waits until the node has a session with a Manager that has answered all declarations of the node, for at most
 `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).

 Errors: `SM2_NO_MANAGER` after the time limit, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_node_wait_connected(const struct sm2_node_t *node,
                                     uint64_t timeout_ns);

/*
 Drives a node without a background thread as far as possible, without waiting. Call it when the node's descriptor is
 readable. A node with a background thread needs no such call.

 Errors: `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_node_spin_some(const struct sm2_node_t *node);

/*
 Stores the node's descriptor in `fd`: it is readable when a node without a background thread has work to do. The
 node keeps the descriptor; do not close it.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_node_descriptor(const struct sm2_node_t *node,
                                 int *fd);

/*
 Returns the monotonic time that samples and ticks are stamped with, in nanoseconds (`CLOCK_MONOTONIC`).

 Threads: any.
 */
uint64_t sm2_now_ns(void);

/*
 Declares a publisher. `type` is NULL for raw bytes, and `options` for the defaults.

 Errors: `SM2_TYPE_MISMATCH`, `SM2_BAD_NAME`, `SM2_BAD_SCHEMA`, `SM2_BAD_QOS`, `SM2_NO_MANAGER`, `SM2_REFUSED`,
 `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_publisher_new(const struct sm2_node_t *node,
                               const char *topic,
                               const struct sm2_type_t *type,
                               const struct sm2_publisher_options_t *options,
                               struct sm2_publisher_t **publisher);

/*
 Frees a publisher; NULL is ignored. The publisher is withdrawn when its last loan is freed as well.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_publisher_free(struct sm2_publisher_t *publisher);

/*
 Sends the `len` bytes at `data` to all subscribers: one copy into shared memory. `result` may be NULL. A reliable
 subscriber that misses the message is not an error, because all others have it: see `sm2_publish_result_t`.

 Waits only for reliable subscribers without room, for at most the option `publish_timeout_ns`.

 Errors: `SM2_TOO_LONG`, `SM2_POOL_FULL`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time; each subscriber gets the messages of one thread in order.
 */
sm2_status_t sm2_publisher_publish(const struct sm2_publisher_t *publisher,
                                   const void *data,
                                   size_t len,
                                   struct sm2_publish_result_t *result);

/*
 Sends the `len` bytes at `data` to all subscribers, or to none: `SM2_TIMED_OUT` if `sm2_publisher_publish()` would
 wait for a reliable subscriber. `result` may be NULL.

 Errors: as `sm2_publisher_publish()`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_publisher_try_publish(const struct sm2_publisher_t *publisher,
                                       const void *data,
                                       size_t len,
                                       struct sm2_publish_result_t *result);

/*
 Waits until no message waits in the publisher: reliable subscribers have released all messages, and all others were
 sent theirs. For at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).

 Errors: `SM2_TIMED_OUT`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_publisher_flush(const struct sm2_publisher_t *publisher,
                                 uint64_t timeout_ns);

/*
 Waits until at least `count` subscribers are linked, for at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).

 Errors: `SM2_TIMED_OUT`, `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_publisher_wait_for_subscribers(const struct sm2_publisher_t *publisher,
                                                size_t count,
                                                uint64_t timeout_ns);

/*
 Asserts that the program is alive, as each publication does: for a publisher with the option `liveliness_ns` that
 has nothing to publish.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_publisher_assert_liveliness(const struct sm2_publisher_t *publisher);

/*
 Fills `counters`: the fates of all messages.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_publisher_counters(const struct sm2_publisher_t *publisher,
                                    struct sm2_publisher_counters_t *counters);

/*
 Explains why the publisher has no links: stores a text in `text`, with a line for each subscriber that comes close.
 The text is empty if there is none. Free it with `sm2_text_free()`.

 Errors: `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_publisher_why(const struct sm2_publisher_t *publisher,
                               char **text);

/*
 Stores a descriptor in `fd` that is readable when a reliable subscriber may have room again, or a link has changed.
 The publisher keeps the descriptor; do not close it.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_publisher_descriptor(const struct sm2_publisher_t *publisher,
                                      int *fd);

/*
 Sets the default options. `options->size` must be set before, as for every struct.

 Threads: any.
 */
sm2_status_t sm2_publisher_options_init(struct sm2_publisher_options_t *options);

/*
 Sets the default options. `options->size` must be set before, as for every struct.

 Threads: any.
 */
sm2_status_t sm2_subscriber_options_init(struct sm2_subscriber_options_t *options);

/*
 Sets the default options. `options->size` must be set before, as for every struct.

 Threads: any.
 */
sm2_status_t sm2_server_options_init(struct sm2_server_options_t *options);

/*
 Sets the default options. `options->size` must be set before, as for every struct.

 Threads: any.
 */
sm2_status_t sm2_client_options_init(struct sm2_client_options_t *options);

/*
 Frees a text that the library made; NULL is ignored.

 Threads: any, but no other call may use this text at the same time or later.
 */
void sm2_text_free(char *text);

/*
 Stores the schema text of a type of ROS 2 in `schema`, such as that of `sensor_msgs/msg/Image`. Free it with
 `sm2_text_free()`.

 A topic carries the type if an `sm2_type_t` has this name and this schema. Its messages are those of ROS 2 in CDR,
 with the 4 bytes of the encapsulation in front, as `rmw_serialize()` of ROS 2 and the library Fast CDR write them.
 The library does not look into them. Programs in Rust and Python that declare the type have the same topics. The
 parts of a service are `std_srvs/srv/SetBool_Request` and `std_srvs/srv/SetBool_Response`.

 The definitions of ROS 2's common interfaces are built in. `folder` is NULL, or a package with definitions
 (`FOLDER/msg/NAME.msg`), or a folder of packages, such as `/opt/ros/jazzy/share`: a definition there replaces the
 built-in one of the same name.

 Errors: `SM2_BAD_NAME`; `SM2_BAD_SCHEMA` if nothing defines the type or a type that it refers to; `SM2_IO` if the
 folder cannot be read; `SM2_MISUSE`.

 Threads: any.
 */
sm2_status_t sm2_ros_schema(const char *name,
                            const char *folder,
                            char **schema);

/*
 Stores the bytes of a message in `data`, and their number in `len`. The bytes are in the memory that the publisher
 wrote, are aligned to 64 bytes, and do not change until the sample is released, freed or used again. Only messages
 of at most 104 bytes, and short messages of links without a ring, may be copies.

 Errors: `SM2_MISUSE`, also if the sample is empty.

 Threads: any, at the same time.
 */
sm2_status_t sm2_sample_data(const struct sm2_sample_t *sample,
                             const void **data,
                             size_t *len);

/*
 Fills `info`: number, time, loss, type and publisher of a message.

 Errors: `SM2_MISUSE`, also if the sample is empty.

 Threads: any, at the same time.
 */
sm2_status_t sm2_sample_info(const struct sm2_sample_t *sample, struct sm2_sample_info_t *info);

/*
 Releases the message of a sample, so that its publisher can use the memory again. The handle stays, for another
 `sm2_subscriber_recv()`.

 Errors: `SM2_MISUSE`.

 Threads: any, but no other call may use this sample at the same time. The subscriber, the node and the publisher may
 have ended.
 */
sm2_status_t sm2_sample_release(struct sm2_sample_t *sample);

/*
 Frees a sample, and releases its message; NULL is ignored.

 Threads: any, but no other call may use this handle at the same time or later. The subscriber, the node and the
 publisher may have ended.
 */
void sm2_sample_free(struct sm2_sample_t *sample);

/*
 Declares a server. `request` and `reply` are the types of requests and replies, both NULL for raw bytes. `options`
 is NULL for the defaults.

 Errors: `SM2_TYPE_MISMATCH`, `SM2_BAD_NAME`, `SM2_BAD_SCHEMA`, `SM2_BAD_QOS`, `SM2_NO_MANAGER`, `SM2_REFUSED`,
 `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_server_new(const struct sm2_node_t *node,
                            const char *service,
                            const struct sm2_type_t *request,
                            const struct sm2_type_t *reply,
                            const struct sm2_server_options_t *options,
                            struct sm2_server_t **server);

/*
 Frees a server, which is withdrawn once all requests that it took are answered; NULL is ignored.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_server_free(struct sm2_server_t *server);

/*
 Takes the next request. Waits for it for at most `timeout_ns` nanoseconds: not at all with 0, and without limit with
 `SM2_FOREVER`.

 `*request` is NULL, or a request of an earlier call, whose handle is used again. If it was not answered, its client
 learns that it failed.

 Errors: `SM2_TIMED_OUT`, `SM2_BORROW_LIMIT` if the program holds `max_borrowed` requests, `SM2_UNREADABLE`,
 `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time with other requests.
 */
sm2_status_t sm2_server_recv(const struct sm2_server_t *server,
                             uint64_t timeout_ns,
                             struct sm2_request_t **request);

/*
 Waits until at least `count` clients are linked, for at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).

 Errors: `SM2_TIMED_OUT`, `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_server_wait_for_clients(const struct sm2_server_t *server,
                                         size_t count,
                                         uint64_t timeout_ns);

/*
 Stores a descriptor in `fd` that is readable when `sm2_server_recv()` with the limit 0 may have a request. The
 server keeps the descriptor; do not close it.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_server_descriptor(const struct sm2_server_t *server,
                                   int *fd);

/*
 Explains why the server has no links: stores a text in `text`, with a line for each client that comes close. The
 text is empty if there is none. Free it with `sm2_text_free()`.

 Errors: `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_server_why(const struct sm2_server_t *server,
                            char **text);

/*
 Stores the bytes of a request in `data`, and their number in `len`. They are aligned to 64 bytes, and do not change
 until the request is answered, freed or used again.

 Errors: `SM2_MISUSE`, also if the request is empty.

 Threads: any, at the same time.
 */
sm2_status_t sm2_request_data(const struct sm2_request_t *request,
                              const void **data,
                              size_t *len);

/*
 Fills `info`: deadline and client of a request.

 Errors: `SM2_MISUSE`, also if the request is empty.

 Threads: any, at the same time.
 */
sm2_status_t sm2_request_info(const struct sm2_request_t *request, struct sm2_request_info_t *info);

/*
 Stores in `cancelled` whether the reply is not wanted any more: the client cancelled the call or is gone, or the
 deadline has passed. Long work asks this now and then.

 Errors: `SM2_MISUSE`, also if the request is empty.

 Threads: any, at the same time.
 */
sm2_status_t sm2_request_is_cancelled(const struct sm2_request_t *request,
                                      bool *cancelled);

/*
 Answers a request with the `len` bytes at `data`, and does not wait. The reply may be in the memory of the request.
 The request is empty then, also after an error other than `SM2_MISUSE`.

 Errors: `SM2_CLIENT_GONE`, `SM2_TOO_LONG`, `SM2_POOL_FULL`, `SM2_IO`, `SM2_MISUSE`, also if the request is empty.

 Threads: any, but no other call may use this request at the same time.
 */
sm2_status_t sm2_request_reply(struct sm2_request_t *request,
                               const void *data,
                               size_t len);

/*
 Answers that a request failed, with a reason for its client. The request is empty then, also after an error other
 than `SM2_MISUSE`.

 Errors: `SM2_CLIENT_GONE`, `SM2_IO`, `SM2_MISUSE`, also if the request is empty.

 Threads: any, but no other call may use this request at the same time.
 */
sm2_status_t sm2_request_fail(struct sm2_request_t *request,
                              const char *reason);

/*
 Frees a request; NULL is ignored. If it was not answered, its client learns that it failed.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_request_free(struct sm2_request_t *request);

/*
 Makes a shutdown handle. Set it in `sm2_node_options_t` and with `sm2_wait_set_end_with()`.

 Errors: `SM2_IO`, `SM2_MISUSE`.

 Threads: any.
 */
sm2_status_t sm2_shutdown_new(struct sm2_shutdown_t **shutdown);

/*
 Frees a shutdown handle; NULL is ignored. Nodes and wait sets that have it keep what they need.

 Threads: any, but no other call may use this handle at the same time or later: also no signal handler.
 */
void sm2_shutdown_free(struct sm2_shutdown_t *shutdown);

/*
 Ends all waits of the nodes and wait sets that have this handle, now and later, with `SM2_SHUTDOWN`. Calls that do
 not wait go on as before.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time, also in a signal handler if the handle is not NULL. `errno` stays as it was.
 */
sm2_status_t sm2_shutdown_request(const struct sm2_shutdown_t *shutdown);

/*
 Stores in `requested` whether the shutdown was requested.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_shutdown_is_requested(const struct sm2_shutdown_t *shutdown, bool *requested);

/*
 Stores a descriptor in `fd` that is readable once the shutdown was requested. The handle keeps the descriptor; do
 not close it.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_shutdown_descriptor(const struct sm2_shutdown_t *shutdown,
                                     int *fd);

/*
 Returns the text of the last error of this thread, in UTF-8: what happened, where, and what to do. It is the text
 that the Rust library gives for the same error; for `SM2_TYPE_MISMATCH`, lines with both schemas follow it.

 Calls that succeed do not change the text. It is empty before the first error. The pointer is valid until the next
 call of this thread that fails.

 Threads: any; each thread has a text of its own.
 */
const char *sm2_last_error(void);

/*
 Returns the error number (`errno`) of the operating system that caused the last error of this thread; 0 if the
 operating system did not cause it.

 Threads: any.
 */
int sm2_last_errno(void);

/*
 Returns the name of a code, such as `SM2_TIMED_OUT`; that of `SM2_UNKNOWN` for a number that is not a code. The text
 is valid forever.

 Threads: any.
 */
const char *sm2_status_name(int32_t status);

/*
 Declares a subscriber. `type` is NULL for raw bytes (or for the option `any_type`), and `options` for the defaults.

 Errors: `SM2_TYPE_MISMATCH`, `SM2_BAD_NAME`, `SM2_BAD_SCHEMA`, `SM2_BAD_QOS`, `SM2_NO_MANAGER`, `SM2_REFUSED`,
 `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_subscriber_new(const struct sm2_node_t *node,
                                const char *topic,
                                const struct sm2_type_t *type,
                                const struct sm2_subscriber_options_t *options,
                                struct sm2_subscriber_t **subscriber);

/*
 Frees a subscriber, which is withdrawn; NULL is ignored. Samples that were taken before stay valid.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_subscriber_free(struct sm2_subscriber_t *subscriber);

/*
 Takes the next message. Waits for it for at most `timeout_ns` nanoseconds: not at all with 0, and without limit with
 `SM2_FOREVER`. The message is read where the publisher wrote it: see `sm2_sample_data()`.

 `*sample` is NULL, or a sample of an earlier call. In the second case its message is released first, and the handle
 is used again, so that a loop does not allocate. Without a message it stays released.

 Errors: `SM2_TIMED_OUT`, `SM2_BORROW_LIMIT` if the program holds `max_borrowed` samples, `SM2_UNREADABLE`,
 `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time with other samples; each message is taken once.
 */
sm2_status_t sm2_subscriber_recv(const struct sm2_subscriber_t *subscriber,
                                 uint64_t timeout_ns,
                                 struct sm2_sample_t **sample);

/*
 Waits until at least `count` publishers are linked, for at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).

 Errors: `SM2_TIMED_OUT`, `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_subscriber_wait_for_publishers(const struct sm2_subscriber_t *subscriber,
                                                size_t count,
                                                uint64_t timeout_ns);

/*
 Stores a descriptor in `fd` that is readable when `sm2_subscriber_recv()` with the limit 0 may have a message. Take
 messages until there is none, then poll again, level-triggered. The subscriber keeps the descriptor; do not close
 it.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_subscriber_descriptor(const struct sm2_subscriber_t *subscriber,
                                       int *fd);

/*
 Fills `counters`.

 Errors: `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_subscriber_counters(const struct sm2_subscriber_t *subscriber,
                                     struct sm2_subscriber_counters_t *counters);

/*
 Explains why the subscriber has no links: stores a text in `text`, with a line for each publisher that comes close.
 The text is empty if there is none. Free it with `sm2_text_free()`.

 Errors: `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: any, at the same time.
 */
sm2_status_t sm2_subscriber_why(const struct sm2_subscriber_t *subscriber,
                                char **text);

/*
 Stores the hash of a schema text in `hash`.

 Errors: `SM2_BAD_SCHEMA`, `SM2_MISUSE`.

 Threads: any.
 */
sm2_status_t sm2_schema_hash(const char *schema, uint64_t *hash);

/*
 Makes an empty wait set. It waits for subscribers, servers, calls, publishers with room, timers and descriptors, in
 one thread without callbacks. Each source has a tag of the program's choice, which must be unique in the set.

 Errors: `SM2_IO`, `SM2_MISUSE`.

 Threads: any.
 */
sm2_status_t sm2_wait_set_new(struct sm2_wait_set_t **set);

/*
 Frees a wait set; NULL is ignored. Its sources stay as they are.

 Threads: any, but no other call may use this handle at the same time or later.
 */
void sm2_wait_set_free(struct sm2_wait_set_t *set);

/*
 Adds a subscriber. It is reported again and again until `sm2_subscriber_recv()` with the limit 0 finds nothing. It
 may be freed while it is in the set, and is not reported then.

 Errors: `SM2_IO`, `SM2_MISUSE`, also if the tag is in use.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_add_subscriber(struct sm2_wait_set_t *set,
                                         const struct sm2_subscriber_t *subscriber,
                                         uint64_t tag);

/*
 Adds a server. It is reported again and again until `sm2_server_recv()` with the limit 0 finds nothing. It may be
 freed while it is in the set.

 Errors: `SM2_IO`, `SM2_MISUSE`, also if the tag is in use.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_add_server(struct sm2_wait_set_t *set,
                                     const struct sm2_server_t *server,
                                     uint64_t tag);

/*
 Adds a publisher. It is reported while every reliable subscriber has room: then call `sm2_publisher_try_publish()`.
 A program adds it while it has a message that found no room, and then removes it.

 Errors: `SM2_IO`, `SM2_MISUSE`, also if the tag is in use.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_add_publisher(struct sm2_wait_set_t *set,
                                        const struct sm2_publisher_t *publisher,
                                        uint64_t tag);

/*
 Adds a pending call. It is reported once, when it has a result or its deadline has passed; then it leaves the set,
 and `sm2_call_try_wait()` returns the result.

 Errors: `SM2_IO`, `SM2_MISUSE`, also if the tag is in use or the call is spent.

 Threads: one at a time for each set and call.
 */
sm2_status_t sm2_wait_set_add_call(struct sm2_wait_set_t *set,
                                   const struct sm2_call_t *call,
                                   uint64_t tag);

/*
 Adds a timer that ticks once in each period of `period_ns` nanoseconds, without drift. With `burst`, each missed
 tick is reported; otherwise only the newest, with the number of those before it.

 Errors: `SM2_MISUSE`, also if the tag is in use.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_add_timer(struct sm2_wait_set_t *set,
                                    uint64_t period_ns,
                                    bool burst,
                                    uint64_t tag);

/*
 Adds a timer that ticks `frequency` times in each second, without drift, also if a second is not a multiple of the
 period. `burst` as for `sm2_wait_set_add_timer()`.

 Errors: `SM2_MISUSE`, also if the tag is in use.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_add_timer_hz(struct sm2_wait_set_t *set,
                                       uint32_t frequency,
                                       bool burst,
                                       uint64_t tag);

/*
 Adds a timer that ticks once, `delay_ns` nanoseconds from now. Then it leaves the set.

 Errors: `SM2_MISUSE`, also if the tag is in use.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_add_timer_once(struct sm2_wait_set_t *set,
                                         uint64_t delay_ns,
                                         uint64_t tag);

/*
 Adds a descriptor of the program, level-triggered: reported while reading (`readable`) or writing (`writable`) does
 not block, or after a hang-up. The descriptor must stay open until it is removed or the set is freed.

 Errors: `SM2_IO` (such as `EEXIST` for a descriptor that is in the set, and `EPERM` for a regular file),
 `SM2_MISUSE`, also if the tag is in use.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_add_descriptor(struct sm2_wait_set_t *set,
                                         int fd,
                                         bool readable,
                                         bool writable,
                                         uint64_t tag);

/*
 Ends every wait of the set with `SM2_SHUTDOWN` once this shutdown is requested, also if a source is ready.

 Errors: `SM2_IO`, `SM2_MISUSE`.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_end_with(struct sm2_wait_set_t *set,
                                   const struct sm2_shutdown_t *shutdown);

/*
 Drives a node without a background thread during every wait, if no source of the set belongs to it.

 Errors: `SM2_IO`, `SM2_MISUSE`.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_drive(struct sm2_wait_set_t *set, const struct sm2_node_t *node);

/*
 Removes the source with this tag. It is not reported any more, even if it was ready.

 Errors: `SM2_MISUSE`, also if no source of the set has the tag.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_remove(struct sm2_wait_set_t *set, uint64_t tag);

/*
 Waits until a source is ready, for at most `timeout_ns` nanoseconds: not at all with 0, and without limit with
 `SM2_FOREVER`. Stores its tag, and the tick of a timer, in `ready`. Sources that are ready at the same time are
 reported in turn.

 Errors: `SM2_TIMED_OUT`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.

 Threads: one at a time for each set.
 */
sm2_status_t sm2_wait_set_wait(struct sm2_wait_set_t *set,
                               uint64_t timeout_ns,
                               struct sm2_ready_t *ready);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SM2_H */
