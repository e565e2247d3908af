"""The part that publishers, subscribers, servers and clients share."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from . import _asyncio
from ._closing import Closing
from ._native import ClosedError, ForkError

if TYPE_CHECKING:
    from ._native import NativeInterface


class Interface(Closing):
    """A publisher, subscriber, server or client. As a context manager, it is closed at the end of the block."""

    def __init__(self, native: NativeInterface) -> None:
        self._interface = native

    @property
    def matched(self) -> int:
        """How many peers the Manager linked at once when it granted this declaration."""
        return self._interface.matched

    @property
    def is_registered(self) -> bool:
        """Whether the current Manager has granted this declaration. False without a Manager."""
        return self._interface.is_registered

    def why(self) -> list[str]:
        """Explains missing links: the peers that come closest to one, with the reasons why they do not match."""
        return self._interface.why()

    def fileno(self) -> int:
        """The descriptor for an event loop: readable when `take` may return something. Watch it level-triggered."""
        return self._interface.fileno()

    def close(self) -> None:
        """Withdraws the declaration. Samples that the program holds stay valid."""
        # A forked child has no waits of its own for the descriptors of its parent.
        with suppress(ClosedError, ForkError):
            _asyncio.closing(self._interface.fileno)
        self._interface.close()

    @property
    def closed(self) -> bool:
        """Whether it is closed."""
        return self._interface.closed
