"""Views that outlive their sample, subscriber, node, publisher and Manager."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from helpers import SOON, Child, limit_from_now, linked, received, seeded, until

import sm2

#: How many random orders of drops are tried.
ORDERS = int(os.environ.get("SM2_PYTHON_ORDERS", "300"))


def descriptors() -> int:
    """How many descriptors the process has."""
    return len(os.listdir("/proc/self/fd"))


def mappings() -> int:
    """How many mappings of shared memory the process has."""
    with open("/proc/self/maps") as maps:
        return sum("/memfd:" in line for line in maps)


def views_of(sample: sm2.Sample[Any], random: Random) -> list[Any]:
    """Some views of a sample, of random kinds."""
    kinds: list[Callable[[], Any]] = [
        lambda: sample.numpy(),
        lambda: sample.numpy("u1", (-1, 4))[:, 1:],
        lambda: memoryview(sample),
        lambda: memoryview(sample)[4:],
        lambda: np.from_dlpack(sample),
        lambda: np.asarray(memoryview(sample.numpy())),
        lambda: sample.value,
    ]
    return [random.choice(kinds)() for _ in range(random.randrange(1, 5))]


def one_order(folder: Path, random: Random) -> None:
    """Makes a domain with samples and views, and drops everything in a random order."""
    socket = folder / "order"
    manager = sm2.Node("manager", standby_manager=True, socket=socket)
    nodes = [sm2.Node(name, socket=socket) for name in ("sender", "receiver")]
    len_bytes = random.choice([64, 4096, 65_536, 3_000_000])
    sealed = random.random() < 0.2
    publisher = nodes[0].publisher("topic", "u1", sealed=sealed)
    subscriber = nodes[1].subscriber("topic", "u1", max_borrowed=3)
    publisher.wait_for_subscribers(1, SOON)
    held: list[tuple[int, Any]] = []
    for number in range(random.randrange(1, 4)):
        with publisher.loan(len_bytes) as array:
            array[:] = number
        sample = received(subscriber)
        held += [(number, view) for view in views_of(sample, random)]
        if random.random() < 0.5:
            held.append((number, sample))
        del sample
    others: list[Any] = [manager, *nodes, publisher, subscriber, array]
    del manager, nodes, array
    while held or others:
        if random.random() < 0.5 and others:
            dropped = others.pop(random.randrange(len(others)))
            if random.random() < 0.5 and hasattr(dropped, "close"):
                dropped.close()
            del dropped
        elif held:
            held.pop(random.randrange(len(held)))
        # While the publisher lives, it goes on using its memory.
        if not publisher.closed and random.random() < 0.3:
            publisher.publish(np.full(len_bytes, 200, "u1"))
        for number, view in held:
            assert np.all(np.frombuffer(view, "u1") == number) if contiguous(view) else np.all(view == number)
    publisher.close()


def contiguous(view: Any) -> bool:
    """Whether the view has a buffer without gaps."""
    return memoryview(view).c_contiguous


def test_random_orders(tmp_path: Path) -> None:
    random = seeded()
    for _ in range(5):
        one_order(tmp_path, random)
    gc.collect()
    before = descriptors(), mappings()
    for number in range(ORDERS):
        limit_from_now()
        state = random.getrandbits(64)
        try:
            one_order(tmp_path, Random(state))
        except BaseException:
            print(f"order {number}: one_order(folder, Random({state}))")
            raise
    gc.collect()
    assert (descriptors(), mappings()) == before


PUBLISHER = """
import numpy as np, signal, sm2, sys
node = sm2.Node("camera")
publisher = node.publisher("image", "u1", latched=3, sealed=%r)
for number in range(3):
    publisher.publish(np.full(3_000_000, number + 1, "u1"))
print("ready")
sys.stdin.read()
"""


@pytest.mark.parametrize("sealed", [False, True])
def test_views_outlive_a_killed_publisher(
    node: sm2.Node, child: Callable[[str], Child], sealed: bool
) -> None:
    subscriber = node.subscriber("image", "u1")
    camera = child(PUBLISHER % sealed)
    assert camera.line() == "ready"
    views = [received(subscriber).value for _ in range(3)]
    camera.signal(signal.SIGKILL)
    camera.wait()

    def has_no_publisher() -> bool:
        try:
            subscriber.wait_for_publishers(1, 0)
        except sm2.WaitError:
            return True
        return False

    until(has_no_publisher, "the end of the link")
    for number, view in enumerate(views):
        assert np.all(view == number + 1)
    subscriber.close()
    node.close()
    for number, view in enumerate(views):
        assert np.all(view == number + 1)


def test_messages_go_on_while_the_manager_is_replaced(
    domain: Child, node: sm2.Node, child: Callable[[str], Child]
) -> None:
    publisher, subscriber = linked(node, "topic", "u1", {}, {})
    view = None
    domain.signal(signal.SIGKILL)
    domain.wait()
    for number in range(100):
        publisher.publish(np.full(100_000, number, "u1"))
        view = received(subscriber).value
        assert np.all(view == number)
    successor = child("import sm2, sys; n = sm2.Node('next', standby_manager=True); print('ready'); sys.stdin.read()")
    assert successor.line() == "ready"
    node.wait_connected(SOON)
    other = node.subscriber("topic", "u1")
    publisher.wait_for_subscribers(2, SOON)
    publisher.publish(np.full(10, 7, "u1"))
    assert np.all(received(other).value == 7) and np.all(view == 99)


def test_the_borrow_limit_names_topic_samples_and_views(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "image", "u1", {}, {"max_borrowed": 2})
    for number in range(3):
        publisher.publish(np.full(100_000, number, "u1"))
    arrays = [received(subscriber).numpy() for _ in range(2)]
    arrays.append(arrays[0][10:])
    more = memoryview(arrays[0].base)
    assert subscriber.held == (2, 2)
    with pytest.raises(sm2.BorrowLimitError) as caught:
        subscriber.take()
    text = str(caught.value)
    assert "holds 2 messages of node test, as many as max_borrowed allows" in text
    assert "topic image: 2 samples are held; 2 views" in text
    del arrays, more
    assert subscriber.held == (0, 0)
    assert received(subscriber).sequence == 3


def test_a_view_keeps_its_memory_from_the_next_messages(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "image", "u1", {}, {})
    publisher.publish(np.full(100_000, 1, "u1"))
    view = received(subscriber).value
    addresses = set()
    for number in range(50):
        publisher.publish(np.full(100_000, 2, "u1"))
        other = received(subscriber).value
        addresses.add(other.ctypes.data)
        del other
    assert view.ctypes.data not in addresses and np.all(view == 1)
