"""Fork, the end of the interpreter, exceptions, and the log."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import SOON, Child, linked, received, until

import sm2

FORK = """
import os, sm2, warnings
# Python 3.12 and newer warn of a fork with threads.
warnings.simplefilter("ignore")
from helpers import SOON, linked, received
node = sm2.Node("parent")
publisher, subscriber = linked(node, "topic", "u1", {}, {})
publisher.publish([1] * 100_000)
publisher.publish([2] * 100_000)
sample = received(subscriber)
view = sample.value
server, client = node.server("service"), node.client("service")
client.wait_for_servers(1, SOON)
call = client.send(b"request")
request = server.recv(SOON)
child = os.fork()
if child == 0:
    uses = [
        lambda: publisher.publish([1]),
        lambda: publisher.loan(10),
        lambda: subscriber.take(),
        lambda: subscriber.recv(SOON),
        lambda: subscriber.fileno(),
        lambda: publisher.wait_for_subscribers(1),
        lambda: node.publisher("other"),
        lambda: node.is_connected,
        lambda: memoryview(sample),
        lambda: sample.value,
        lambda: request.reply(b""),
        lambda: call.wait(),
        lambda: client.send(b""),
        lambda: server.take(),
    ]
    refused = 0
    for use in uses:
        try:
            use()
        except sm2.ForkError as error:
            refused += "that forked this one" in str(error)
    # A view keeps its memory, and no drop reaches the parent.
    assert (view == 1).all()
    del sample, view, request, call
    subscriber.close()
    publisher.close()
    node.close()
    del subscriber, publisher, server, client, node
    # A node of its own works.
    with sm2.Node("child") as own:
        assert own.is_connected
        one, other = linked(own, "own", "u1", {}, {})
        one.publish([3])
        assert received(other).value[0] == 3
    print("refused", refused == len(uses), flush=True)
    raise SystemExit(0)
assert os.waitpid(child, 0)[1] == 0
assert (view == 1).all()
request.reply(b"reply")
assert call.wait() == b"reply"
assert received(subscriber).value[0] == 2
for number in range(100):
    with publisher.loan(100_000) as array:
        array[:] = number
    assert (received(subscriber).value == number).all()
assert (view == 1).all() and subscriber.held == (1, 1)
print("parent")
"""


def test_a_forked_child_gets_errors_and_harms_nobody(
    domain: Child, child: Callable[[str], Child]
) -> None:
    assert child(FORK).wait() == (0, "refused True\nparent\n", "")


WORKER = """
import multiprocessing, sm2, time, warnings
# Python 3.12 and newer warn of a fork with threads.
warnings.simplefilter("ignore")
from helpers import SOON, received
node = sm2.Node("registrant")
subscriber = node.subscriber("topic", str)
worker = multiprocessing.get_context("fork").Process(target=time.sleep, args=(10 * SOON,))
worker.start()
print(worker.pid, flush=True)
print(received(subscriber).value, flush=True)
input()
"""


def test_a_worker_does_not_keep_the_session_of_its_parent(
    node: sm2.Node, child: Callable[[str], Child]
) -> None:
    publisher = node.publisher("topic", str)
    parent = child(WORKER)
    worker = int(parent.line())
    try:
        publisher.wait_for_subscribers(1, SOON)
        publisher.publish("hello")
        assert parent.line() == "hello"
        parent.signal(signal.SIGKILL)
        until(lambda: publisher.publish("?").links == 0, "the end of the link")
        with sm2.Node("registrant") as again:
            assert again.is_connected
        # The worker lives, and has all descriptors of its parent.
        os.kill(worker, 0)
    finally:
        os.kill(worker, signal.SIGKILL)


EXITS = {
    "open": "pass",
    "held sample": "keep = sample; array = sample.value",
    "exception": "raise SystemExit(0)",
    "open loan": "loan = publisher.loan(100_000); array = loan.__enter__()",
    "cycle": "class A: pass\na = A(); a.a = a; a.node = node; a.subscriber = subscriber; a.view = sample.value",
    "closed": "node.close()",
    "daemon threads": """
import threading
def wait(): subscriber.recv()
def send():
    while True: publisher.publish([1] * 10)
other = node.server("service")
def serve(): other.recv()
for it in (wait, send, serve): threading.Thread(target=it, daemon=True).start()
# The threads want the GIL while the interpreter ends.
import time
class Slow:
    def __del__(self): time.sleep(0.5)
slow = Slow(); slow.itself = slow
""",
    "asyncio": """
