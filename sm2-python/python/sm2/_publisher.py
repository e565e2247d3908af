"""Sending the messages of a topic."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Generic

import numpy as np
import numpy.typing as npt

from ._interface import Interface
from ._types import Array, MessageType, Plain, T, Values

if TYPE_CHECKING:
    from ._native import Published
    from ._native import Publisher as NativePublisher


#: What a loan of a topic without a dtype holds.
_BYTES = np.dtype("u1")


class Publisher(Interface, Generic[T]):
    """Sends messages to all subscribers of a topic. `Node.publisher` returns one."""

    def __init__(self, native: NativePublisher, type: MessageType[T]) -> None:
        super().__init__(native)
        self._native = native
        self.type = type
        self._dtype: np.dtype[Any] = getattr(type, "dtype", _BYTES)
        lends = (type.schema is None or isinstance(type, Values)) and not self._dtype.hasobject
        # The dtype of loans that need no check.
        self._lent = self._dtype if lends else None

    @property
    def topic(self) -> str:
        """The name of the topic."""
        return self._native.topic

    def publish(self, value: T, *, timeout: float | None = None) -> Published:
        """Sends one message, by one copy into the memory that all subscribers read.

        Waits only if a reliable subscriber has no room, for at most `timeout` (by default the `publish_timeout` of the
        publisher). A subscriber that misses the message is not an error: see `Published.missed`. A signal is handled
        after this wait.
        """
        return self._native.publish(self.type.encode(value), timeout)

    def try_publish(self, value: T) -> Published | None:
        """Sends one message to all subscribers, or to none: then a reliable one has no room, and the result is None."""
        return self._native.try_publish(self.type.encode(value))

    def loan(
        self,
        shape: int | tuple[int, ...] | None = None,
        dtype: npt.DTypeLike | None = None,
    ) -> AbstractContextManager[Array]:
        """A message that is written in place, without a copy::

            with publisher.loan((1080, 1920, 3), "u1") as image:
                image[:] = frame

        The array is memory that the subscribers read. Its first content is unspecified. The message is published at the
        end of the block, unless the block raises an exception. From then on the array is empty and read-only, because
        its memory belongs to the subscribers and then to the next message.

        If anything but the variable of the block still refers to the array or its memory at the end, such as a slice or
        a tensor, a `LoanError` is raised and nothing is published.

        The dtype is that of the topic; on a topic of type `bytes` it can be any, and is `u1` by default. Without a
        shape, the array is one value.
        """
        lent = self._dtype if dtype is None else np.dtype(dtype)
        lengths = () if shape is None else shape
        if lent is not self._lent:
            self._check_loan(self.type, lent, lengths)
        return self._native.loan(lengths, lent, lent.itemsize)

    @staticmethod
    def _check_loan(data: MessageType[Any], lent: np.dtype[Any], shape: int | tuple[int, ...]) -> None:
        if lent.hasobject:
            raise TypeError(f"the dtype {lent} holds references to Python objects, which no other process can use")
        is_raw = data.schema is None
        if not is_raw and not isinstance(data, Plain | Values):
            raise TypeError(f"messages of type {data.name} have to be encoded: use publish")
        if not is_raw and lent != getattr(data, "dtype"):
            raise TypeError(f"a message of type {data.name} has the dtype {getattr(data, 'dtype')}, not {lent}")
        if isinstance(data, Plain) and shape != ():
            raise TypeError(f"a message of type {data.name} is one value: leave out the shape")

    def wait_for_subscribers(self, count: int = 1, timeout: float | None = None) -> None:
        """Waits until at least `count` subscribers are linked. Raises `WaitError` after the timeout."""
        self._native.wait_for_subscribers(count, timeout)

    def wait_for_room(self, timeout: float | None = None) -> bool:
        """Waits until `publish` would not wait. Returns whether there is room."""
        return self._native.wait_for_room(timeout)

    def flush(self, timeout: float | None = None) -> bool:
        """Waits until no message waits in this publisher. Returns whether everything was flushed.

        A reliable subscriber has then released every message. Call this before the program ends: messages that still
        wait are lost.
        """
        return self._native.flush(timeout)

    def assert_liveliness(self) -> None:
        """Asserts that the program is alive, as each publication does: see `liveliness` of `Node.publisher`."""
        self._native.assert_liveliness()

    @property
    def counters(self) -> dict[str, int]:
        """The fates of all messages, summed over all links: `offered` is the sum of the others (SM2-QOS-006)."""
        return self._native.counters

    @property
    def unheard(self) -> int:
        """How many messages were published while no subscriber was linked."""
        return self._native.unheard

    @property
    def missed_deadlines(self) -> int:
        """How many periods of the `deadline` have passed without a message."""
        return self._native.missed_deadlines

    @property
    def lost_liveliness(self) -> int:
        """How often the program showed no sign of life within its `liveliness`."""
        return self._native.lost_liveliness

    @property
    def pool_bytes(self) -> int:
        """The size of the shared memory for its messages."""
        return self._native.pool_bytes
