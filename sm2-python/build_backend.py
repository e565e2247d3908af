"""The build backend (PEP 517 and 660): maturin, with the program `sm2` among the scripts of the wheel.

The program is that of the crate sm2-cli, built for size. Cargo's variables hold for it as well, `CARGO_BUILD_TARGET`
for example; arguments for maturin do not. A source distribution does not contain this crate, so the wheel that is built
from it has no program.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import maturin
import zopfli

CRATE = Path(__file__).resolve().parents[1] / "sm2-cli"
#: The key `data` of `pyproject.toml` has the parent of this folder. A build backend runs in the folder of that file.
SCRIPTS = Path("target", "data", "scripts").resolve()

Settings = Mapping[str, Any] | None


def build_program() -> None:
    """Builds the program, and puts it where maturin finds it."""
    make_folder()
    if not CRATE.is_dir():
        print(f"without the program sm2: there is no crate {CRATE}", file=sys.stderr)
        return
    if shutil.which("cargo") is None:
        # maturin has requested this package, which downloads Rust.
        from puccinialin import setup_rust

        os.environ.update(setup_rust())
    target = Path(os.environ.get("CARGO_TARGET_DIR", "target")).resolve() / "command"
    command = ["cargo", "install", "--locked", "--profile", "small", "--bin", "sm2", "--path", str(CRATE)]
    # `cargo install` puts the program into the same place for every target. Cargo's list of installed programs is
    # for folders in PATH.
    command += ["--root", str(target / "installed"), "--no-track", "--force", "--target-dir", str(target)]
    subprocess.run(command, check=True)
    shutil.copy2(target / "installed" / "bin" / "sm2", SCRIPTS / "sm2")
    # A panic aborts this program, so nothing reads its tables for unwinding: the standard library's code causes them.
    # The program only stays longer if objcopy is missing, or cannot read programs of the target.
    if shutil.which("objcopy") is not None:
        subprocess.run(["objcopy", "-R", ".eh_frame", "-R", ".eh_frame_hdr", SCRIPTS / "sm2"], check=False)


def make_folder() -> None:
    """Makes the folder of the scripts, which maturin wants for each of its tasks."""
    SCRIPTS.mkdir(parents=True, exist_ok=True)


def compress(wheel: Path) -> None:
    """Compresses the wheel again: zopfli needs some seconds, and its result is shorter than that of zlib."""
    with tempfile.TemporaryDirectory(dir=wheel.parent) as folder:
        smaller = Path(folder, wheel.name)
        with zipfile.ZipFile(wheel) as old, zopfli.ZipFile(smaller, "w", zipfile.ZIP_DEFLATED, iterations=2) as new:
            for entry in old.infolist():
                new.writestr(entry, old.read(entry))
        smaller.replace(wheel)


def build_wheel(
    wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None
) -> str:
    """Builds the wheel, and returns the name of its file."""
    build_program()
    name = maturin.build_wheel(wheel_directory, config_settings, metadata_directory)
    compress(Path(wheel_directory, name))
    return name


def build_editable(
    wheel_directory: str, config_settings: Settings = None, metadata_directory: str | None = None
) -> str:
    """Builds the wheel of `pip install --editable`, and returns the name of its file."""
    build_program()
    return maturin.build_editable(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory: str, config_settings: Settings = None) -> str:
    """Packs the sources, and returns the name of the file."""
    make_folder()
    return maturin.build_sdist(sdist_directory, config_settings)


def prepare_metadata_for_build_wheel(metadata_directory: str, config_settings: Settings = None) -> str:
    """Writes the metadata of the wheel, and returns the name of their folder."""
    make_folder()
    return maturin.prepare_metadata_for_build_wheel(metadata_directory, config_settings)


prepare_metadata_for_build_editable = prepare_metadata_for_build_wheel
get_requires_for_build_wheel = maturin.get_requires_for_build_wheel
get_requires_for_build_editable = maturin.get_requires_for_build_editable
get_requires_for_build_sdist = maturin.get_requires_for_build_sdist
