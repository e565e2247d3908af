"""Types of ROS 2: topics and services carry the messages of ROS 2, in its encoding (CDR) and under its names and hashes.

::

    Image = sm2.ros.load("sensor_msgs/msg/Image")

    with sm2.Node("camera") as node:
        publisher = node.publisher("image", Image)
        publisher.publish(Image(height=480, width=640, encoding="mono8", step=640, data=pixels))

    with sm2.Node("viewer") as node:
        for sample in node.subscriber("image", Image):
            image = sample.value
            pixels = image.data.reshape(image.height, image.step)

A program in Rust or C++ with the same type has the same topics. This is not a bridge to nodes of ROS 2.

========================= ========================================== ================================================
definition                value of a received message                values that `publish` takes
========================= ========================================== ================================================
`bool`                    `bool`                                     `bool`
integers, `byte`, `char`  `int`                                      integers within the limits of the type
`float32`, `float64`      `float`                                    numbers
`string`, `wstring`       `str`                                      `str`
`T[]`, `T[N]` of numbers  a read-only array, a view of the sample    an array of the same dtype, `bytes`, sequences
`bool[]`, `bool[N]`       an array, a copy                           the same
other arrays              a `list`                                   sequences
a message                 a `View`                                   a `View`, `Message` or `dict`, or any object whose
                                                                     attributes are the fields
========================= ========================================== ================================================
"""

from __future__ import annotations

import ast
import os
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from ._native import RosType as _Native
from ._native import View
from ._types import MessageType

__all__ = ["Message", "Type", "View", "load"]


class Message(SimpleNamespace):
    """A message of ROS 2 that a program has made, or a part of one. Each field is an attribute, which can be set."""


class Type(MessageType[Any]):
    """A message type of ROS 2. `load` returns one.

    A call makes a message: `String(data="hello")`. Fields that are left out have the default values of the definition,
    which are zeroes, empty texts and empty sequences if it states none. The constants of the definition are attributes,
    such as `PointField.FLOAT32`.
    """

    def __init__(self, native: _Native) -> None:
        """The type that the native module has loaded."""
        super().__init__(native.name, native.schema, native.encode, native.decode)
        self._native = native
        #: The types of the fields, as definitions write them, by name.
        self.fields: dict[str, str] = dict(native.fields)
        #: The constants by name.
        self.constants: dict[str, Any] = {name: _constant(kind, text) for name, kind, text in native.constants}

    def __call__(self, **fields: Any) -> Message:
        message = self.copy(self._native.default())
        for name, value in fields.items():
            if name not in self.fields:
                raise TypeError(f"{self.name} has no field {name}: the fields are {', '.join(self.fields)}")
            setattr(message, name, value)
        return message

    def __getattr__(self, name: str) -> Any:
        constants = self.__dict__.get("constants", {})
        if name in constants:
            return constants[name]
        raise AttributeError(f"{self.__dict__.get('name')} has no constant {name}")

    @staticmethod
    def copy(message: View | Message) -> Message:
        """A copy of a message, whose fields and arrays can be changed. It does not keep the memory of a sample."""
        copied = _copied(message)
        assert isinstance(copied, Message)
        return copied

    def __repr__(self) -> str:
        return f"<sm2.ros.Type {self.name}>"


def load(name: str, *folders: str | os.PathLike[str]) -> Type:
    """The type of this name, such as `sensor_msgs/msg/Image` or `std_srvs/srv/SetBool_Request`.

    The definitions of ROS 2's common interfaces are built in. Each of `folders` is a package with definitions
    (`FOLDER/msg/NAME.msg`) or a folder of packages, such as `/opt/ros/jazzy/share`; a definition there replaces the
    built-in one of the same name. Raises `SchemaError` if nothing defines the type or a type that it refers to, and
    `OSError` if a folder cannot be read.
    """
    return _load(name, tuple(os.fspath(folder) for folder in folders))


@lru_cache(maxsize=None)
def _load(name: str, folders: tuple[str, ...]) -> Type:
    return Type(_Native(name, list(folders)))


def _copied(value: Any) -> Any:
    if isinstance(value, View):
        return Message(**{name: _copied(getattr(value, name)) for name in dir(value)})
    if isinstance(value, Message):
        return Message(**{name: _copied(it) for name, it in vars(value).items()})
    if isinstance(value, list):
        return [_copied(it) for it in value]
    if isinstance(value, np.ndarray):
        return value.astype(value.dtype.newbyteorder("="))
    return value


def _constant(kind: str, text: str) -> Any:
    if kind == "bool":
        return text.lower() in ("true", "1")
    if kind.startswith(("string", "wstring")):
        is_quoted = len(text) > 1 and text[0] == text[-1] and text[0] in "'\""
        return text[1:-1] if is_quoted else text
    return float(text) if kind.startswith("float") else int(ast.literal_eval(text))
