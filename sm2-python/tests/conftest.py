"""Fixtures: a domain of its own for each test."""

from __future__ import annotations

import faulthandler
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from helpers import Child, limit_from_now

import sm2

MANAGER = """
import sm2, sys
node = sm2.Node("manager", standby_manager=True)
print("ready")
sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def limit() -> Iterator[None]:
    """Ends the test program if a test hangs."""
    limit_from_now()
    yield
    faulthandler.cancel_dump_traceback_later()


@pytest.fixture
def child(tmp_path: Path) -> Iterator[Callable[[str], Child]]:
    """Starts Python processes in the domain of the test."""
    children: list[Child] = []

    def start(program: str) -> Child:
        children.append(Child(program, tmp_path / "socket"))
        return children[-1]

    yield start
    for it in children:
        it.kill()


@pytest.fixture
def domain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, child: Callable[[str], Child]) -> Child:
    """A domain with a Manager in a process of its own, which is returned."""
    monkeypatch.setenv("SM2_SOCKET", str(tmp_path / "socket"))
    manager = child(MANAGER)
    assert manager.line() == "ready"
    return manager


@pytest.fixture
def node(domain: Child) -> Iterator[sm2.Node]:
    """A node of the domain."""
    with sm2.Node("test") as node:
        yield node
