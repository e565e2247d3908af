"""Subscribers, servers and calls in an asyncio loop."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

import numpy as np
import pytest
from helpers import SOON, linked

import sm2


def run(coroutine: Coroutine[Any, Any, Any]) -> Any:
    """Runs a coroutine, with a time limit."""
    return asyncio.run(asyncio.wait_for(coroutine, SOON))


def test_a_loop_receives_samples_of_two_topics(node: sm2.Node) -> None:
    one, ones = linked(node, "one", "i4", {"reliable": True}, {"reliable": True})
    two, twos = linked(node, "two", str, {"reliable": True}, {"reliable": True})

    async def take(subscriber: sm2.Subscriber[Any], count: int) -> list[Any]:
        values = []
        async for sample in subscriber:
            value = sample.value
            values.append(value if isinstance(value, str) else int(value[0]))
            if len(values) == count:
                return values
        raise AssertionError("a subscriber has no last sample")

    async def send() -> None:
        for number in range(50):
            one.publish(np.array([number], "i4"), timeout=SOON)
            two.publish(str(number), timeout=SOON)
            await asyncio.sleep(0)

    async def everything() -> list[Any]:
        return await asyncio.gather(take(ones, 50), take(twos, 50), send())

    numbers, texts, _ = run(everything())
    assert numbers == list(range(50)) and texts == [str(it) for it in range(50)]


def test_two_tasks_may_wait_for_one_subscriber(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "topic", str, {}, {})

    async def everything() -> list[str]:
        tasks = [asyncio.ensure_future(subscriber.__anext__()) for _ in range(2)]
        await asyncio.sleep(0)
        publisher.publish("a")
        publisher.publish("b")
        return sorted([(await task).value for task in tasks])

    assert run(everything()) == ["a", "b"]


def test_a_cancelled_wait_takes_no_message(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "topic", str, {}, {})

    async def everything() -> str:
        task = asyncio.ensure_future(subscriber.__anext__())
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        publisher.publish("still there")
        return (await subscriber.__anext__()).value

    assert run(everything()) == "still there"


def test_closing_ends_a_wait(node: sm2.Node) -> None:
    subscriber = node.subscriber("topic")

    async def everything() -> None:
        task = asyncio.ensure_future(subscriber.__anext__())
        await asyncio.sleep(0)
        subscriber.close()
        with pytest.raises(sm2.ClosedError):
            await task

    run(everything())


def test_a_server_and_its_client_in_one_loop(node: sm2.Node) -> None:
    server = node.server("sum", "f8", sm2.Plain("f8"))
    client = node.client("sum", "f8", sm2.Plain("f8"))
    client.wait_for_servers(1, SOON)

    async def serve() -> None:
        async for request in server:
            request.reply(request.value.sum())

    async def everything() -> list[float]:
        serving = asyncio.ensure_future(serve())
        sums = [await client.call_async([1.0, it], SOON) for it in range(10)]
        calls = [client.send([2.0, it], SOON) for it in range(10)]
        sums += [await call for call in calls]
        serving.cancel()
        return sums

    assert run(everything()) == [1.0 + it for it in range(10)] + [2.0 + it for it in range(10)]
