"""`python -m sm2`, and the program `sm2` that pip installs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path

import pytest
from helpers import SOON, Child, until

import sm2
import sm2.__main__ as command

#: The program beside the interpreter, which is what the tests compare with.
PROGRAM = Path(sysconfig.get_path("scripts")) / "sm2"

COMMANDS = {"module": [sys.executable, "-m", "sm2"], "program": [str(PROGRAM)]}


@pytest.fixture(params=COMMANDS)
def sm2_command(request: pytest.FixtureRequest) -> list[str]:
    """Both ways to call the program: all tests hold for both."""
    return COMMANDS[request.param]


@pytest.fixture
def start(sm2_command: list[str]) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts the program."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        pipe = subprocess.PIPE
        started.append(subprocess.Popen([*sm2_command, *arguments], stdout=pipe, stderr=pipe, text=True))
        return started[-1]

    yield start
    for it in started:
        it.kill()
        it.wait(SOON)


Start = Callable[..., subprocess.Popen[str]]


def run(command: list[str], *arguments: str) -> tuple[int, str, str]:
    """The status of the program, and what it printed."""
    ended = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=SOON)
    return ended.returncode, ended.stdout, ended.stderr


def first_line(process: subprocess.Popen[str]) -> str:
    """The next line that the program prints."""
    assert process.stdout is not None
    return process.stdout.readline()


def test_the_version_is_that_of_the_package(sm2_command: list[str]) -> None:
    assert run(sm2_command, "--version") == (0, f"sm2 {metadata.version('sm2')}\n", "")


def test_all_commands_are_there(sm2_command: list[str]) -> None:
    status, out, _ = run(sm2_command, "--help")
    assert status == 0
    for name in ["topic", "service", "node", "top", "view", "doctor", "record", "play", "bag", "manager", "gateway"]:
        assert f"\n  {name} " in out


def test_topics_of_a_domain_are_listed(node: sm2.Node, sm2_command: list[str]) -> None:
    publisher = node.publisher("camera/image", "u1")
    status, out, errors = run(sm2_command, "topic", "list")
    assert (status, errors) == (0, "") and publisher.topic in out


def test_without_a_manager_the_error_is_that_of_the_program(tmp_path: Path, sm2_command: list[str]) -> None:
    socket = str(tmp_path / "none")
    status, out, errors = run(sm2_command, "topic", "list", "--socket", socket)
    assert out == "" and errors.startswith(f"sm2: no Manager answers at {socket}")
    assert run(COMMANDS["program"], "topic", "list", "--socket", socket) == (status, out, errors)


def test_an_unknown_command_is_wrong_usage(sm2_command: list[str]) -> None:
    status, out, errors = run(sm2_command, "no-such-command")
    assert (status, out) == (2, "")
    assert errors.startswith("sm2: ") and "no-such-command" in errors


# Without a count, Ctrl-C is the regular end of `topic echo`.
@pytest.mark.parametrize(("options", "expected"), [([], 0), (["--count", "100"], 128 + signal.SIGINT)])
def test_ctrl_c_ends_an_echo_in_order(node: sm2.Node, start: Start, options: list[str], expected: int) -> None:
    publisher = node.publisher("text", str)
    echo = start("topic", "echo", "text", *options)
    publisher.wait_for_subscribers(1, SOON)
    publisher.publish("hello")
    assert "hello" in first_line(echo)
    echo.send_signal(signal.SIGINT)
    out, errors = echo.communicate(timeout=SOON)
    assert (echo.returncode, out) == (expected, "")
    assert errors.startswith("received 1 message ")


def test_a_pipe_that_closes_ends_an_echo_without_an_error(node: sm2.Node, start: Start) -> None:
    publisher = node.publisher("text", str)
    echo = start("topic", "echo", "text")
    publisher.wait_for_subscribers(1, SOON)
    publisher.publish("hello")
    assert "hello" in first_line(echo)
    assert echo.stdout is not None and echo.stderr is not None
    echo.stdout.close()

    def ended() -> bool:
        publisher.publish("nobody reads this")
        return echo.poll() is not None

    until(ended, "the echo ends")
    assert echo.returncode == 0
    assert "sm2:" not in echo.stderr.read()


def test_signals_have_their_default_again(tmp_path: Path) -> None:
    # Python ignores SIGPIPE and SIGXFSZ: the masks of `python -c` are those of a program that inherits them.
    lines = "import os, sm2.__main__ as command\ncommand.places = lambda: iter([command.Path('/bin/sh')])\n"
    lines += "import sys\nsys.argv[1:] = ['-c', 'cat /proc/self/status']\ncommand.main()"
    status, out, errors = run([sys.executable, "-c", lines])
    assert (status, errors) == (0, "")
    ignored = int(next(line for line in out.splitlines() if line.startswith("SigIgn:")).split()[1], 16)
    for number in (signal.SIGPIPE, signal.SIGXFSZ):
        assert not ignored >> (number - 1) & 1


@pytest.mark.parametrize("exists", [False, True])
def test_a_program_that_cannot_be_executed_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], exists: bool
) -> None:
    program = tmp_path / "sm2"
    monkeypatch.setattr(command, "places", lambda: iter([program]))
    # The other case is a file without a format that the kernel knows.
    if exists:
        program.write_bytes(b"\0")
        program.chmod(0o755)
    handlers = [signal.getsignal(number) for number in (signal.SIGPIPE, signal.SIGXFSZ)]
    with pytest.raises(SystemExit) as ended:
        command.main()
    for number, handler in zip((signal.SIGPIPE, signal.SIGXFSZ), handlers):
        signal.signal(number, handler)
    out, errors = capsys.readouterr()
    assert (ended.value.code, out) == (126 if exists else 127, "")
    assert str(program) in errors
    assert ("cannot be executed" if exists else "pip install --force-reinstall") in errors


def test_the_program_is_found_through_the_list_of_installed_files() -> None:
    found = [place for place in command.places() if place.is_file()]
    assert [os.path.realpath(place) for place in found] == [os.path.realpath(PROGRAM)]
