"""`python -m sm2`: runs the program `sm2` of the wheel in the place of the interpreter."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import NoReturn

#: The exit statuses of a shell for a program that cannot be executed, and for one that does not exist.
NOT_EXECUTABLE, NOT_FOUND = 126, 127


def places() -> Iterator[Path]:
    """The files that may be the program."""
    # `pip install --target` moves the files that it has listed, so its list may name another program.
    yield Path(__file__).parents[1] / "bin" / "sm2"
    try:
        installed = metadata.files("sm2") or []
    except metadata.PackageNotFoundError:
        installed = []
    for file in installed:
        if file.name == "sm2":
            yield Path(os.path.normpath(file.locate()))


def fail(status: int, text: str) -> NoReturn:
    """Ends this program with an error."""
    print(f"python -m sm2: {text}", file=sys.stderr)
    sys.exit(status)


def main() -> NoReturn:
    """Executes the program with the arguments of this one."""
    searched = list(dict.fromkeys(places()))
    program = next((file for file in searched if file.is_file()), None)
    if program is None:
        fail(
            NOT_FOUND,
            f"the program sm2 of this package is missing, at {' and '.join(map(str, searched))}: install the package "
            "again with `pip install --force-reinstall`, or the program with `cargo install --path sm2-cli`",
        )
    # Python ignores these signals, and a program inherits that.
    for number in (signal.SIGPIPE, signal.SIGXFSZ):
        signal.signal(number, signal.SIG_DFL)
    try:
        os.execv(program, [str(program), *sys.argv[1:]])
    except OSError as error:
        fail(
            NOT_EXECUTABLE,
            f"{program} cannot be executed ({error.strerror}): it must be built for this machine, and its file system "
            "must allow programs",
        )


if __name__ == "__main__":
    main()
