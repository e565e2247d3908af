"""A process of a run in Python: `role.py JOB`. It does what `src/roles/` does, with the same jobs, events and payload.

The environment variable `SM2_BENCH_PAYLOAD` names the module of `payload.rs`, which writes and checks the messages.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from typing import Any

from peers import PEERS, Place

#: The flag of messages that belong to the counted part of a run.
COUNTED = 1
#: The number of unstamped messages between two readings of the clock.
RUN = 64
#: Messages between two readings of the clock when messages carry no times.
CLOCK_EACH = 256
#: The number of round trips before the counted ones.
WARM_UP = 100
#: How long a peer may take for connections, and how long one round trip may take, in nanoseconds.
TIMEOUT_NS = 20_000_000_000
RETURN_NS = 1_000_000_000

now_ns = time.monotonic_ns


def payload() -> Any:
    """The module of `payload.rs`."""
    path = os.environ["SM2_BENCH_PAYLOAD"]
    spec = spec_from_file_location("libpayload", path, loader=ExtensionFileLoader("libpayload", path))
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


_payload = payload()
#: One call per message, so that the processes measure their middleware.
write, write_stamped, read = _payload.write, _payload.write_stamped, _payload.read

go, stop, end = threading.Event(), threading.Event(), threading.Event()


def listen() -> None:
    """Reads the director's words."""
    for line in sys.stdin:
        {"go": go, "stop": stop}.get(line.strip(), end).set()
    for event in (go, stop, end):
        event.set()


def send(event: Any) -> None:
    """Sends a line to the director."""
    print(json.dumps(event), flush=True)


def spread(values: list[int]) -> dict[str, float]:
    """Statistics of durations, as `Durations::spread` computes them."""
    if not values:
        return {"count": 0, "mean": 0.0, "p50": 0.0, "p99": 0.0, "max": 0.0}
    ordered = sorted(values)
    at = lambda share: float(ordered[min(len(ordered) - 1, int(share * len(ordered)))])
    mean = sum(ordered) / len(ordered)
    return {"count": len(ordered), "mean": mean, "p50": at(0.5), "p99": at(0.99), "max": float(ordered[-1])}


class Source:
    """Publishes a stream."""

    def __init__(self, publisher: Any, stream: dict[str, Any]) -> None:
        self.publisher = publisher
        self.stream = stream
        self.length: int = stream["len"]
        self.stamped: bool = stream["stamped"]
        self.number = 0

    def run(self, seconds: float, flags: int) -> int:
        """Publishes for this many seconds, and returns the number of messages."""
        start_ns = now_ns()
        end_ns = start_ns + int(seconds * 1e9)
        rate = self.stream["rate_hz"]
        run = 1 if rate or self.stream["stamped"] else RUN
        count = 0
        while now_ns() < end_ns:
            if rate:
                if stop.is_set():
                    break
                due_ns = start_ns + int(count * 1e9 / rate)
                time.sleep(max(min(due_ns, end_ns) - now_ns(), 0) / 1e9)
                if due_ns >= end_ns:
                    break
            for _ in range(run):
                self.publish(flags)
            count += run
        return count

    def publish(self, flags: int) -> None:
        """Publishes one message."""
        number = self.number
        self.number += 1
        length, stamped = self.length, self.stamped
        self.publisher.publish(length, lambda place: write_stamped(place, number, flags, stamped))


def wait_matched(publisher: Any, count: int) -> None:
    """Waits until `count` subscribers are connected."""
    until_ns = now_ns() + TIMEOUT_NS
    while publisher.matched() < count:
        if now_ns() > until_ns:
            raise TimeoutError("wait for subscribers: timed out")
        time.sleep(0.001)


def publish(open_peer: Any, stream: dict[str, Any]) -> Any:
    """Publishes from `go` to `stop`."""
    peer = open_peer("publisher", True)
    source = Source(peer.publisher(stream["channel"]), stream)
    send("ready")
    go.wait()
    wait_matched(source.publisher, stream["channel"]["subscribers"])
    source.run(stream["warm_up_s"], 0)
    send("measuring")
    start_ns = now_ns()
    counted = source.run(stream["seconds"], COUNTED)
    seconds = (now_ns() - start_ns) / 1e9
    send("measured")
    while not stop.is_set():
        source.run(0.05, 0)
    return {"published": {"counted": counted, "seconds": seconds}}


class Counter:
    """Checks and counts the messages of a stream, as `ReceptionCounter` does."""

    def __init__(self, full: bool) -> None:
        self.full = full
        self.counted = self.torn = self.stale = 0
        self.last = -1
        self.first_ns = self.last_ns = self.messages = 0
        self.latencies: list[int] = []
        self.handovers: list[int] = []

    def message(self, place: Place) -> bool:
        """Handles one message. Returns whether the caller is to return."""
        number, flags, start, handed, in_hand_ns, torn = read(place, self.full)
        if torn:
            self.torn += 1
        elif number <= self.last:
            self.stale += 1
        else:
            self.last = number
        if flags & COUNTED:
            self.counted += 1
            if start or self.counted % CLOCK_EACH == 1:
                now = now_ns()
                if self.counted == 1:
                    self.first_ns = now
                self.last_ns, self.messages = now, self.counted
                if start:
                    self.latencies.append(now - start)
                    self.handovers.append(in_hand_ns - handed)
        return False

    def reception(self) -> Any:
        """The figures."""
        span_ns = self.last_ns - self.first_ns
        return {
            "counted": self.counted,
            "torn": self.torn,
            "stale": self.stale,
            "hz": (self.messages - 1) * 1e9 / span_ns if span_ns > 0 else 0.0,
            "latency_ns": spread(self.latencies),
            "handover_ns": spread(self.handovers),
        }


