"""The peers in Python. Each has what `role.py` uses:

- `publisher(channel)` with `publish(length, write)`, where `write(place)` writes the message, and `matched()`;
- `subscriber(channel, message)` with `pump(until_ns)`, which calls `message(place)` for each message until it returns
  true.

The place of a message is an object with the buffer protocol, or a pair of its address and length.

Each is written as the documents of its middleware show, with shared memory where its Python has it.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable
from typing import Any

#: Timeout of connections and of reliable messages, in seconds.
TIMEOUT_S = 20.0

Channel = dict[str, Any]
Place = Any
Write = Callable[[Place], None]
Handle = Callable[[Place], bool]

now_ns = time.monotonic_ns


class Sm2:
    """SM2, pooled, reliable. Messages of up to 1,024 bytes are copied, others are written into loans."""

    SHORT = 1024

    def __init__(self, domain: dict[str, Any], name: str, first: bool) -> None:
        import sm2

        self.node = sm2.Node(name, socket=f"{domain['dir']}/sm2.sock")

    def publisher(self, channel: Channel) -> Any:
        """Declares a publisher."""
        depth = min(channel["depth"], 1024)
        declared = self.node.publisher(
            channel["name"], bytes, keep_last=depth, reliable=True, publish_timeout=TIMEOUT_S
        )
        buffer = memoryview(bytearray(self.SHORT))

        class Publisher:
            """Copies short messages, and writes others in place."""

            def publish(self, length: int, write: Write) -> None:
                """Sends one message."""
                if length <= Sm2.SHORT:
                    part = buffer[:length]
                    write(part)
                    if declared.publish(part).missed:
                        raise TimeoutError("a subscriber missed a message")
                    return
                with declared.loan(length) as array:
                    write(array)

            def matched(self) -> int:
                """How many subscribers are linked."""
                import sm2

                count = 0
                try:
                    while True:
                        declared.wait_for_subscribers(count + 1, 0)
                        count += 1
                except sm2.WaitError:
                    return count

        return Publisher()

    def subscriber(self, channel: Channel, message: Handle) -> Any:
        """Declares a subscriber."""
        depth = min(channel["depth"], 1024)
        declared = self.node.subscriber(channel["name"], bytes, keep_last=depth, reliable=True, max_borrowed=1)

        class Subscriber:
            """Reads messages in place."""

            def pump(self, until_ns: int) -> None:
                """Handles messages."""
                # One reading of the clock per call, as in `src/peers/sm2.rs`.
                timeout = max(until_ns - now_ns(), 0) / 1e9
                while (sample := declared.recv(timeout)) is not None:
                    array = sample.numpy()
                    is_done = message(array)
                    del sample, array
                    if is_done:
                        return

        return Subscriber()


class Iceoryx2:
    """iceoryx2: an event wakes the subscriber; the publisher retries while a queue is full."""

    def __init__(self, domain: dict[str, Any], name: str, first: bool) -> None:
        import iceoryx2

        self.iox2 = iceoryx2
        iceoryx2.set_log_level(iceoryx2.LogLevel.Error)
        config = iceoryx2.config.default()
        config.global_cfg.prefix = iceoryx2.FileName.new(domain["tag"])
        config.global_cfg.root_path = iceoryx2.Path.new(f"{domain['dir']}/iceoryx2")
        builder = iceoryx2.NodeBuilder.new().config(config)
        builder = builder.signal_handling_mode(iceoryx2.SignalHandlingMode.Disabled)
        self.node = builder.create(iceoryx2.ServiceType.Ipc)

    def service(self, channel: Channel) -> Any:
        """The service of a channel."""
        name = self.iox2.ServiceName.new(channel["name"])
        builder = self.node.service_builder(name).publish_subscribe(self.iox2.Slice[ctypes.c_uint8])
        builder = builder.enable_safe_overflow(False).subscriber_max_buffer_size(max(channel["depth"], 1))
        return builder.max_subscribers(16).open_or_create()

    def event(self, channel: Channel) -> Any:
        """The event of a channel."""
        return self.node.service_builder(self.iox2.ServiceName.new(channel["name"])).event().open_or_create()

    def publisher(self, channel: Channel) -> Any:
        """Makes a publisher and a notifier."""
        service = self.service(channel)
        builder = service.publisher_builder().initial_max_slice_len(channel["max_len"])
        builder = builder.backpressure_strategy(self.iox2.BackpressureStrategy.RetryUntilDelivered)
        made = builder.create()
        notifier = self.event(channel).notifier_builder().create()

        class Publisher:
            """Writes messages in place."""

            def publish(self, length: int, write: Write) -> None:
                """Sends one message."""
                sample = made.loan_slice_uninit(length)
                write((sample.payload_ptr, length))
                sample.assume_init().send()
                notifier.notify()

            def matched(self) -> int:
                """How many subscribers are connected."""
                made.update_connections()
                count: int = service.dynamic_config.number_of_subscribers
                return count

        return Publisher()

    def subscriber(self, channel: Channel, message: Handle) -> Any:
        """Makes a subscriber and a listener."""
        listener = self.event(channel).listener_builder().create()
        made = self.service(channel).subscriber_builder().create()
        duration = self.iox2.Duration

        class Subscriber:
            """Reads messages in place."""

            def pump(self, until_ns: int) -> None:
                """Handles messages."""
                while True:
                    sample = made.receive()
                    if sample is None:
                        left_ns = until_ns - now_ns()
                        if left_ns <= 0:
                            return
                        listener.timed_wait(duration.from_nanos(left_ns))
                        continue
                    is_done = message((sample.payload_ptr, sample.header.number_of_elements))
                    sample.delete()
                    if is_done:
                        return

        return Subscriber()


class Zenoh:
    """Zenoh, peer to peer over TCP, its default; nothing is dropped. The payload is copied into bytes of Python."""

    def __init__(self, domain: dict[str, Any], name: str, first: bool) -> None:
        import zenoh

        self.zenoh = zenoh
        self.name = name
        config = zenoh.Config()
        here = f'["tcp/127.0.0.1:{domain["port"]}"]'
        for key, value in {
            "mode": '"peer"',
            "listen/endpoints": here if first else '["tcp/127.0.0.1:0"]',
            "connect/endpoints": "[]" if first else here,
            "connect/retry": "{ period_init_ms: 20 }",
            "connect/timeout_ms": "10000",
            "scouting/multicast/enabled": "false",
            "transport/shared_memory/enabled": "false",
        }.items():
            config.insert_json5(key, value)
        self.session = zenoh.open(config)

    def publisher(self, channel: Channel) -> Any:
        """Declares a publisher."""
        session, topic = self.session, channel["name"]
        block = self.zenoh.CongestionControl.BLOCK
        declared = session.declare_publisher(topic, congestion_control=block)
        buffer = memoryview(bytearray(channel["max_len"]))

        class Publisher:
            """Writes into memory of its own, which Zenoh copies."""

            def publish(self, length: int, write: Write) -> None:
                """Sends one message."""
                part = buffer[:length]
                write(part)
                declared.put(bytes(part))

            def matched(self) -> int:
                """How many subscribers have a token."""
                return sum(1 for _ in session.liveliness().get(f"alive/{topic}/*", timeout=TIMEOUT_S))

        return Publisher()

    def subscriber(self, channel: Channel, message: Handle) -> Any:
        """Declares a subscriber, and a token by which publishers count it. Zenoh's thread handles the messages."""
        is_done = threading.Event()

        def handle(sample: Any) -> None:
            if message(sample.payload.to_bytes()):
                is_done.set()

        declared = self.session.declare_subscriber(channel["name"], handle)
        token = self.session.liveliness().declare_token(f"alive/{channel['name']}/{self.name}")

        class Subscriber:
            """Waits for the end."""

            _kept = (declared, token)

            def pump(self, until_ns: int) -> None:
                """Lets messages be handled."""
                if is_done.wait(max(until_ns - now_ns(), 0) / 1e9):
                    is_done.clear()

        return Subscriber()


