"""Waiting for descriptors in an asyncio loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from weakref import WeakKeyDictionary

#: The futures that wait for each descriptor, by loop. A loop has one reader for a descriptor, whoever waits for it.
_waiting: WeakKeyDictionary[asyncio.AbstractEventLoop, dict[int, set[asyncio.Future[None]]]] = (
    WeakKeyDictionary()
)


async def readable(descriptor: int) -> None:
    """Waits until the descriptor is readable, or its object is closed."""
    loop = asyncio.get_running_loop()
    futures = _waiting.setdefault(loop, {}).setdefault(descriptor, set())
    future: asyncio.Future[None] = loop.create_future()
    if not futures:
        loop.add_reader(descriptor, _wake, loop, descriptor)
    futures.add(future)
    try:
        await future
    finally:
        futures.discard(future)
        if not futures and _waiting[loop].get(descriptor) is futures:
            del _waiting[loop][descriptor]
            loop.remove_reader(descriptor)


def closing(fileno: Callable[[], int]) -> None:
    """Ends the waits for a descriptor that is about to be closed. Without any wait, does not ask for its number."""
    for loop, descriptors in list(_waiting.items()):
        if not descriptors or loop.is_closed():
            continue
        descriptor = fileno()
        try:
            is_here = asyncio.get_running_loop() is loop
        except RuntimeError:
            is_here = False
        if is_here:
            _end(loop, descriptor)
        else:
            loop.call_soon_threadsafe(_end, loop, descriptor)


def _end(loop: asyncio.AbstractEventLoop, descriptor: int) -> None:
    if descriptor in _waiting.get(loop, {}):
        loop.remove_reader(descriptor)
        _wake(loop, descriptor)
        del _waiting[loop][descriptor]


def _wake(loop: asyncio.AbstractEventLoop, descriptor: int) -> None:
    for future in _waiting.get(loop, {}).get(descriptor, ()):
        if not future.done():
            future.set_result(None)
