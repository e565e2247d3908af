"""Receiving the messages of a topic."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from typing import TYPE_CHECKING, Generic, overload

from . import _asyncio
from ._interface import Interface
from ._types import MessageType, T

if TYPE_CHECKING:
    from ._native import Sample
    from ._native import Subscriber as NativeSubscriber


class Subscriber(Interface, Generic[T]):
    """Receives the messages of a topic. `Node.subscriber` returns one.

    It is an iterator, and an asynchronous one, which waits for each sample::

        for sample in subscriber:
            print(sample.publisher, sample.value)

    A message is borrowed until its sample and all views of it are gone. While the program holds `max_borrowed` messages
    of a publisher, it gets no further ones of it: `BorrowLimitError`. Messages of up to 104 bytes usually are copies,
    which are not borrowed.
    """

    def __init__(self, native: NativeSubscriber, type: MessageType[T]) -> None:
        super().__init__(native)
        self._native = native
        self.type = type

    @property
    def topic(self) -> str:
        """The name of the topic."""
        return self._native.topic

    def take(self) -> Sample[T] | None:
        """The next message, if one has arrived. Never waits."""
        return self._native.take()

    @overload
    def recv(self, timeout: None = None) -> Sample[T]: ...

    @overload
    def recv(self, timeout: float) -> Sample[T] | None: ...

    def recv(self, timeout: float | None = None) -> Sample[T] | None:
        """Waits for the next message; None after the timeout. Waits also for a publisher, and for a Manager."""
        return self._native.recv(timeout)

    def __iter__(self) -> Iterator[Sample[T]]:
        return self

    def __next__(self) -> Sample[T]:
        return self.recv()

    def __aiter__(self) -> AsyncIterator[Sample[T]]:
        return self

    async def __anext__(self) -> Sample[T]:
        while (sample := self._native.take()) is None:
            await _asyncio.readable(self._native.fileno())
        return sample

    def wait_for_publishers(self, count: int = 1, timeout: float | None = None) -> None:
        """Waits until at least `count` publishers are linked. Raises `WaitError` after the timeout."""
        self._native.wait_for_publishers(count, timeout)

    @property
    def held(self) -> tuple[int, int]:
        """How many samples the program holds, and how many views of their memory it has."""
        return self._native.held

    @property
    def lost(self) -> int:
        """How many messages were lost, of all publishers together."""
        return self._native.lost

    @property
    def missed_deadlines(self) -> int:
        """How many periods of the `deadline` have passed without a message, of all publishers together."""
        return self._native.missed_deadlines

    @property
    def lost_liveliness(self) -> int:
        """How often publishers stopped being alive, of all publishers together."""
        return self._native.lost_liveliness
