"""What the tests share: the time limit, a Manager, and child processes."""

from __future__ import annotations

import faulthandler
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import sm2

#: The time limit of everything that has to succeed, in seconds: generous, because the machine may be busy.
SOON = 60.0

#: A hung test ends with the stacks of all threads instead of never.
TEST_MAX_S = 10 * SOON


def limit_from_now() -> None:
    """Ends the test program after `TEST_MAX_S`, unless this function is called again. A long test calls it each time
    that it has made progress."""
    faulthandler.dump_traceback_later(TEST_MAX_S, exit=True)


def until(condition: Callable[[], bool], what: str) -> None:
    """Waits until the condition holds."""
    end = time.monotonic() + SOON
    while not condition():
        assert time.monotonic() < end, f"not within {SOON} s: {what}"
        time.sleep(0.005)


def received(subscriber: sm2.Subscriber[Any]) -> sm2.Sample[Any]:
    """The next sample."""
    sample = subscriber.recv(SOON)
    assert sample is not None, f"no message of {subscriber.topic}: {subscriber.why()}"
    return sample


def linked(
    node: sm2.Node, topic: str, type: Any, publisher: dict[str, Any], subscriber: dict[str, Any]
) -> tuple[sm2.Publisher[Any], sm2.Subscriber[Any]]:
    """A publisher and a subscriber of a topic whose link is open."""
    sender: sm2.Publisher[Any] = node.publisher(topic, type, **publisher)
    receiver: sm2.Subscriber[Any] = node.subscriber(topic, type, **subscriber)
    sender.wait_for_subscribers(1, SOON)
    receiver.wait_for_publishers(1, SOON)
    return sender, receiver


def seeded() -> random.Random:
    """A source of random choices. The seed is printed; `SM2_TEST_SEED` sets it."""
    seed = int(os.environ.get("SM2_TEST_SEED", "1"))
    print(f"SM2_TEST_SEED={seed}")
    return random.Random(seed)


class Child:
    """A Python process that runs a program text and talks to the test by lines."""

    def __init__(self, program: str, socket: Path) -> None:
        paths = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
        # A shell lets its background programs ignore SIGINT, and children inherit that.
        heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        # A signal may come before asyncio has begun with a coroutine.
        warnings = "ignore:coroutine:RuntimeWarning"
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-X", "faulthandler", "-W", warnings, "-c", heed + program],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "SM2_SOCKET": str(socket), "PYTHONPATH": os.pathsep.join(paths)},
        )

    def line(self) -> str:
        """The next line that the child prints."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, f"the child ended: {self.wait()}"
        return line.rstrip("\n")

    def send(self, line: str) -> None:
        """Passes a line to the child."""
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def signal(self, number: signal.Signals) -> None:
        """Sends a signal to the child."""
        self.process.send_signal(number)
        if number == signal.SIGSTOP:
            # The signal has been sent, and its threads may still run.
            until(self._is_stopped, "all threads are stopped")

    def _is_stopped(self) -> bool:
        threads = Path(f"/proc/{self.process.pid}/task").glob("*/stat")
        # The name in brackets before the state may contain any character.
        return all(it.read_text().rpartition(") ")[2].startswith("T") for it in threads)

    def wait(self) -> tuple[int, str, str]:
        """Its exit status, and the rest of what it printed."""
        out, errors = self.process.communicate(timeout=SOON)
        return self.process.returncode, out, errors

    def kill(self) -> None:
        """Kills it, if it runs."""
        self.process.kill()
        self.process.communicate(timeout=SOON)
