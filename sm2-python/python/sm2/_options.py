"""The options of publishers, subscribers, servers and clients."""

from __future__ import annotations

from typing import Any, TypedDict


class PublisherOptions(TypedDict, total=False):
    """The options of `Node.publisher`, which describes them."""

    keep_last: int
    reliable: bool
    latched: int
    publish_timeout: float
    wait_share_percent: int
    deadline: float
    liveliness: float
    lifespan: float
    sealed: bool
    inline_max: int
    pool_limit: int
    keep_idle: float
    max_len: int
    slots: int
    prefault: bool
    mlock: bool


class SubscriberOptions(TypedDict, total=False):
    """The options of `Node.subscriber`, which describes them."""

    keep_last: int
    reliable: bool
    max_borrowed: int
    deadline: float
    liveliness: float
    sealed: bool
    max_len: int


class ServerOptions(TypedDict, total=False):
    """The options of `Node.server`, which describes them."""

    depth: int
    max_borrowed: int
    sealed: bool
    inline_max: int
    max_len: int


class ClientOptions(TypedDict, total=False):
    """The options of `Node.client`, which describes them."""

    max_borrowed: int
    sealed: bool
    inline_max: int
    max_len: int


def filled(kind: type[Any], options: Any) -> dict[str, Any]:
    """All options of a kind, as the native module takes them; None stands for a default."""
    known = kind.__annotations__
    for name in options:
        if name not in known:
            raise TypeError(f"unknown option {name}: the options are {', '.join(known)}")
    return {name: options.get(name) for name in known}
