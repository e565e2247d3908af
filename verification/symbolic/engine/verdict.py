"""The verdict on a run of a harness, and the file of results."""

import os
from pathlib import Path

from .machine import Exploration


def covered(seen: Exploration) -> str:
    """Describes the coverage in the words of `PROPERTIES.md`."""
    counted = f"Symbolic, {len(seen.models)} paths, {seen.rejected} rejected"
    return f"{counted}; first value one of {seen.firsts}" if seen.firsts else counted


def complaints(seen: Exploration, covers: int) -> list[str]:
    """Returns the reasons why a run does not show that a harness holds."""
    held = sum(seen.covers.values())
    checks = [
        (bool(seen.panics), f"{len(seen.panics)} paths panic"),
        (bool(seen.errors), f"{len(seen.errors)} paths cannot be explored"),
        (bool(seen.disagreements), f"{len(seen.disagreements)} paths go elsewhere when run"),
        (seen.unconstrained > 0, f"{seen.unconstrained} paths jump anywhere"),
        (seen.left > 0, f"{seen.left} paths are left"),
        (not seen.models, "no path returns"),
        (seen.values == 0, "it asks for no value"),
        (held != covers or len(seen.covers) != covers, f"{held} of {covers} covers can hold"),
    ]
    details = [
        *(f"  panic at {panic.place} with {panic.values}" for panic in seen.panics[:3]),
        *(f"  {error}" for error in seen.errors[:3]),
        *(f"  {disagreement}" for disagreement in seen.disagreements[:3]),
        *(f"  never holds: {name}" for name, holds in sorted(seen.covers.items()) if not holds),
    ]
    found = [complaint for applies, complaint in checks if applies]
    return found + details if found else []


def record(check: str, ok: bool, seconds: float, text: str) -> None:
    """Appends a line to the file of results, if the run has one."""
    if name := os.environ.get("SM2_VERIFICATION_RESULTS"):
        line = "\t".join(["angr", check, "ok" if ok else "FAILED", f"{seconds:.1f}", text])
        with Path(name).open("ab", buffering=0) as results:
            results.write(f"{line}\n".encode())
