"""Servers and clients."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable

import pytest
from helpers import SOON, Child

import sm2


def serving(
    server: sm2.Server[bytes, bytes],
    answer: Callable[[sm2.Request[bytes, bytes]], None],
    count: int,
) -> threading.Thread:
    """A thread that answers some requests."""

    def serve() -> None:
        for _ in range(count):
            request = server.recv(SOON)
            assert request is not None
            answer(request)

    thread = threading.Thread(target=serve)
    thread.start()
    return thread


@pytest.mark.parametrize("len_bytes", [0, 10, 10_000, 3_000_000])
def test_a_call_gets_its_reply(node: sm2.Node, len_bytes: int) -> None:
    server = node.server("echo")
    client = node.client("echo")
    client.wait_for_servers(1, SOON)
    thread = serving(server, lambda it: it.reply(it.value[::-1]), 3)
    for _ in range(3):
        value = bytes(range(250)) * (len_bytes // 250)
        assert client.call(value, SOON) == value[::-1]
    thread.join(SOON)


def test_a_failure_has_its_reason(node: sm2.Node) -> None:
    server = node.server("divide")
    client = node.client("divide")
    client.wait_for_servers(1, SOON)
    thread = serving(server, lambda it: it.fail("by zero"), 1)
    with pytest.raises(sm2.CallError, match="the server of divide failed: by zero"):
        client.call(b"", SOON)
    thread.join(SOON)
    thread = serving(server, lambda it: None, 1)
    with pytest.raises(sm2.CallError, match="dropped the request"):
        client.call(b"", SOON)
    thread.join(SOON)


def test_a_request_is_answered_once(node: sm2.Node) -> None:
    server = node.server("echo")
    client = node.client("echo")
    client.wait_for_servers(1, SOON)
    call = client.send(b"hello", SOON)
    request = server.recv(SOON)
    assert request is not None and request.client == "test" and request.deadline_ns is not None
    assert not request.is_cancelled
    request.reply(b"there")
    assert call.wait() == b"there" and request.value == b"hello"
    for again in [lambda: request.reply(b""), lambda: request.fail("")]:
        with pytest.raises(sm2.ClosedError):
            again()
    with pytest.raises(sm2.ClosedError):
        call.take()


def test_a_cancelled_call_ends(node: sm2.Node) -> None:
    server = node.server("slow")
    client = node.client("slow")
    client.wait_for_servers(1, SOON)
    call = client.send(b"", SOON)
    request = server.recv(SOON)
    assert request is not None
    call.cancel()
    with pytest.raises(sm2.CallError, match="cancelled"):
        while not request.is_cancelled:
            call.take()
        del request
        call.wait()


def test_no_server_and_a_call_that_is_too_late(node: sm2.Node) -> None:
    client = node.client("nothing")
    with pytest.raises(sm2.CallError, match="has no server"):
        client.call(b"")
    server = node.server("nothing")
    client.wait_for_servers(1, SOON)
    with pytest.raises(sm2.CallError, match="did not reply before the deadline"):
        client.call(b"", 0.01)
    server.close()


def test_a_call_fails_at_once_when_its_server_is_killed(
    node: sm2.Node, child: Callable[[str], Child]
) -> None:
    client = node.client("service")
    program = "import sm2; n = sm2.Node('server'); s = n.server('service'); r = s.recv(); print('got'); input()"
    server = child(program)
    client.wait_for_servers(1, SOON)
    call = client.send(b"")
    assert server.line() == "got"
    server.signal(signal.SIGKILL)
    with pytest.raises(sm2.CallError, match="ended before it replied"):
        call.wait()
