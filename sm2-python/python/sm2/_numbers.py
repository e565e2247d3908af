"""Arrays and sequences of numbers in messages of ROS 2."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def contiguous(value: Any, name: str) -> npt.NDArray[Any]:
    """The array whose bytes a message gets. `name` is the dtype of the field.

    An array of numpy must have this dtype, so that no number changes without notice. Bytes are numbers of one byte.
    Lists and other sequences are converted, if their numbers are of the kind of the field.
    """
    dtype = np.dtype(name)
    if isinstance(value, str):
        raise TypeError("expected a sequence of numbers, found str")
    if isinstance(value, bytes | bytearray | memoryview):
        value = np.frombuffer(value, "u1")
    if isinstance(value, np.ndarray):
        if value.dtype.newbyteorder("=") != dtype.newbyteorder("="):
            raise TypeError(f"expected an array of {dtype}, found one of {value.dtype}")
        return np.ascontiguousarray(value, dtype).reshape(-1)
    given = np.asarray(value)
    if given.size and given.dtype.kind not in _KINDS[dtype.kind]:
        raise TypeError(f"expected numbers of {dtype}, found {given.dtype}")
    return np.asarray(value, dtype).reshape(-1)


#: The kinds of numpy's dtypes whose numbers a field of some kind takes.
_KINDS = {"b": "b", "u": "ui", "i": "ui", "f": "uif"}
