"""Message types: the type of a topic or service, and its Python values."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

import numpy as np
import numpy.typing as npt

from ._native import PublishError, RecvError, SchemaError

if TYPE_CHECKING:
    from typing_extensions import Buffer

T = TypeVar("T")

#: A numpy array, or a number of a topic whose messages are single numbers.
Array = npt.NDArray[Any]


class MessageType(Generic[T]):
    """The type of a topic or service: a name, a schema, and the conversion of values to and from bytes.

    Two programs can only communicate if they use the same type, whatever their languages are. `node.publisher` and its
    siblings take one of these for it:

    ====================== ============================== ==================================================
    type                   value                          the same type in Rust
    ====================== ============================== ==================================================
    `bytes`                `bytes`                        `[u8]`
    `str`                  `str`                          `str`
    a numpy dtype          an array                       a list of numbers or structures, such as `[f32]`
    `Values`               an array                       the same, with the name of a structure
    `Plain`                a number or a structure        `f64`, a structure that derives `Message`
    `Json`                 what `json.loads` returns      a structure with `encoding = "json"`
    `sm2.ros.load(name)`   a message of ROS 2             the type of the same name in the crate `sm2-ros`
    ====================== ============================== ==================================================
    """

    def __init__(
        self,
        name: str,
        schema: str | None,
        encode: Callable[[T], Buffer],
        decode: Callable[[Buffer], T],
    ) -> None:
        """A type with this name and schema text (SPEC Annex A); without a text, raw bytes under this name."""
        self.name = name
        self.schema = schema
        self.encode = encode
        self.decode = decode

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}: {self.schema or 'raw bytes'}>"

    @property
    def native(self) -> tuple[str, str | None]:
        """The type, as the native module takes it."""
        return (self.name, self.schema)


#: Everything that names a message type.
TypeLike = MessageType[Any] | type[bytes] | type[str] | npt.DTypeLike


def _as_buffer(value: Buffer) -> Buffer:
    return value


def _text(value: str) -> bytes:
    if not isinstance(value, str):
        raise TypeError(f"a message of type text is a str, not {type(value).__name__}")
    return value.encode()


def _decode_text(data: Buffer) -> str:
    try:
        return bytes(data).decode()
    except UnicodeDecodeError as error:
        raise RecvError(f"the message is not of type text: {error}") from error


BYTES = MessageType[bytes]("bytes", None, _as_buffer, bytes)
TEXT = MessageType[str]("text", "plain:string", _text, _decode_text)


class Json(MessageType[Any]):
    """Messages that are sent as JSON. The schema tells all programs which fields a message has.

    `Json("nav/Goal", "struct{x:f64,y:f64,frame:string,}")` is the type of a Rust structure `Goal` with
    `#[message(name = "nav/Goal", encoding = "json")]`. Its values are dictionaries. The text follows SPEC Annex A.
    """

    def __init__(self, name: str, schema: str) -> None:
        """A type with this name, whose values have the structure `schema`."""
        super().__init__(name, f"json:{schema}", _encode_json, _decode_json)


def _encode_json(value: Any) -> bytes:
    # JSON has no NaN.
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


def _decode_json(data: Buffer) -> Any:
    try:
        return json.loads(bytes(data))
    except ValueError as error:
        raise RecvError(f"the message is no JSON: {error}") from error


class Values(MessageType[Array]):
    """Messages that are arrays of any length: numbers, or structures of numbers. Subscribers read them in place.

    `Values("f4")` is Rust's `[f32]`, and `Values("u1")` is `[u8]`, which is the type `bytes`. A structure needs the
    name that it has in Rust: `Values([("x", "f4"), ("y", "f4")], name="nav/Point")` is `[Point]`.
    """

    def __init__(
        self,
        dtype: npt.DTypeLike,
        *,
        name: str | None = None,
        shape: tuple[int, ...] = (-1,),
    ) -> None:
        """An array of these values. Received arrays get `shape`, of which one length may be -1: any."""
        self.dtype = np.dtype(dtype)
        self.shape = shape
        element = _name(self.dtype, name)
        if element == "u8":
            type_name, schema = "bytes", None
        else:
            type_name, schema = f"{element}-list", f"plain:list[{schema_of(self.dtype)}]"
        super().__init__(type_name, schema, self._bytes, self._array)

    def _bytes(self, value: npt.ArrayLike) -> Buffer:
        return _checked(self, self.dtype, value)

    def _array(self, data: Buffer) -> Array:
        with _refusing(self):
            return _view(data, self.dtype).reshape(self.shape)


class Plain(MessageType[Any]):
    """Messages that are one number or one structure of numbers, read in place.

    `Plain("f8")` is Rust's `f64`. `Plain([("stamp_ns", "u8"), ("acceleration", "f8", 3)], name="sensor/Imu")` is a
    structure `Imu` with `#[message(name = "sensor/Imu")]`: `sample.value["acceleration"]` is a view of the memory of
    the sample.
    """

    def __init__(self, dtype: npt.DTypeLike, *, name: str | None = None) -> None:
        """One value of this dtype. A structure needs a name."""
        self.dtype = np.dtype(dtype)
        schema = f"plain:{schema_of(self.dtype)}"
        super().__init__(_name(self.dtype, name), schema, self._bytes, self._value)

    def _bytes(self, value: Any) -> Buffer:
        array = np.asarray(value, self.dtype)
        if array.size != 1:
            raise PublishError(f"a message of type {self.name} is one value, not {array.size}")
        return _checked(self, self.dtype, array)

    def _value(self, data: Buffer) -> Any:
        with _refusing(self):
            return _view(data, self.dtype).reshape(())[()]


class _refusing:
    """Turns numpy's errors about the length of a message into those of SM2."""

    def __init__(self, data: MessageType[Any]) -> None:
        self.data = data

    def __enter__(self) -> None:
        pass

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> None:
        if isinstance(error, ValueError):
            raise RecvError(f"the message is not of type {self.data.name}: {error}") from error


