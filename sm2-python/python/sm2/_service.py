"""Calling services, and answering calls."""

from __future__ import annotations

from collections.abc import AsyncIterator, Generator, Iterator
from typing import TYPE_CHECKING, Any, Generic, TypeVar, overload

from . import _asyncio
from ._interface import Interface
from ._native import CallError
from ._types import MessageType

if TYPE_CHECKING:
    from ._native import Call as NativeCall
    from ._native import Client as NativeClient
    from ._native import Request as NativeRequest
    from ._native import Server as NativeServer

Q = TypeVar("Q")
R = TypeVar("R")


class Server(Interface, Generic[Q, R]):
    """Receives the requests of a service. `Node.server` returns one. It is an iterator, and an asynchronous one::

        for request in server:
            request.reply(sum(request.value))
    """

    def __init__(self, native: NativeServer, request: MessageType[Q], reply: MessageType[R]) -> None:
        super().__init__(native)
        self._native = native
        self.request_type = request
        self.reply_type = reply

    @property
    def service(self) -> str:
        """The name of the service."""
        return self._native.service

    def _request(self, native: NativeRequest) -> Request[Q, R]:
        return Request(native, self.request_type, self.reply_type)

    def take(self) -> Request[Q, R] | None:
        """The next request, if one has arrived. Never waits."""
        native = self._native.take()
        return None if native is None else self._request(native)

    @overload
    def recv(self, timeout: None = None) -> Request[Q, R]: ...

    @overload
    def recv(self, timeout: float) -> Request[Q, R] | None: ...

    def recv(self, timeout: float | None = None) -> Request[Q, R] | None:
        """Waits for the next request; None after the timeout."""
        native = self._native.recv(timeout)
        return None if native is None else self._request(native)

    def __iter__(self) -> Iterator[Request[Q, R]]:
        return self

    def __next__(self) -> Request[Q, R]:
        return self.recv()

    def __aiter__(self) -> AsyncIterator[Request[Q, R]]:
        return self

    async def __anext__(self) -> Request[Q, R]:
        while (request := self.take()) is None:
            await _asyncio.readable(self._native.fileno())
        return request

    def wait_for_clients(self, count: int = 1, timeout: float | None = None) -> None:
        """Waits until at least `count` clients are linked. Raises `WaitError` after the timeout."""
        self._native.wait_for_clients(count, timeout)


class Request(Generic[Q, R]):
    """A request. Its client waits for the answer; if the request is dropped without one, the call fails."""

    def __init__(self, native: NativeRequest, request: MessageType[Q], reply: MessageType[R]) -> None:
        self._native = native
        self._type = request
        self._reply_type = reply

    @property
    def value(self) -> Q:
        """The message."""
        return self._type.decode(self._native.data)

    @property
    def client(self) -> str:
        """The name of the client's node."""
        return self._native.client

    @property
    def deadline_ns(self) -> int | None:
        """The time of `time.monotonic_ns()` after which the reply is not wanted any more."""
        return self._native.deadline_ns

    @property
    def is_cancelled(self) -> bool:
        """Whether the reply is not wanted any more. Check this now and then during long work."""
        return self._native.is_cancelled

    def reply(self, value: R) -> None:
        """Sends the reply. Never waits. Raises `ReplyError` if the client is gone."""
        self._native.reply(self._reply_type.encode(value))

    def fail(self, reason: str) -> None:
        """Answers that the request failed. The client gets a `CallError` with the reason."""
        self._native.fail(reason)


class Client(Interface, Generic[Q, R]):
    """Calls the servers of a service. `Node.client` returns one."""

    def __init__(self, native: NativeClient, request: MessageType[Q], reply: MessageType[R]) -> None:
        super().__init__(native)
        self._native = native
        self.request_type = request
        self.reply_type = reply

    @property
    def service(self) -> str:
        """The name of the service."""
        return self._native.service

    def call(self, value: Q, timeout: float | None = None) -> R:
        """Sends a request and waits for the reply. Raises `CallError` if there is none within the timeout."""
        return self.send(value, timeout).wait()

    async def call_async(self, value: Q, timeout: float | None = None) -> R:
        """As `call`, in an asyncio loop. Waits without the loop only while the link to the first server opens."""
        return await self.send(value, timeout)

    def send(self, value: Q, timeout: float | None = None) -> Call[R]:
        """Sends a request. The result waits for its reply, for at most `timeout` from now."""
        return Call(self._native.send(self.request_type.encode(value), timeout), self.reply_type)

    def wait_for_servers(self, count: int = 1, timeout: float | None = None) -> None:
        """Waits until at least `count` servers are linked. Raises `WaitError` after the timeout."""
        self._native.wait_for_servers(count, timeout)


class Call(Generic[R]):
    """A pending call. If it is dropped, it is cancelled. In an asyncio loop, `await` returns the reply."""

    def __init__(self, native: NativeCall, reply: MessageType[R]) -> None:
        self._native = native
        self._reply_type = reply

    def take(self) -> R | None:
        """The reply, if it has arrived. After a reply or an error there is no further result."""
        data = self._native.take()
        return None if data is None else self._reply_type.decode(data)

    def wait(self) -> R:
        """Waits for the reply until the call's timeout. Raises `CallError` if there is none."""
        data = self._native.wait(None)
        if data is None:
            raise CallError("the call has no reply")
        return self._reply_type.decode(data)

    def cancel(self) -> None:
        """Cancels the call at the server."""
        self._native.cancel()

    def fileno(self) -> int:
        """The descriptor of its client: readable when `take` may return something."""
        return self._native.fileno()

    def __await__(self) -> Generator[Any, None, R]:
        return self._reply().__await__()

    async def _reply(self) -> R:
        while (data := self._native.take()) is None:
            await _asyncio.readable(self._native.fileno())
        return self._reply_type.decode(data)
