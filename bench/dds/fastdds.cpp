// Fast DDS: a sequence of bytes, reliable, read on the thread that waits for it.
//
// Mode "plain": a type of fixed size without pointers, written into loans, which Fast DDS's data
// sharing delivers without a copy.
#include "bench_dds.h"

#include <chrono>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include <fastdds/dds/core/LoanableSequence.hpp>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>

using namespace eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastrtps::types::ReturnCode_t;

namespace {

thread_local std::string error;

int failed(const char *what) {
  error = what;
  return -1;
}

// The encapsulation before every payload, and the length of a sequence.
constexpr uint32_t ENCAPSULATION = 4;
constexpr uint32_t LENGTH = 4;

using Bytes = std::vector<uint8_t>;

// The output of the generator for `struct Message { sequence<octet> data; };`.
class SequenceType : public TopicDataType {
public:
  explicit SequenceType(size_t max_len) {
    setName("bench::Message");
    m_typeSize = static_cast<uint32_t>(max_len) + ENCAPSULATION + LENGTH;
    m_isGetKeyDefined = false;
  }

  bool serialize(void *data, rtps::SerializedPayload_t *payload) override {
    const Bytes &bytes = *static_cast<Bytes *>(data);
    const uint32_t length = static_cast<uint32_t>(bytes.size());
    const uint8_t header[ENCAPSULATION] = {0, CDR_LE, 0, 0};
    payload->encapsulation = CDR_LE;
    std::memcpy(payload->data, header, ENCAPSULATION);
    std::memcpy(payload->data + ENCAPSULATION, &length, LENGTH);
    std::memcpy(payload->data + ENCAPSULATION + LENGTH, bytes.data(), length);
    payload->length = ENCAPSULATION + LENGTH + length;
    return true;
  }

  bool deserialize(rtps::SerializedPayload_t *payload, void *data) override {
    uint32_t length = 0;
    if (payload->length < ENCAPSULATION + LENGTH)
      return false;
    std::memcpy(&length, payload->data + ENCAPSULATION, LENGTH);
    if (length > payload->length - ENCAPSULATION - LENGTH)
      return false;
    Bytes &bytes = *static_cast<Bytes *>(data);
    bytes.resize(length);
    std::memcpy(bytes.data(), payload->data + ENCAPSULATION + LENGTH, length);
    return true;
  }

  std::function<uint32_t()> getSerializedSizeProvider(void *data) override {
    return [data] {
      return static_cast<uint32_t>(static_cast<Bytes *>(data)->size()) + ENCAPSULATION + LENGTH;
    };
  }

  void *createData() override { return new Bytes; }
  void deleteData(void *data) override { delete static_cast<Bytes *>(data); }
  bool getKey(void *, rtps::InstanceHandle_t *, bool) override { return false; }
};

// The output of the generator for `struct Message { octet data[N]; };`.
class PlainType : public TopicDataType {
public:
  explicit PlainType(size_t len) : len_(len) {
    setName("bench::PlainMessage");
    m_typeSize = static_cast<uint32_t>(len) + ENCAPSULATION;
    m_isGetKeyDefined = false;
  }

  bool serialize(void *data, rtps::SerializedPayload_t *payload) override {
    const uint8_t header[ENCAPSULATION] = {0, CDR_LE, 0, 0};
    payload->encapsulation = CDR_LE;
    std::memcpy(payload->data, header, ENCAPSULATION);
    std::memcpy(payload->data + ENCAPSULATION, data, len_);
    payload->length = m_typeSize;
    return true;
  }

  bool deserialize(rtps::SerializedPayload_t *payload, void *data) override {
    if (payload->length < m_typeSize)
      return false;
    std::memcpy(data, payload->data + ENCAPSULATION, len_);
    return true;
  }

  std::function<uint32_t()> getSerializedSizeProvider(void *) override {
    return [size = m_typeSize] { return size; };
  }

