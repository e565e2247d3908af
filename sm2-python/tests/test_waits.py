"""Waits: Ctrl-C, timeouts, closing, wait sets, timers, threads."""

from __future__ import annotations

import signal
import socket
import threading
import time
from collections.abc import Callable

import pytest
from helpers import SOON, Child, linked, received

import sm2

PROGRAM = """
import signal, sm2
{setup}
try:
    print("waiting")
    {wait}
    print("returned")
except KeyboardInterrupt:
    print("interrupted")
# Everything still works.
with sm2.Node("after") as after:
    publisher = after.publisher("after", str)
    publisher.publish("there")
print("end")
"""

NODE = "node = sm2.Node('waiting')"

WAITS = {
    "recv": ("subscriber = node.subscriber('t')", "subscriber.recv()"),
    "recv_timeout": ("subscriber = node.subscriber('t')", f"subscriber.recv({SOON})"),
    "iteration": ("subscriber = node.subscriber('t')", "next(iter(subscriber))"),
    "server": ("server = node.server('s')", "server.recv()"),
    "subscribers": ("publisher = node.publisher('t')", "publisher.wait_for_subscribers(1)"),
    "publishers": ("subscriber = node.subscriber('t')", "subscriber.wait_for_publishers(1)"),
    "servers": ("client = node.client('s')", "client.wait_for_servers(1)"),
    "clients": ("server = node.server('s')", "server.wait_for_clients(1)"),
    "call": (
        "server = node.server('s'); client = node.client('s'); client.wait_for_servers(1)",
        "client.call(b'')",
    ),
    "flush": (
        "p = node.publisher('t', reliable=True); s = node.subscriber('t', reliable=True); "
        "p.wait_for_subscribers(1); p.publish(b'x')",
        "p.flush()",
    ),
    "room": (
        "p = node.publisher('t', reliable=True); s = node.subscriber('t', reliable=True, keep_last=1, max_borrowed=1); "
        "p.wait_for_subscribers(1)\nwhile p.try_publish(b'x') is not None: pass",
        "p.wait_for_room()",
    ),
    "startup": (
        "import os; os.environ['SM2_SOCKET'] += '.other'",
        f"sm2.Node('other', startup_timeout={SOON})",
    ),
    "wait_set": (
        "w = sm2.WaitSet(); s = node.subscriber('t'); w.add(s); w.add(sm2.Timer.once(1e6)); s.take()",
        "\n    while w.wait() == [s]: s.take()",
    ),
    "timer": ("timer = sm2.Timer.once(1e6)", "timer.sleep()"),
    # A loop that is interrupted while it is made, or before its task runs, reports errors of its own.
    "asyncio": (
        "import asyncio; subscriber = node.subscriber('t')",
        "\n    async def main():\n        print('waiting')\n        await subscriber.__anext__()\n    asyncio.run(main())",
    ),
}


@pytest.mark.parametrize("name", WAITS)
def test_ctrl_c_ends_the_wait(domain: Child, child: Callable[[str], Child], name: str) -> None:
    setup, wait = WAITS[name]
    text = PROGRAM.format(setup=f"{NODE}\n{setup}", wait=wait)
    if name == "startup":
        # The domain of the other node has no Manager.
        text = text.replace("with sm2.Node", "os.environ['SM2_SOCKET'] = os.environ['SM2_SOCKET'][:-6]\nwith sm2.Node")
    waiting = child(text)
    assert waiting.line() == "waiting"
    if name == "asyncio":
        assert waiting.line() == "waiting"
    # A signal before the wait begins ends the program in the same way.
    waiting.signal(signal.SIGINT)
    assert waiting.wait() == (0, "interrupted\nend\n", "")


def test_ctrl_c_ends_the_wait_for_a_manager_that_is_stopped(
    domain: Child, child: Callable[[str], Child]
) -> None:
    declaring = child(
        """
import sm2
node = sm2.Node("declaring", manager_timeout=1e6)
print("connected")
input()
try:
    print("waiting")
    node.publisher("topic")
except KeyboardInterrupt:
    print("interrupted")
"""
    )
    assert declaring.line() == "connected"
    domain.signal(signal.SIGSTOP)
    declaring.send("go")
    assert declaring.line() == "waiting"
    declaring.signal(signal.SIGINT)
    assert declaring.line() == "interrupted"
    domain.signal(signal.SIGCONT)
    assert declaring.wait() == (0, "", "")


