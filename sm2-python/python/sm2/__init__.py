"""SM2 for Python: messages of any size go from process to process without a copy.

A publisher::

    with sm2.Node("camera") as node:
        publisher = node.publisher("image", "u1")
        publisher.wait_for_subscribers(1)
        with publisher.loan((1080, 1920, 3)) as image:
            image[:] = 127

A subscriber, in another process::

    with sm2.Node("viewer") as node:
        for sample in node.subscriber("image", "u1"):
            image = sample.numpy("u1", (1080, 1920, 3))

`image` is a view of the memory to which the camera has written. It keeps this memory: SM2 gives it to the next message
when the last view is gone.

- Times are in seconds, lengths in bytes, and times with the suffix `_ns` in nanoseconds of `time.monotonic_ns()`.
- A call that waits takes a `timeout`; `None` waits without a limit. Ctrl-C ends every wait with `KeyboardInterrupt`.
- All objects can be used by several threads. A child made by `os.fork` cannot use them (`ForkError`).
- Warnings go to the logger `sm2` of `logging`.
"""

from . import ros
from ._native import (
    BorrowLimitError,
    CallError,
    ClosedError,
    ConnectError,
    DeclareError,
    Error,
    ForkError,
    LoanError,
    Published,
    PublishError,
    QueryError,
    RecvError,
    ReplyError,
    Sample,
    SchemaError,
    Tick,
    TypeMismatchError,
    WaitError,
)
from ._node import Node
from ._publisher import Publisher
from ._service import Call, Client, Request, Server
from ._subscriber import Subscriber
from ._types import Json, MessageType, Plain, Values
from ._wait_set import Timer, WaitSet

__all__ = [
    "BorrowLimitError",
    "Call",
    "CallError",
    "Client",
    "ClosedError",
    "ConnectError",
    "DeclareError",
    "Error",
    "ForkError",
    "Json",
    "LoanError",
    "MessageType",
    "Node",
    "Plain",
    "PublishError",
    "Published",
    "Publisher",
    "QueryError",
    "RecvError",
    "ReplyError",
    "Request",
    "Sample",
    "SchemaError",
    "Server",
    "Subscriber",
    "Tick",
    "Timer",
    "TypeMismatchError",
    "Values",
    "WaitError",
    "WaitSet",
    "ros",
]