class Cyclone:
    """Cyclone DDS, reliable, a sequence of bytes. The payload is copied into bytes of Python."""

    def __init__(self, domain: dict[str, Any], name: str, first: bool) -> None:
        from cyclonedds.domain import Domain, DomainParticipant

        number = domain["port"] % 200
        interfaces = '<Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces>'
        self.domain = Domain(
            number, f'<CycloneDDS><Domain id="any"><General>{interfaces}</General></Domain></CycloneDDS>'
        )
        self.participant = DomainParticipant(number)

    def entities(self, channel: Channel) -> tuple[Any, Any]:
        """The topic and the quality of service of a channel."""
        from dataclasses import make_dataclass

        from cyclonedds.core import Policy, Qos
        from cyclonedds.idl import IdlStruct
        from cyclonedds.idl.types import sequence, uint8
        from cyclonedds.topic import Topic
        from cyclonedds.util import duration

        kind = make_dataclass(
            "Message", [("data", sequence[uint8])], bases=(IdlStruct,), namespace={"__module__": __name__}
        )
        depth = max(channel["depth"], 4)
        qos = Qos(
            Policy.Reliability.Reliable(duration(seconds=int(TIMEOUT_S))),
            Policy.History.KeepAll,
            Policy.ResourceLimits(max_samples=depth, max_instances=-1, max_samples_per_instance=-1),
        )
        return Topic(self.participant, channel["name"], kind), qos

    def publisher(self, channel: Channel) -> Any:
        """Makes a writer."""
        from cyclonedds.pub import DataWriter

        topic, qos = self.entities(channel)
        writer = DataWriter(self.participant, topic, qos=qos)
        buffer = memoryview(bytearray(channel["max_len"]))
        kind = topic.data_type

        class Publisher:
            """Writes into memory of its own, which Cyclone copies."""

            def publish(self, length: int, write: Write) -> None:
                """Sends one message."""
                part = buffer[:length]
                write(part)
                writer.write(kind(data=bytes(part)))

            def matched(self) -> int:
                """How many subscribers are connected."""
                return len(writer.get_matched_subscriptions())

        return Publisher()

    def subscriber(self, channel: Channel, message: Handle) -> Any:
        """Makes a reader."""
        from cyclonedds.core import ReadCondition, ViewState, InstanceState, SampleState, WaitSet
        from cyclonedds.sub import DataReader
        from cyclonedds.util import duration

        topic, qos = self.entities(channel)
        reader = DataReader(self.participant, topic, qos=qos)
        wait_set = WaitSet(self.participant)
        wait_set.attach(ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.NotRead))

        class Subscriber:
            """Reads copies."""

            def pump(self, until_ns: int) -> None:
                """Handles messages."""
                while True:
                    for sample in reader.take(1):
                        data = bytes(sample.data) if hasattr(sample, "data") else b""
                        if data and message(data):
                            return
                    left_ns = until_ns - now_ns()
                    if left_ns <= 0:
                        return
                    wait_set.wait(duration(nanoseconds=left_ns))

        return Subscriber()


#: The classes of the peers, by their names in the catalogue.
PEERS: dict[str, Any] = {
    "sm2-python": Sm2,
    "iceoryx2-python": Iceoryx2,
    "zenoh-python": Zenoh,
    "cyclone-python": Cyclone,
}