def test_timeouts(node: sm2.Node) -> None:
    subscriber = node.subscriber("topic")
    server = node.server("service")
    assert subscriber.recv(0) is None and server.recv(0.01) is None and subscriber.take() is None
    with pytest.raises(sm2.WaitError, match="timed out with 0 of 1 publishers linked"):
        subscriber.wait_for_publishers(1, 0.01)
    with pytest.raises(ValueError):
        subscriber.recv(-1)
    with pytest.raises(ValueError):
        subscriber.recv(float("nan"))


def test_a_thread_that_waits_lets_others_run_and_gets_the_message(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "topic", bytes, {}, {})
    samples: list[sm2.Sample[bytes]] = []
    threads = [threading.Thread(target=lambda: samples.append(received(subscriber))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for _ in threads:
        publisher.publish(b"there")
    for thread in threads:
        thread.join(SOON)
        assert not thread.is_alive()
    assert sorted(it.sequence for it in samples) == [1, 2, 3]


def test_closing_ends_the_wait_of_another_thread(node: sm2.Node) -> None:
    subscriber = node.subscriber("topic")
    errors: list[BaseException] = []

    def wait() -> None:
        try:
            subscriber.recv()
        except sm2.ClosedError as error:
            errors.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    node.close()
    thread.join(SOON)
    assert not thread.is_alive() and str(errors[0]) == "this subscriber is closed"
    assert subscriber.closed and node.closed
    for call in [subscriber.take, subscriber.fileno, subscriber.why, lambda: node.publisher("t")]:
        with pytest.raises(sm2.ClosedError):
            call()
    subscriber.close()


def test_many_threads_publish_and_receive(node: sm2.Node) -> None:
    topics = [linked(node, f"topic{it}", "u4", {"reliable": True, "publish_timeout": SOON, "wait_share_percent": 100},
                     {"reliable": True}) for it in range(4)]
    failures: list[BaseException] = []

    def send(publisher: sm2.Publisher[object]) -> None:
        try:
            for number in range(200):
                with publisher.loan(5000) as array:
                    array[:] = number
        except BaseException as error:
            failures.append(error)

    def take(subscriber: sm2.Subscriber[object]) -> None:
        try:
            for number in range(200):
                array = received(subscriber).numpy("u4")
                assert (array == number).all()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=send, args=(it[0],)) for it in topics]
    threads += [threading.Thread(target=take, args=(it[1],)) for it in topics]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(2 * SOON)
        assert not thread.is_alive()
    assert not failures


def test_a_wait_set_reports_what_is_ready(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "topic", bytes, {}, {})
    server = node.server("service")
    client = node.client("service")
    client.wait_for_servers(1, SOON)
    one, other = socket.socketpair()
    with sm2.WaitSet() as wait_set, one, other:
        for source in (subscriber, server, one):
            wait_set.add(source)
        publisher.publish(b"message")
        while subscriber not in wait_set.wait(SOON):
            server.take()
        assert subscriber.take() is not None
        calls = [client.send(text, SOON) for text in (b"one", b"two")]
        for call in calls:
            wait_set.add(call)
        for _ in calls:
            while (request := server.take()) is None:
                assert wait_set.wait(SOON)
                subscriber.take()
            request.reply(request.value + b"!")
        replies = []
        while len(replies) < 2:
            for source in wait_set.wait(SOON):
                if source in calls and (reply := source.take()) is not None:
                    replies.append(reply)
                    wait_set.remove(source)
            server.take()
        assert sorted(replies) == [b"one!", b"two!"]
        other.send(b"x")
        while one not in wait_set.wait(SOON):
            server.take(), subscriber.take()
        with pytest.raises(KeyError):
            wait_set.remove(call)


def test_timers_do_not_drift(node: sm2.Node) -> None:
    timer = sm2.Timer.every(0.005, burst=True)
    ticks = [tick for tick, _ in zip(timer, range(20))]
    assert [it.number for it in ticks] == list(range(1, 21))
    assert all(b.due_ns - a.due_ns == 5_000_000 for a, b in zip(ticks, ticks[1:]))
    assert time.monotonic_ns() >= ticks[-1].due_ns
    once = sm2.Timer.once(0.001)
    assert len(list(once)) == 1 and once.deadline_ns is None
    with sm2.WaitSet() as wait_set:
        timer = sm2.Timer.hz(1000)
        wait_set.add(timer)
        assert wait_set.wait(SOON) == [timer] and timer.take() is not None
        wait_set.remove(timer)
        assert wait_set.wait(0) == []
