"""Messages that Python writes in place."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from helpers import linked, received

import sm2


def test_a_loan_is_published_at_the_end_of_its_block(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "points", "f4", {}, {})
    with publisher.loan((100, 3)) as points:
        assert points.flags.writeable and points.dtype == np.float32
        points[:] = np.arange(300).reshape(100, 3)
        assert subscriber.take() is None
    sample = received(subscriber)
    assert np.array_equal(sample.value, np.arange(300, dtype="f4"))
    # The memory is that of the subscriber now.
    assert points.size == 0 and not points.flags.writeable


def test_after_the_block_the_array_reaches_no_memory(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "points", "f4", {}, {})
    with publisher.loan((2, 3)) as points:
        points[:] = 5
        copy = points.copy()
    assert points.shape == (0,) and bytes(points) == b""
    with pytest.raises(IndexError):
        points[0]
    with pytest.raises(ValueError, match="read-only"):
        points[:] = 7
    # numpy allows this, but the array has no memory that anybody else reads.
    points.flags.writeable = True
    points[:] = 7
    # The next message has the same memory as soon as the subscriber has released it.
    received(subscriber)
    with publisher.loan((2, 3)) as others:
        others[:] = 6
    assert points.size == 0 and np.all(copy == 5)
    assert np.all(received(subscriber).value == 6)


def test_an_exception_in_the_block_publishes_nothing(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "points", "f4", {}, {})
    with pytest.raises(ZeroDivisionError):
        with publisher.loan(10) as points:
            points[:] = 1 / 0
    publisher.publish(np.zeros(1, "f4"))
    assert received(subscriber).sequence == 1


def with_slice(array: Any) -> Any:
    return array[1:]


def with_memoryview(array: Any) -> Any:
    return memoryview(array)


def with_base(array: Any) -> Any:
    return array.base


def with_view_of_base(array: Any) -> Any:
    return np.frombuffer(array.base, "u1")


def with_list(array: Any) -> Any:
    return [array]


def with_reshape(array: Any) -> Any:
    return array.reshape(2, -1)


def with_ndarray_of_base(array: Any) -> Any:
    return np.ndarray((4,), "u1", array.base)


ESCAPES = [
    with_slice,
    with_memoryview,
    with_base,
    with_view_of_base,
    with_list,
    with_reshape,
    with_ndarray_of_base,
]


@pytest.mark.parametrize("keep", ESCAPES)
@pytest.mark.parametrize("count", [8, 1_000_000])
def test_a_view_that_escapes_keeps_the_message_from_being_published(
    node: sm2.Node, keep: Callable[[Any], Any], count: int
) -> None:
    publisher, subscriber = linked(node, "points", "f4", {}, {})
    with pytest.raises(sm2.LoanError, match="still refers to the array"):
        with publisher.loan(count) as points:
            kept = keep(points)
    # The memory stays that of the view, and later messages have other memory.
    points[:] = 7
    for number in range(20):
        with publisher.loan(count) as others:
            others[:] = number
        assert np.all(received(subscriber).value == number)
    assert np.all(points == 7)
    del kept, points
    gc.collect()


def test_a_view_that_is_the_only_reference_left_is_found(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "points", "f4", {}, {})
    with pytest.raises(sm2.LoanError):
        with publisher.loan(1_000_000) as points:
            kept = memoryview(points)
            del points
    publisher.publish(np.zeros(1, "f4"))
    assert received(subscriber).sequence == 1
    del kept


def test_a_variable_of_an_outer_function_may_hold_the_array(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "points", "f4", {}, {})
    points = None

    def fill() -> None:
        nonlocal points
        with publisher.loan(3) as points:
            points[:] = 2

    fill()
    assert received(subscriber).value.tolist() == [2, 2, 2]


def test_a_loan_keeps_no_other_variable_alive(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "points", "f4", {}, {})
    publisher.publish(np.zeros(3, "f4"))
    sample = received(subscriber)
    view = sample.value
    with publisher.loan(3) as points:
        points[:] = view
    assert subscriber.held == (1, 1)
    del sample, view
    assert subscriber.held == (0, 0)


def test_a_loan_is_used_once(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "points", "f4", {}, {})
    loan = publisher.loan(3)
    with loan as points:
        points[:] = 2
    with pytest.raises(sm2.LoanError, match="has ended"):
        with loan:
            pass
    assert received(subscriber).sequence == 1 and subscriber.take() is None


def test_a_sealed_loan_is_published(node: sm2.Node) -> None:
    publisher, subscriber = linked(node, "frames", "u1", {"sealed": True}, {})
    for number in range(5):
        with publisher.loan(3_000_000) as frame:
            frame[:] = number
        sample = received(subscriber)
        assert np.all(sample.numpy() == number)


def test_a_loan_outlives_its_publisher(node: sm2.Node) -> None:
    publisher, _ = linked(node, "points", "f4", {}, {})
    with publisher.loan(1_000_000) as points:
        publisher.close()
        node.close()
        points[:] = 1
    assert points.size == 0


def test_objects_and_other_dtypes_are_refused(node: sm2.Node) -> None:
    points = node.publisher("points", "f4")
    frames = node.publisher("frames", bytes)
    words = node.publisher("words", str)
    bad: sm2.Publisher[Any]
    for bad, dtype, text in [
        (points, "f8", "has the dtype float32"),
        (frames, object, "references to Python objects"),
        (words, "u1", "have to be encoded"),
    ]:
        with pytest.raises(TypeError, match=text):
            bad.loan(3, dtype)
    with pytest.raises(ValueError, match="negative"):
        frames.loan((3, -1))
    with pytest.raises(ValueError, match="negative"):
        frames.loan(-1)
    with pytest.raises(ValueError, match="too large"):
        frames.loan((2**40, 2**40))
    with pytest.raises(TypeError):
        frames.loan((2, "3"))  # type: ignore[arg-type]
    with frames.loan((2, 2), "i8") as frame:
        frame[:] = 1


# numpy's interface for C makes arrays of bytes with few dimensions, and numpy's class the others.
@pytest.mark.parametrize("shape", [(), 6, (6,), [2, 3], (2, 3), (0, 3), (1, 6, 1), (1,) * 8 + (6,)])
@pytest.mark.parametrize("dtype", ["u1", "i1", "u2"])
def test_a_loan_has_its_shape_and_dtype(node: sm2.Node, shape: Any, dtype: str) -> None:
    publisher, subscriber = linked(node, "frames", bytes, {}, {})
    expected = np.ndarray(shape, dtype, bytearray(64))
    with publisher.loan(shape, dtype) as frame:
        assert (frame.shape, frame.strides, frame.dtype) == (expected.shape, expected.strides, expected.dtype)
        for flag in ["C_CONTIGUOUS", "F_CONTIGUOUS", "ALIGNED", "WRITEABLE"]:
            assert frame.flags[flag] == expected.flags[flag], flag
        assert not frame.flags.owndata
        frame[...] = expected[...] = np.arange(expected.size).reshape(expected.shape)
    assert frame.shape == (0,) and frame.dtype == expected.dtype
    assert bytes(received(subscriber)) == expected.tobytes()