  void *createData() override { return std::malloc(len_); }
  void deleteData(void *data) override { std::free(data); }
  bool getKey(void *, rtps::InstanceHandle_t *, bool) override { return false; }
  bool is_bounded() const override { return true; }
  bool is_plain() const override { return true; }
  // The memory of a loan needs no initialization: all of it is written.
  bool construct_sample(void *) const override { return true; }

private:
  size_t len_;
};

} // namespace

struct bench_participant {
  DomainParticipant *entity;
  bool plain;
};

struct bench_publisher {
  DataWriter *writer;
  bool plain;
  Bytes bytes;
};

struct bench_subscriber {
  DataReader *reader;
  bool plain;
  size_t plain_len;
  Bytes bytes;
};

const char *bench_error(void) { return error.c_str(); }

bench_participant *bench_open(uint32_t domain, const char *mode) {
  DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
  // The default transports, shared memory and UDP, but only on the loopback interface, so that the
  // traffic of a run does not leave the machine.
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList.push_back("127.0.0.1");
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(
      std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>());
  qos.transport().user_transports.push_back(udp);
  DomainParticipant *entity =
      DomainParticipantFactory::get_instance()->create_participant(domain, qos);
  if (entity == nullptr) {
    failed("create a participant");
    return nullptr;
  }
  return new bench_participant{entity, std::string(mode) == "plain"};
}

namespace {

Topic *create_topic(bench_participant *participant, const bench_topic *topic) {
  TypeSupport type(participant->plain
                       ? static_cast<TopicDataType *>(new PlainType(topic->max_len))
                       : static_cast<TopicDataType *>(new SequenceType(topic->max_len)));
  if (type.register_type(participant->entity) != ReturnCode_t::RETCODE_OK)
    return nullptr;
  return participant->entity->create_topic(topic->name, type.get_type_name(), TOPIC_QOS_DEFAULT);
}

// The length of the shortest large message.
constexpr size_t LARGE = 256 * 1024;

// Reliable. Large messages and lossless topics keep all: with keep-last, a writer that is faster
// than its readers would replace messages before they are sent, and few would arrive. Small messages
// are keep-last, so that writers do not wait for readers that come and go.
template <typename Qos> void set(Qos &qos, const bench_topic *topic, bool plain) {
  qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
  const int32_t depth = topic->depth < 4 ? 4 : static_cast<int32_t>(topic->depth);
  const bool keep_all = topic->lossless || topic->max_len >= LARGE;
  qos.history().kind = keep_all ? KEEP_ALL_HISTORY_QOS : KEEP_LAST_HISTORY_QOS;
  qos.history().depth = depth;
  qos.resource_limits().max_instances = 1;
  qos.resource_limits().max_samples = depth;
  qos.resource_limits().max_samples_per_instance = depth;
  qos.resource_limits().allocated_samples = 1;
  qos.resource_limits().extra_samples = 2;
  if (plain) {
    qos.data_sharing().automatic();
  } else {
    qos.data_sharing().off();
    qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  }
}

} // namespace

bench_publisher *bench_publish_on(bench_participant *participant, const bench_topic *topic) {
  Topic *on = create_topic(participant, topic);
  Publisher *publisher = participant->entity->create_publisher(PUBLISHER_QOS_DEFAULT);
  if (on == nullptr || publisher == nullptr) {
    failed("create a topic and a publisher");
    return nullptr;
  }
  DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
  set(qos, topic, participant->plain);
  qos.reliability().max_blocking_time = eprosima::fastrtps::Duration_t(20, 0);
  // Fast DDS requires that a thread of its own sends messages larger than a datagram.
  if (topic->max_len > 60000)
    qos.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;
  DataWriter *writer = publisher->create_datawriter(on, qos);
  if (writer == nullptr) {
    failed("create a writer");
    return nullptr;
  }
  return new bench_publisher{writer, participant->plain, Bytes()};
}

