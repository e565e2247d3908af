"""Builds the library that holds the harnesses, as Kani would: with `--cfg kani`."""

import os
import subprocess
from pathlib import Path

HERE = Path(__file__).resolve().parent.parent
CRATE = "sm2-proto"


def cargo(target: Path, *arguments: str, root: Path) -> None:
    """Runs Cargo with this folder's profile."""
    subprocess.run(
        ["cargo", "--config", str(HERE / "cargo.toml"), *arguments],
        cwd=root,
        env=os.environ | {"CARGO_TARGET_DIR": str(target)},
        check=True,
    )


def build(root: Path, target: Path) -> Path:
    """Builds the library of the sources in `root`; Cargo writes to `target`."""
    manifest = str(HERE / "kani" / "Cargo.toml")
    cargo(target, "build", "-q", "--release", "--locked", "--manifest-path", manifest, root=HERE)
    release = target / "release"
    cargo(
        target,
        *("rustc", "-q", "--release", "--locked", "-p", CRATE),
        *("--lib", "--crate-type", "cdylib", "--"),
        *("--cfg", "kani", "--extern", f"kani={release / 'libkani.rlib'}"),
        *("-L", f"dependency={release / 'deps'}", "-C", "symbol-mangling-version=v0"),
        root=root,
    )
    return release / "libsm2_proto.so"
