"""Waiting for several things, and for the next tick."""

from __future__ import annotations

import selectors
import time
from collections.abc import Iterator
from typing import Any, Protocol

from . import _native
from ._closing import Closing
from ._native import Tick


class Waitable(Protocol):
    """Something with a descriptor: a subscriber, a server, a call, a socket, a pipe."""

    def fileno(self) -> int:
        """The number of the descriptor."""


class Timer:
    """Ticks at regular times, which do not drift: tick `n` is due `n` periods after the start.

    It is an iterator that sleeps until each tick, or a source of a `WaitSet`.
    """

    def __init__(self, native: _native.Timer) -> None:
        self._native = native

    @classmethod
    def every(cls, period: float, *, burst: bool = False) -> Timer:
        """Ticks once in each period. Ticks that the program was too late for are skipped; with `burst`, none is."""
        return cls(_native.Timer.every(period, burst))

    @classmethod
    def hz(cls, frequency: int, *, burst: bool = False) -> Timer:
        """Ticks `frequency` times in each second."""
        return cls(_native.Timer.hz(frequency, burst))

    @classmethod
    def once(cls, delay: float) -> Timer:
        """Ticks once."""
        return cls(_native.Timer.once(delay))

    @property
    def deadline_ns(self) -> int | None:
        """The time of the next tick, by `time.monotonic_ns()`; None if there is none."""
        return self._native.deadline_ns

    def take(self) -> Tick | None:
        """The tick that is due, if one is. Never waits."""
        return self._native.take()

    def sleep(self) -> Tick | None:
        """Sleeps until the next tick; None if there is none."""
        while (deadline_ns := self._native.deadline_ns) is not None:
            tick = self._native.take()
            if tick is not None:
                return tick
            time.sleep(max(deadline_ns - time.monotonic_ns(), 0) / 1e9)
        return None

    def __iter__(self) -> Iterator[Tick]:
        return self

    def __next__(self) -> Tick:
        tick = self.sleep()
        if tick is None:
            raise StopIteration
        return tick


class WaitSet(Closing):
    """Waits for subscribers, servers, calls, timers, and everything else with a descriptor that becomes readable::

        wait_set = sm2.WaitSet()
        wait_set.add(scans)
        wait_set.add(timer)
        while True:
            for source in wait_set.wait():
                ...

    A source is reported as long as it may have something: call its `take` until it returns None. A set is for one
    thread.
    """

    def __init__(self) -> None:
        self._selector = selectors.EpollSelector()
        #: The sources by descriptor: all calls of a client have the same one.
        self._sources: dict[int, list[Waitable]] = {}
        self._timers: list[Timer] = []

    def add(self, source: Waitable | Timer) -> None:
        """Adds a source. Remove it before it is closed."""
        if isinstance(source, Timer):
            self._timers.append(source)
            return
        descriptor = source.fileno()
        if descriptor not in self._sources:
            self._selector.register(descriptor, selectors.EVENT_READ)
        self._sources.setdefault(descriptor, []).append(source)

    def remove(self, source: Waitable | Timer) -> None:
        """Removes a source. Raises KeyError if it is not in the set."""
        if isinstance(source, Timer) and source in self._timers:
            self._timers.remove(source)
            return
        for descriptor, sources in self._sources.items():
            if source in sources:
                sources.remove(source)
                if not sources:
                    del self._sources[descriptor]
                    self._selector.unregister(descriptor)
                return
        raise KeyError(f"{source!r} is not in the set")

    def wait(self, timeout: float | None = None) -> list[Any]:
        """Waits until sources are ready, and returns them; an empty list after the timeout."""
        end_ns = None if timeout is None else time.monotonic_ns() + int(timeout * 1e9)
        while True:
            deadlines_ns = [it.deadline_ns for it in self._timers]
            ends_ns = [it for it in [end_ns, *deadlines_ns] if it is not None]
            now_ns = time.monotonic_ns()
            pause = None if not ends_ns else max(min(ends_ns) - now_ns, 0) / 1e9
            events = self._selector.select(pause)
            ready: list[Any] = [it for key, _ in events for it in self._sources[key.fd]]
            now_ns = time.monotonic_ns()
            for timer in self._timers:
                deadline_ns = timer.deadline_ns
                if deadline_ns is not None and deadline_ns <= now_ns:
                    ready.append(timer)
            if ready or (end_ns is not None and end_ns <= now_ns):
                return ready

    def close(self) -> None:
        """Closes the set's descriptor; its sources stay open."""
        self._selector.close()
        self._sources.clear()
        self._timers.clear()
