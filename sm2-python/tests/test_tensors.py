"""DLPack: numpy, PyTorch and JAX."""

from __future__ import annotations

import ctypes
import importlib.util
import signal
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from helpers import Child, linked, received

import sm2


@pytest.fixture
def sample(node: sm2.Node) -> Iterator[sm2.Sample[Any]]:
    """A sample with the numbers from 0."""
    publisher, subscriber = linked(node, "topic", "f4", {}, {})
    publisher.publish(np.arange(100_000, dtype="f4"))
    yield received(subscriber)


def is_intact(sample: sm2.Sample[Any]) -> bool:
    """Whether the message is the one that was published."""
    return np.array_equal(sample.value, np.arange(100_000, dtype="f4"))


def test_numpy_gets_a_view_that_is_read_only(sample: sm2.Sample[Any]) -> None:
    array = np.from_dlpack(sample)
    assert np.array_equal(array, np.arange(100_000)) and not array.flags.writeable
    assert array.ctypes.data == sample.value.ctypes.data
    del sample
    assert np.array_equal(array, np.arange(100_000))


class Asks:
    """Passes options on to a sample, as a library does that calls `__dlpack__` with them."""

    def __init__(self, sample: sm2.Sample[Any], **options: Any) -> None:
        self.sample = sample
        self.options = options

    def __dlpack__(self, **_: Any) -> Any:
        return self.sample.__dlpack__(**self.options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self.sample.__dlpack_device__()


#: How PyTorch calls it, before and since version 2.6, and how it does with `copy=True`.
COPIES: list[dict[str, Any]] = [{}, {"max_version": (1, 0)}, {"max_version": (1, 0), "copy": True}]


@pytest.mark.parametrize("options", COPIES)
def test_a_library_without_read_only_tensors_gets_a_copy(sample: sm2.Sample[Any], options: dict[str, Any]) -> None:
    array = np.from_dlpack(Asks(sample, **options))
    assert np.array_equal(array, sample.value) and array.ctypes.data != sample.value.ctypes.data
    # A tensor of PyTorch would write here. numpy itself marks some arrays that it imports as read-only.
    ctypes.memset(array.ctypes.data, 0xFF, array.nbytes)
    assert is_intact(sample)


def test_a_view_is_explicit_and_never_for_a_library_that_cannot_mark_it(sample: sm2.Sample[Any]) -> None:
    array = np.from_dlpack(Asks(sample, max_version=(1, 0), copy=False))
    assert array.ctypes.data == sample.value.ctypes.data and not array.flags.writeable
    with pytest.raises(BufferError):
        np.from_dlpack(Asks(sample, copy=False))


def test_a_tensor_of_torch_is_a_copy(sample: sm2.Sample[Any]) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    tensor = torch.from_dlpack(sample)
    assert tensor.data_ptr() != sample.value.ctypes.data and torch.equal(tensor, torch.arange(100_000.0))
    tensor[:] = -1
    assert is_intact(sample)


def test_which_calls_of_torch_copy(sample: sm2.Sample[Any]) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    array = sample.value
    address = array.ctypes.data
    copies: list[Callable[[], Any]] = [
        lambda: torch.from_dlpack(sample),
        lambda: torch.from_dlpack(sample, copy=True),
        lambda: torch.tensor(array),
    ]
    views: list[Callable[[], Any]] = [
        lambda: torch.from_dlpack(sample, copy=False),
        lambda: torch.from_numpy(array),
        lambda: torch.as_tensor(array),
        lambda: torch.from_dlpack(array),
        lambda: torch.frombuffer(sample, dtype=torch.float32),
    ]
    for make in copies:
        tensor = make()
        assert tensor.data_ptr() != address
        tensor[:] = -1
    assert is_intact(sample)
    with warnings.catch_warnings():
        # PyTorch warns of some of them, once in a process.
        warnings.simplefilter("ignore")
        for make in views:
            tensor = make()
            assert tensor.data_ptr() == address and torch.equal(tensor, torch.arange(100_000.0))


WRITES = {
    "ctypes": "ctypes.memset(sample.value.ctypes.data, 0xFF, 4)",
    "torch": "import torch; torch.from_dlpack(sample, copy=False)[0] = 1",
}

WRITER = """
import ctypes, sm2
from helpers import received
node = sm2.Node("writer")
sample = received(node.subscriber("topic", "f4"))
print("ready", flush=True)
input()
%s
print("written", flush=True)
"""


@pytest.mark.parametrize("name", WRITES)
def test_a_write_to_a_view_ends_its_process_and_changes_no_message(
    node: sm2.Node, child: Callable[[str], Child], name: str
) -> None:
    if name == "torch" and importlib.util.find_spec("torch") is None:
        pytest.skip("torch is not installed")
    publisher, subscriber = linked(node, "topic", "f4", {"latched": 1}, {})
    publisher.publish(np.arange(100_000, dtype="f4"))
    sample = received(subscriber)
    writer = child(WRITER % WRITES[name])
    assert writer.line() == "ready"
    writer.send("write")
    status, out, _ = writer.wait()
    assert (status, out) == (-signal.SIGSEGV, "")
    assert is_intact(sample)
    publisher.publish(np.ones(3, "f4"))
    assert received(subscriber).value.tolist() == [1, 1, 1]


def test_an_array_of_jax_stays_as_it_is(sample: sm2.Sample[Any]) -> None:
    jax = pytest.importorskip("jax", reason="jax is not installed")
    array = jax.dlpack.from_dlpack(sample)
    assert is_intact(sample)
    # Arrays of JAX cannot be changed: this makes another one.
    assert float(array.at[0].set(-1)[0]) == -1 and float(array[0]) == 0
    del sample
    assert np.array_equal(np.asarray(array), np.arange(100_000, dtype="f4"))