def _view(data: Buffer, dtype: np.dtype[Any]) -> Array:
    # numpy takes every object with the buffer protocol, but its type hints do not say so.
    return np.frombuffer(cast(bytes, data), dtype)


def _checked(data: MessageType[Any], dtype: np.dtype[Any], value: npt.ArrayLike) -> Buffer:
    """The bytes of an array, if it has the dtype of its topic. Other sequences are converted."""
    array = np.asarray(value, None if isinstance(value, np.ndarray) else dtype)
    if array.dtype != dtype:
        raise PublishError(f"a message of type {data.name} has the dtype {dtype}, not {array.dtype}")
    return cast("Buffer", np.ascontiguousarray(array))


_NUMBERS = {
    "u1": "u8",
    "u2": "u16",
    "u4": "u32",
    "u8": "u64",
    "i1": "i8",
    "i2": "i16",
    "i4": "i32",
    "i8": "i64",
    "f4": "f32",
    "f8": "f64",
}


def _name(dtype: np.dtype[Any], name: str | None) -> str:
    if name is not None:
        return name
    number = _NUMBERS.get(dtype.str[1:])
    if number is None:
        raise SchemaError(f"a type with the dtype {dtype} needs a name, such as name='sensor/Imu'")
    return number


def schema_of(dtype: np.dtype[Any]) -> str:
    """The schema text of a numpy dtype (SPEC Annex A).

    A dtype has one if it consists of little-endian numbers of 1 to 8 bytes, arrays and structures, without padding. A
    structure in Rust with the same fields has the same text.
    """
    if dtype.subdtype is not None:
        element, shape = dtype.subdtype
        text = schema_of(element)
        for length in reversed(shape):
            text = f"array[{text};{length:016x}]"
        return text
    if dtype.fields is not None and dtype.names is not None:
        return _structure(dtype, dtype.names)
    number = _NUMBERS.get(dtype.str[1:])
    if number is None or dtype.str[0] not in "<|":
        raise SchemaError(
            f"the dtype {dtype} has no schema: use little-endian numbers (u1 to u8, i1 to i8, f4, f8), arrays and "
            "structures of them"
        )
    return number


def _structure(dtype: np.dtype[Any], names: tuple[str, ...]) -> str:
    end = 0
    text = "struct{"
    assert dtype.fields is not None
    for name in names:
        field, offset = dtype.fields[name][:2]
        if offset != end:
            raise SchemaError(
                f"the dtype {dtype} has a gap before the field {name}, or its fields overlap: plain messages have no "
                "padding; add a field for the gap, or leave out align=True"
            )
        end = offset + field.itemsize
        text += f"{name}:{schema_of(field)},"
    if end != dtype.itemsize:
        raise SchemaError(f"the dtype {dtype} ends in padding: add a field for it")
    return text + "}"


def type_of(data: TypeLike) -> MessageType[Any]:
    """The message type that a program has named."""
    if isinstance(data, MessageType):
        return data
    if data is bytes:
        return BYTES
    if data is str:
        return TEXT
    return Values(cast(npt.DTypeLike, data))