def subscribe(open_peer: Any, job: dict[str, Any]) -> Any:
    """Receives until standard input ends."""
    peer = open_peer(f"subscriber-{job['number']}", False)
    counter = Counter(job["read"] == "full")
    subscriber = peer.subscriber(job["channel"], counter.message)
    send("ready")
    while not end.is_set():
        subscriber.pump(now_ns() + 250_000_000)
    return {"received": counter.reception()}


def channel(name: str, trips: dict[str, Any]) -> dict[str, Any]:
    """The channel of one direction of a round trip."""
    return {"name": name, "max_len": trips["len"], "depth": 2, "lossless": True, "subscribers": 1}


class Ping:
    """Sends messages, and waits for each to come back."""

    def __init__(self, peer: Any, trips: dict[str, Any]) -> None:
        self.trips = trips
        self.full = trips["read"] == "full"
        self.expected = self.number = self.torn = 0
        self.one_way: list[int] = []
        self.publisher = peer.publisher(channel("bench/ping", trips))
        self.subscriber: Any = None

    def message(self, place: Place) -> bool:
        """Handles a message that comes back."""
        number, _, _, handed, in_hand_ns, torn = read(place, self.full)
        if torn:
            self.torn += 1
        if handed:
            self.one_way.append(in_hand_ns - handed)
        if number != self.expected:
            return False
        self.expected = 0
        return True

    def trip(self, stamped: bool) -> int | None:
        """The duration of one round trip; None if nothing came back in time."""
        self.number += 1
        self.expected = number = self.number
        length = self.trips["len"]
        sent_ns = now_ns()
        self.publisher.publish(length, lambda place: write(place, number, 0, int(stamped), False))
        while True:
            self.subscriber.pump(sent_ns + RETURN_NS)
            now = now_ns()
            if self.expected != number:
                return now - sent_ns
            if now >= sent_ns + RETURN_NS:
                return None

    def sure(self, stamped: bool) -> int:
        """As `trip`, which must succeed."""
        duration = self.trip(stamped)
        if duration is None:
            raise TimeoutError("ping: no message came back")
        return duration

    def repeat(self, stamped: bool) -> list[int]:
        """As many trips as the job wants."""
        end_ns = now_ns() + int(self.trips["seconds"] * 1e9)
        durations = []
        for _ in range(self.trips["count"]):
            durations.append(self.sure(stamped))
            if now_ns() >= end_ns:
                break
        return durations


def ping(open_peer: Any, trips: dict[str, Any]) -> Any:
    """Measures round trips: first the whole trip with one clock, then one way with times in the messages."""
    peer = open_peer("ping", True)
    both = Ping(peer, trips)
    send("ready")
    go.wait()
    both.subscriber = peer.subscriber(channel("bench/pong", trips), both.message)
    wait_matched(both.publisher, 1)
    until_ns = now_ns() + TIMEOUT_NS
    # The echo may not be connected to our subscriber yet.
    while both.trip(False) is None:
        if now_ns() > until_ns:
            raise TimeoutError("ping: no message came back")
    for _ in range(WARM_UP):
        both.sure(False)
    round_trips = both.repeat(False)
    both.repeat(True)
    return {
        "round_trips": {
            "round_trip_ns": spread(round_trips),
            "one_way_ns": spread(both.one_way),
            "torn": both.torn,
        }
    }


def echo(open_peer: Any, trips: dict[str, Any]) -> Any:
    """Answers each message with one of its own."""
    peer = open_peer("echo", False)
    publisher = peer.publisher(channel("bench/pong", trips))
    length, full = trips["len"], trips["read"] == "full"
    torn = 0

    def message(place: Place) -> bool:
        nonlocal torn
        number, flags, stamped, _, _, is_torn = read(place, full)
        torn += is_torn
        publisher.publish(length, lambda answer: write(answer, number, flags, 0, stamped != 0))
        return False

    subscriber = peer.subscriber(channel("bench/ping", trips), message)
    send("ready")
    while not end.is_set():
        subscriber.pump(now_ns() + 250_000_000)
    return {"round_trips": {"round_trip_ns": spread([]), "one_way_ns": spread([]), "torn": torn}}


def main() -> None:
    """Runs the job, and reports its outcome."""
    job = json.loads(sys.argv[1])
    if job["core"] is not None:
        os.sched_setaffinity(0, {job["core"]})
    threading.Thread(target=listen, daemon=True).start()
    domain = job["domain"]
    open_peer = lambda name, first: PEERS[domain["peer"]](domain, name, first)
    ((role, details),) = job["role"].items()
    roles = {"Publisher": publish, "Subscriber": subscribe, "Ping": ping, "Echo": echo}
    try:
        outcome = roles[role](open_peer, details)
    except Exception as error:
        send({"failed": {"reason": f"{type(error).__name__}: {error}"}})
        raise
    send({"done": outcome})
    # Subscribers read from this process' memory until the director ends it.
    end.wait()
    sys.stdout.flush()
    # Threads of the middlewares may wait for ever.
    os._exit(0)


if __name__ == "__main__":
    main()
