"""Each message type, there and back, and declarations that do not fit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from helpers import SOON, linked, received

import sm2
from sm2._types import schema_of

IMU = np.dtype([("stamp_ns", "u8"), ("acceleration", "f8", 3)])
POINT = np.dtype([("x", "f4"), ("y", "f4"), ("id", [("low", "u2"), ("high", "u2")])])


def sent(node: sm2.Node, type: Any, value: Any) -> sm2.Sample[Any]:
    """The sample of a value that was published."""
    publisher, subscriber = linked(node, "topic", type, {}, {})
    assert publisher.publish(value).links == 1
    return received(subscriber)


@pytest.mark.parametrize("len_bytes", [0, 1, 100, 4096, 70_000, 3_000_000])
def test_bytes(node: sm2.Node, len_bytes: int) -> None:
    value = bytes(range(256)) * (len_bytes // 256) + bytes(len_bytes % 256)
    sample = sent(node, bytes, value)
    assert sample.value == value == bytes(sample) == memoryview(sample)
    assert len(sample) == len_bytes and sample.type_name == "bytes"
    with pytest.raises(TypeError, match="read-only"):
        memoryview(sample)[0:1] = b"x"


def test_buffers(node: sm2.Node) -> None:
    for value in [bytearray(b"abc"), memoryview(b"abc"), np.frombuffer(b"abc", "u1")]:
        assert sent(node, bytes, value).value == b"abc"
        node.close()
        node = sm2.Node("test")
    publisher = node.publisher("topic", bytes)
    for bad in ["abc", 3, None, memoryview(b"abcd")[::2]]:
        with pytest.raises((TypeError, BufferError)):
            publisher.publish(bad)  # type: ignore[arg-type]


@pytest.mark.parametrize("value", ["", "hello", "Grüße, 世界 🤖", "x" * 100_000])
def test_text(node: sm2.Node, value: str) -> None:
    assert sent(node, str, value).value == value


def test_json(node: sm2.Node) -> None:
    goal = sm2.Json("nav/Goal", "struct{x:f64,name:string,tags:list[string],}")
    value = {"x": 0.1 + 0.2, "name": "dock", "tags": ["a", "ä"]}
    assert sent(node, goal, value).value == value
    assert node.describe(goal) == "json:struct{x:f64,name:string,tags:list[string],}"
    with pytest.raises(ValueError):
        node.publisher("other", goal).publish({"x": math.nan})


NUMBERS = ["u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f4", "f8"]


@pytest.mark.parametrize("dtype", NUMBERS)
def test_arrays_of_numbers(node: sm2.Node, dtype: str) -> None:
    value = np.arange(100).astype(dtype)
    sample = sent(node, dtype, value)
    assert sample.value.dtype == np.dtype(dtype) and np.array_equal(sample.value, value)
    assert not sample.value.flags.writeable
    with pytest.raises(ValueError):
        sample.value.flags.writeable = True


@pytest.mark.parametrize("dtype", NUMBERS)
def test_single_numbers(node: sm2.Node, dtype: str) -> None:
    assert sent(node, sm2.Plain(dtype), 42).value == 42


def test_structures(node: sm2.Node) -> None:
    imu = sm2.Plain(IMU, name="sensor/Imu")
    assert imu.schema == "plain:struct{stamp_ns:u64,acceleration:array[f64;0000000000000003],}"
    value = np.array((5, [1, 2, 3]), IMU)
    sample = sent(node, imu, value)
    assert sample.value["stamp_ns"] == 5 and sample.value["acceleration"].tolist() == [1, 2, 3]
    assert node.describe(imu) == imu.schema


def test_arrays_of_structures_and_shapes(node: sm2.Node) -> None:
    points = sm2.Values(POINT, name="nav/Point", shape=(2, -1))
    value = np.zeros(6, POINT)
    value["x"] = np.arange(6)
    value["id"]["high"] = 9
    sample = sent(node, points, value)
    assert sample.value.shape == (2, 3) and np.array_equal(sample.value.ravel(), value)


def test_values_of_another_dtype_are_refused(node: sm2.Node) -> None:
    publisher = node.publisher("points", "f4")
    with pytest.raises(sm2.PublishError, match="has the dtype float32, not float64"):
        publisher.publish(np.zeros(3))
    assert publisher.publish([1.0, 2.0]).links == 0  # type: ignore[arg-type]
    with pytest.raises(sm2.PublishError, match="is one value, not 2"):
        node.publisher("number", sm2.Plain("f4")).publish([1.0, 2.0])


def test_arrays_that_are_not_contiguous_are_copied(node: sm2.Node) -> None:
    value = np.arange(100, dtype="i4").reshape(10, 10)[::2, ::3]
    assert np.array_equal(sent(node, "i4", value).value, value.ravel())


@pytest.mark.parametrize(
    "dtype, text",
    [
        (">f4", "little-endian"),
        ("f2", "no schema"),
        ("c8", "no schema"),
        ("?", "no schema"),
        ("O", "no schema"),
        ("U4", "no schema"),
        (np.dtype([("a", "u1"), ("b", "u4")], align=True), "gap before the field b"),
        (np.dtype({"names": ["a"], "formats": ["u1"], "itemsize": 4}), "ends in padding"),
    ],
)
def test_dtypes_without_a_schema(dtype: Any, text: str) -> None:
    with pytest.raises(sm2.SchemaError, match=text):
        sm2.Plain(dtype, name="some/Type")


def test_nested_arrays_have_the_schema_of_rust() -> None:
    assert schema_of(np.dtype(("u2", (2, 17)))) == (
        "array[array[u16;0000000000000011];0000000000000002]"
    )


def test_a_structure_needs_a_name_and_names_are_checked(node: sm2.Node) -> None:
    with pytest.raises(sm2.SchemaError, match="needs a name"):
        sm2.Plain(IMU)
    with pytest.raises(sm2.SchemaError, match="type name"):
        node.publisher("imu", sm2.Plain(IMU, name="sensor::Imu"))
    with pytest.raises(sm2.SchemaError, match="is malformed"):
        node.publisher("goal", sm2.Json("nav/Goal", "struct{x:float,}"))
    with pytest.raises(sm2.DeclareError, match="topic name"):
        node.publisher("a//b")


def test_a_mismatch_shows_both_schemas(node: sm2.Node) -> None:
    imu = sm2.Plain(IMU, name="sensor/Imu")
    other = sm2.Plain([("stamp_ns", "u8"), ("acceleration", "f8", 4)], name="sensor/Imu")
    publisher = node.publisher("imu", imu)
    with pytest.raises(sm2.TypeMismatchError) as caught:
        node.subscriber("imu", other)
    text = str(caught.value)
    assert str(imu.schema) in text and str(other.schema) in text
    assert "first difference: acceleration: array of 4 f64 here, array of 3 f64 there" in text
    with pytest.raises(sm2.TypeMismatchError, match="raw bytes"):
        node.publisher("imu", bytes)
    # Without a type, a subscriber accepts every one.
    anything = node.subscriber("imu")
    anything.wait_for_publishers(1, SOON)
    publisher.publish((1, [2, 3, 4]))
    sample = received(anything)
    assert sample.type_name == "sensor/Imu" and len(sample) == 32


def test_a_service_mismatch_shows_both_schemas(node: sm2.Node) -> None:
    server = node.server("sum", "f8", sm2.Plain("f8"))
    with pytest.raises(sm2.TypeMismatchError, match="plain:list.f64.*|plain:f32"):
        node.client("sum", "f8", sm2.Plain("f4"))
    server.close()


def test_a_message_of_another_length_is_an_error_of_its_value(node: sm2.Node) -> None:
    # Raw bytes under the name and hash of no other type: only a program that lies can send them.
    liar = sm2.MessageType("f64", "plain:f64", bytes, bytes)
    publisher = node.publisher("number", liar)
    subscriber = node.subscriber("number", sm2.Plain("f8"))
    publisher.wait_for_subscribers(1, SOON)
    publisher.publish(b"123")
    sample = received(subscriber)
    with pytest.raises(sm2.RecvError, match="is not of type f64"):
        sample.value
    assert bytes(sample) == b"123"