import asyncio
async def wait(): await subscriber.__anext__()
async def main(): asyncio.ensure_future(wait()); await asyncio.sleep(0)
asyncio.run(main())
""",
}

EXIT = """
import sm2, sys
from helpers import linked, received
node = sm2.Node("ending", standby_manager=%r)
publisher, subscriber = linked(node, "topic", "u1", {}, {})
publisher.publish([1] * 100_000)
sample = received(subscriber)
print("there", flush=True)
%s
"""


@pytest.mark.parametrize("standby", [False, True])
@pytest.mark.parametrize("name", EXITS)
def test_the_interpreter_ends_cleanly(
    domain: Child, child: Callable[[str], Child], name: str, standby: bool
) -> None:
    assert child(EXIT % (standby, EXITS[name])).wait() == (0, "there\n", "")


def test_a_node_brings_its_own_manager(tmp_path: Path) -> None:
    socket = tmp_path / "own"
    with pytest.raises(sm2.ConnectError, match="no Manager at .* start one with 'sm2 manager'"):
        sm2.Node("one", socket=socket)
    with sm2.Node("one", socket=socket, standby_manager=True) as one:
        with sm2.Node("two", socket=socket, standby_manager=True) as two:
            with pytest.raises(sm2.ConnectError, match="another node of this domain is named two"):
                sm2.Node("two", socket=socket)
            publisher = two.publisher("topic", "u1")
            one.close()
            # The Manager of the second node takes over.
            two.wait_connected(SOON)
            subscriber = two.subscriber("topic", "u1")
            publisher.wait_for_subscribers(1, SOON)
            publisher.publish(np.ones(10, "u1"))
            assert received(subscriber).value.sum() == 10
    assert not socket.exists()


def test_quality_of_service(node: sm2.Node) -> None:
    publisher = node.publisher("map", str, latched=2, reliable=True, deadline=100.0, lifespan=1000.0)
    for text in ["a", "b", "c"]:
        publisher.publish(text)
    assert publisher.unheard == 3
    late = node.subscriber("map", str, reliable=True, deadline=200.0)
    assert [received(late).value for _ in range(2)] == ["b", "c"]
    assert publisher.flush(SOON) and publisher.wait_for_room(SOON)
    assert publisher.counters["delivered"] == 2
    demanding = node.subscriber("map", str, deadline=50.0)
    assert demanding.matched == 0 and "deadline" in demanding.why()[0]
    with pytest.raises(sm2.DeclareError, match="depth"):
        node.subscriber("map", str, keep_last=0)
    with pytest.raises(TypeError, match="unknown option depht"):
        node.publisher("map", str, depht=3)  # type: ignore[call-overload]


def test_a_reliable_subscriber_without_room_misses_the_message(node: sm2.Node) -> None:
    publisher, subscriber = linked(
        node, "topic", "u1", {"reliable": True}, {"reliable": True, "keep_last": 1, "max_borrowed": 1}
    )
    while publisher.try_publish([1]) is not None:
        pass
    published = publisher.publish([2], timeout=0)
    assert (published.links, published.missed) == (0, 1) and "missed=1" in repr(published)
    assert subscriber.take() is not None


def test_warnings_go_to_logging(
    tmp_path: Path, child: Callable[[str], Child], domain: Child
) -> None:
    program = """
import logging, sm2, sys
logging.basicConfig(format="%(levelname)s %(name)s %(message)s", stream=sys.stdout)
node = sm2.Node("logging")
print("ready", flush=True)
input()
while True:
    node.subscriber("topic").recv(0.01)
    if not node.is_connected: break
try:
    node.wait_connected(0.01)
except sm2.WaitError:
    pass
"""
    logging = child(program)
    assert logging.line() == "ready"
    domain.signal(signal.SIGKILL)
    domain.wait()
    logging.send("go")
    lines: list[str] = []
    while "WARNING sm2" not in "".join(lines):
        lines.append(logging.line())


def test_an_exception_in_a_decoder_is_that_of_the_value(node: sm2.Node) -> None:
    def fail(_: object) -> bytes:
        raise KeyError("mine")

    publisher, subscriber = linked(node, "topic", sm2.MessageType("my/Type", None, bytes, fail), {}, {})
    publisher.publish(b"x")
    sample = received(subscriber)
    with pytest.raises(KeyError, match="mine"):
        sample.value
    assert bytes(sample) == b"x"


def test_two_processes_stopped_and_continued(node: sm2.Node, child: Callable[[str], Child]) -> None:
    listener = child(
        "import sm2\nn = sm2.Node('listener')\ns = n.subscriber('topic', str)\nprint('ready')\n"
        "for sample in s:\n    print(sample.value)\n    if sample.value == 'last': break"
    )
    publisher = node.publisher("topic", str)
    assert listener.line() == "ready"
    publisher.wait_for_subscribers(1, SOON)
    listener.signal(signal.SIGSTOP)
    for number in range(100):
        publisher.publish(str(number))
    publisher.publish("last")
    listener.signal(signal.SIGCONT)
    status, out, errors = listener.wait()
    assert (status, errors) == (0, "") and out.endswith("last\n")