int bench_matched(bench_publisher *publisher) {
  PublicationMatchedStatus status;
  if (publisher->writer->get_publication_matched_status(status) != ReturnCode_t::RETCODE_OK)
    return failed("look for subscribers");
  return status.current_count;
}

int bench_publish(bench_publisher *publisher, size_t len, bench_write write, void *context) {
  if (!publisher->plain) {
    publisher->bytes.resize(len);
    write(context, publisher->bytes.data(), len);
    return publisher->writer->write(&publisher->bytes) ? 0 : failed("write");
  }
  void *loan = nullptr;
  ReturnCode_t code = publisher->writer->loan_sample(loan);
  // All loans may be in flight: they are released when subscribers have acknowledged them.
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  while (code == ReturnCode_t::RETCODE_OUT_OF_RESOURCES &&
         std::chrono::steady_clock::now() < until) {
    publisher->writer->wait_for_acknowledgments(eprosima::fastrtps::Duration_t(0, 1000000));
    code = publisher->writer->loan_sample(loan);
  }
  if (code != ReturnCode_t::RETCODE_OK)
    return failed("get memory for a message");
  write(context, static_cast<uint8_t *>(loan), len);
  return publisher->writer->write(loan) ? 0 : failed("write a loan");
}

bench_subscriber *bench_subscribe_to(bench_participant *participant, const bench_topic *topic) {
  Topic *on = create_topic(participant, topic);
  Subscriber *subscriber = participant->entity->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  if (on == nullptr || subscriber == nullptr) {
    failed("create a topic and a subscriber");
    return nullptr;
  }
  DataReaderQos qos = DATAREADER_QOS_DEFAULT;
  set(qos, topic, participant->plain);
  DataReader *reader = subscriber->create_datareader(on, qos);
  if (reader == nullptr) {
    failed("create a reader");
    return nullptr;
  }
  return new bench_subscriber{reader, participant->plain, topic->max_len, Bytes()};
}

namespace {

// Takes one message; returns 1 if there is none.
int take(bench_subscriber *subscriber, bench_read read, void *context, int *done) {
  DataReader *reader = subscriber->reader;
  if (!subscriber->plain) {
    SampleInfo info;
    ReturnCode_t code = reader->take_next_sample(&subscriber->bytes, &info);
    if (code == ReturnCode_t::RETCODE_NO_DATA)
      return 1;
    if (code != ReturnCode_t::RETCODE_OK)
      return failed("take");
    if (info.valid_data)
      *done = read(context, subscriber->bytes.data(), subscriber->bytes.size());
    return 0;
  }
  LoanableSequence<uint8_t> samples;
  SampleInfoSeq infos;
  ReturnCode_t code = reader->take(samples, infos, 1);
  if (code == ReturnCode_t::RETCODE_NO_DATA)
    return 1;
  if (code != ReturnCode_t::RETCODE_OK)
    return failed("take");
  const uint8_t *message = static_cast<const uint8_t *>(samples.buffer()[0]);
  if (infos[0].valid_data)
    *done = read(context, message, subscriber->plain_len);
  reader->return_loan(samples, infos);
  return 0;
}

} // namespace

int bench_pump(bench_subscriber *subscriber, uint64_t timeout_ns, bench_read read, void *context) {
  const auto until = std::chrono::steady_clock::now() + std::chrono::nanoseconds(timeout_ns);
  for (;;) {
    int done = 0;
    const int taken = take(subscriber, read, context, &done);
    if (taken < 0)
      return -1;
    if (done)
      return 0;
    if (taken == 0)
      continue;
    const auto left = until - std::chrono::steady_clock::now();
    const int64_t ns = std::chrono::duration_cast<std::chrono::nanoseconds>(left).count();
    if (ns <= 0)
      return 0;
    const eprosima::fastrtps::Duration_t wait(static_cast<int32_t>(ns / 1000000000),
                                              static_cast<uint32_t>(ns % 1000000000));
    if (!subscriber->reader->wait_for_unread_message(wait))
      return 0;
  }
}
