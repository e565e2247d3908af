"""Nodes: the sessions of a program with a domain."""

from __future__ import annotations

import os
from typing import Any, TypeVar, Unpack, overload
from weakref import WeakSet

import numpy.typing as npt

from . import _native
from ._closing import Closing
from ._interface import Interface
from ._options import ClientOptions, PublisherOptions, ServerOptions, SubscriberOptions, filled
from ._publisher import Publisher
from ._service import Client, Server
from ._subscriber import Subscriber
from ._types import BYTES, Array, MessageType, TypeLike, type_of

T = TypeVar("T")
I = TypeVar("I", bound=Interface)


class Node(Closing):
    """A node of a domain, with a unique name. It publishes and subscribes, and serves and calls services.

    As a context manager, it is closed at the end of the block, together with its publishers, subscribers, servers and
    clients. Samples stay valid.
    """

    def __init__(
        self,
        name: str,
        *,
        domain: str | None = None,
        socket: str | os.PathLike[str] | None = None,
        manager_timeout: float | None = None,
        startup_timeout: float | None = None,
        ring_lane: bool | None = None,
        background: bool | None = None,
        standby_manager: bool = False,
    ) -> None:
        """Connects to the Manager of a domain. Raises `ConnectError`.

        - `domain`, `socket`: the domain, or the path of its socket; by default those of the environment (`SM2_DOMAIN`,
          `SM2_SOCKET`).
        - `manager_timeout`: how long the Manager may take for an answer; 5 s by default.
        - `startup_timeout`: how long to wait for a Manager to start if none is running; 0 by default.
        - `standby_manager`: this process runs a Manager if the domain has none, and otherwise takes over when the
          Manager of the domain ends.
        - `ring_lane`, `background`: see the book; both are on by default.
        """
        options = {
            "domain": domain,
            "socket": None if socket is None else os.fspath(socket),
            "manager_timeout": manager_timeout,
            "startup_timeout": startup_timeout,
            "ring_lane": ring_lane,
            "background": background,
            "standby_manager": standby_manager,
        }
        self._native = _native.Node(name, options)
        self._interfaces: WeakSet[Interface] = WeakSet()

    @property
    def name(self) -> str:
        """The name of the node."""
        return self._native.name

    @property
    def is_connected(self) -> bool:
        """Whether the node has a session with a Manager. Messages flow without one, too."""
        return self._native.is_connected

    def wait_connected(self, timeout: float | None = None) -> None:
        """Waits until `is_connected`. Raises `WaitError` after the timeout."""
        self._native.wait_connected(timeout)

    @overload
    def publisher(
        self, topic: str, type: type[bytes] = bytes, **options: Unpack[PublisherOptions]
    ) -> Publisher[bytes]: ...

    @overload
    def publisher(
        self, topic: str, type: type[str], **options: Unpack[PublisherOptions]
    ) -> Publisher[str]: ...

    @overload
    def publisher(
        self, topic: str, type: MessageType[T], **options: Unpack[PublisherOptions]
    ) -> Publisher[T]: ...

    @overload
    def publisher(
        self, topic: str, type: npt.DTypeLike, **options: Unpack[PublisherOptions]
    ) -> Publisher[Array]: ...

    def publisher(
        self, topic: str, type: TypeLike = bytes, **options: Unpack[PublisherOptions]
    ) -> Publisher[Any]:
        """Declares a publisher of messages of this type (see `MessageType`). Raises `DeclareError`.

        Options that are left out have the defaults of SM2:

        - `keep_last`: how many messages wait for each subscriber; 8.
        - `reliable`: no message displaces another one for subscribers that request it; then `publish` may wait, for at
          most `publish_timeout` (0.1 s) and `wait_share_percent` of the time (1).
        - `latched`: how many of the last messages a new subscriber gets; 0.
        - `deadline`, `liveliness`: promises a message, or a sign of life, at least once in each such period.
        - `lifespan`: messages that are older are not delivered.
        - `sealed`: the kernel protects each message from changes.
        - `max_len`, `slots`, `prefault`, `mlock`: memory for `slots` messages of up to `max_len` bytes is reserved now;
          it is made present and locked if requested.
        - `pool_limit`, `keep_idle`, `inline_max`: how much further memory messages may use, how long it is kept while
          it is not used, and which messages go through the socket.
        """
        data = type_of(type)
        native = self._native.publisher(topic, data.native, filled(PublisherOptions, options))
        return self._add(Publisher(native, data))

    @overload
    def subscriber(
        self, topic: str, type: type[bytes] | None = None, **options: Unpack[SubscriberOptions]
    ) -> Subscriber[bytes]: ...

    @overload
    def subscriber(
        self, topic: str, type: type[str], **options: Unpack[SubscriberOptions]
    ) -> Subscriber[str]: ...

    @overload
    def subscriber(
        self, topic: str, type: MessageType[T], **options: Unpack[SubscriberOptions]
    ) -> Subscriber[T]: ...

    @overload
    def subscriber(
        self, topic: str, type: npt.DTypeLike, **options: Unpack[SubscriberOptions]
    ) -> Subscriber[Array]: ...

    def subscriber(
        self, topic: str, type: TypeLike | None = None, **options: Unpack[SubscriberOptions]
    ) -> Subscriber[Any]:
        """Declares a subscriber for messages of this type (see `MessageType`). Raises `DeclareError`.

        Without a type, it accepts every type, and `Sample.value` returns bytes. Options that are left out have the
        defaults of SM2:

        - `keep_last`: how many messages of each publisher wait to be taken; 8.
        - `reliable`: no message displaces another one. Matches only reliable publishers.
        - `max_borrowed`: how many samples of each publisher the program may hold; 4. Samples of up to 104 bytes
          usually are copies, which do not count.
        - `deadline`, `liveliness`: demands a message, or a sign of life, of each publisher in each such period.
        - `sealed`: accepts only messages that their publisher cannot change.
        - `max_len`: the longest message that is accepted; 1 GiB.
        """
        data = BYTES if type is None else type_of(type)
        declared = None if type is None else data.native
        given = filled(SubscriberOptions, options)
        return self._add(Subscriber(self._native.subscriber(topic, declared, data.decode, given), data))

    def server(
        self,
        service: str,
        request: TypeLike = bytes,
        reply: TypeLike = bytes,
        **options: Unpack[ServerOptions],
    ) -> Server[Any, Any]:
        """Declares a server that answers requests of one type with replies of another one. Raises `DeclareError`.

        - `depth`: how many requests of each client wait at this server; 64.
        - `max_borrowed`: how many requests of each client the program may hold; 16. Short ones do not count, as for
          `subscriber`.
        - `max_len`: the longest request that is accepted; 1 GiB.
        - `sealed`, `inline_max`: as for `publisher`.
        """
        types = (type_of(request), type_of(reply))
        given = filled(ServerOptions, options)
        native = self._native.server(service, types[0].native, types[1].native, given)
        return self._add(Server(native, *types))

    def client(
        self,
        service: str,
        request: TypeLike = bytes,
        reply: TypeLike = bytes,
        **options: Unpack[ClientOptions],
    ) -> Client[Any, Any]:
        """Declares a client of a service. Raises `DeclareError`.

        - `max_borrowed`: how many pending calls the program may have at each server; 64.
        - `max_len`: the longest reply that is accepted; 1 GiB.
        - `sealed`, `inline_max`: as for `publisher`.
        """
        types = (type_of(request), type_of(reply))
        given = filled(ClientOptions, options)
        native = self._native.client(service, types[0].native, types[1].native, given)
        return self._add(Client(native, *types))

    def describe(self, type: TypeLike) -> str | None:
        """The schema text of a type, if a node of the domain has registered it. Raises `QueryError`."""
        return self._native.describe(type_of(type).native)

    def fileno(self) -> int:
        """The descriptor of the session, for a node without a background thread: see `spin_some`."""
        return self._native.fileno()

    def spin_some(self) -> None:
        """Does the pending work of a node without a background thread (`background=False`)."""
        self._native.spin_some()

    def close(self) -> None:
        """Closes the node and all its publishers, subscribers, servers and clients. Samples stay valid."""
        for interface in list(self._interfaces):
            interface.close()
        self._native.close()

    @property
    def closed(self) -> bool:
        """Whether the node is closed."""
        return self._native.closed

    def _add(self, interface: I) -> I:
        self._interfaces.add(interface)
        return interface

    def __repr__(self) -> str:
        return f"<Node {self.name}>"
