"""The same types in Python and Rust: examples/peer.rs, whose program the variable SM2_PYTHON_PEER names."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator

import numpy as np
import pytest
from helpers import SOON, Child, received

import sm2

PEER = os.environ.get("SM2_PYTHON_PEER")

IMU = sm2.Plain([("stamp_ns", "u8"), ("acceleration", "f8", 3)], name="sensor/Imu")
POINTS = sm2.Values([("x", "f4"), ("y", "f4"), ("id", "u2", 2)], name="nav/Point")

pytestmark = pytest.mark.skipif(PEER is None, reason="SM2_PYTHON_PEER names no program")


@pytest.fixture
def peer(domain: Child) -> Iterator[None]:
    """Runs the program in the domain of the test."""
    assert PEER is not None
    with subprocess.Popen([PEER], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        yield
        process.kill()


def test_numpy_dtypes_are_structures_of_rust(peer: None, node: sm2.Node) -> None:
    imu, points = node.publisher("imu", IMU), node.publisher("points", POINTS)
    text = node.publisher("text", str)
    doubled_imu = node.subscriber("imu/doubled", IMU)
    doubled_points = node.subscriber("points/doubled", POINTS)
    doubled_text = node.subscriber("text/doubled", str)
    for publisher in (imu, points, text):
        publisher.wait_for_subscribers(1, SOON)
    for subscriber in (doubled_imu, doubled_points, doubled_text):
        subscriber.wait_for_publishers(1, SOON)
    for count in range(0, 100_000, 30_000):
        with imu.loan() as array:
            array["stamp_ns"] = 21
            array["acceleration"] = [1, 2, 3]
        with points.loan(count) as array:
            array["x"] = np.arange(count)
            array["y"] = 1
            array["id"] = [3, 4]
        text.publish("ä")
        value = received(doubled_imu).value
        assert value["stamp_ns"] == 42 and value["acceleration"].tolist() == [2, 4, 6]
        value = received(doubled_points).value
        assert np.array_equal(value["x"], 2 * np.arange(count, dtype="f4"))
        assert np.all(value["y"] == 1) and np.all(value["id"] == [3, 4])
        assert received(doubled_text).value == "ää"


def test_a_mismatch_with_rust_shows_both_schemas(peer: None, node: sm2.Node) -> None:
    other = sm2.Plain([("stamp_ns", "u8"), ("acceleration", "f4", 3)], name="sensor/Imu")
    with pytest.raises(sm2.TypeMismatchError) as caught:
        node.publisher("imu", other)
    text = str(caught.value)
    assert str(IMU.schema) in text and str(other.schema) in text
    assert "first difference: acceleration[]: f32 here, f64 there" in text
