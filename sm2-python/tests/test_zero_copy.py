"""Frames between two processes, which nobody copies."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from helpers import SOON, Child, linked, received

import sm2

FRAMES = 20
SHAPE = (1250, 2000, 4)

CAMERA = f"""
import numpy as np, sm2
with sm2.Node("camera") as node:
    publisher = node.publisher("image", "u1", reliable=True, publish_timeout={SOON}, wait_share_percent=100)
    publisher.wait_for_subscribers(1, {SOON})
    for number in range({FRAMES}):
        with publisher.loan({SHAPE}) as image:
            image[:] = number
            image[0, 0] = [1, 2, 3, 4]
    assert publisher.flush({SOON})
print("done")
"""


def mapping_of(address: int) -> str:
    """The line of /proc/self/maps with this address."""
    with open("/proc/self/maps") as maps:
        for line in maps:
            start, end = (int(it, 16) for it in line.split()[0].split("-"))
            if start <= address < end:
                return line
    raise AssertionError(f"{address:#x} is not mapped")


def test_a_frame_of_10_mb_is_a_view_of_shared_memory(
    node: sm2.Node, child: Callable[[str], Child]
) -> None:
    subscriber = node.subscriber("image", "u1", reliable=True)
    camera = child(CAMERA)
    for number in range(FRAMES):
        sample = received(subscriber)
        assert (sample.publisher, sample.lost) == ("camera", 0)
        image = sample.numpy("u1", SHAPE)
        assert image.nbytes == 10_000_000 and not image.flags.writeable and not image.flags.owndata
        assert "/memfd:" in mapping_of(image.ctypes.data)
        assert image[0, 0].tolist() == [1, 2, 3, 4]
        assert np.all(image[1:] == number) and np.all(image[0, 1:] == number)
    del sample, image
    assert camera.wait() == (0, "done\n", "")


def test_an_array_of_a_sample_stays_read_only_and_counts_as_a_view(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "image", "u1", {}, {})
    for count in [0, 3, 3000]:
        publisher.publish(np.full(count, 7, "u1"))
        sample = received(subscriber)
        arrays = [sample.numpy(), sample.numpy("u1"), sample.numpy(shape=(-1, 1)), sample.numpy("u1", (count,))]
        assert subscriber.held == (1, 4)
        del sample
        assert subscriber.held == (1, 4)
        for array in arrays:
            assert array.size == count and array.dtype == np.uint8 and np.all(array == 7)
            assert array.flags.c_contiguous and array.flags.aligned and not array.flags.owndata
            with pytest.raises(ValueError, match="WRITEABLE"):
                array.flags.writeable = True
            with pytest.raises(ValueError, match="read-only"):
                array[:1] = 1
        arrays.clear()
        del array
        assert subscriber.held == (0, 0)
