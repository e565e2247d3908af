"""Explores the harnesses of `harnesses.toml`: `verification/symbolic/run --help`."""

import argparse
import sys
from pathlib import Path

from . import child, faults, sources
from .build import HERE, build
from .machine import Library
from .verdict import complaints, covered, record

# Enough for each of the faults.
FAULT_SECONDS = 60


def options() -> argparse.Namespace:
    """Parses the command line."""
    parser = argparse.ArgumentParser(prog="verification/symbolic/run", description=__doc__)
    parser.add_argument("--target", type=Path, required=True, help=argparse.SUPPRESS)
    parser.add_argument("--quick", action="store_true", help="only those that take seconds")
    parser.add_argument("--self-check", action="store_true", help="find faults made on purpose")
    parser.add_argument(
        "--any-time",
        type=int,
        metavar="S",
        help="CPU seconds for all alike; also explores what is left out, by name",
    )
    parser.add_argument("--list", action="store_true", help="name all that a full run explores")
    parser.add_argument("harness", nargs="*", help="its name or a part of it; else all")
    return parser.parse_args()


def main() -> int:
    """Returns the exit status."""
    asked, root = options(), HERE.parent.parent
    if asked.self_check:
        return 0 if faults.check(root, asked.target, FAULT_SECONDS) else 1
    plan = sources.plan()
    if asked.list:
        print(*sorted(plan.quick | plan.full), sep="\n")
        return 0
    limits, nameless = chosen(plan, asked)
    if nameless or not limits:
        print(f"not explored: {nameless}; see harnesses.toml")
        return 1
    library = Library(build(root, asked.target), plan.firsts())
    failed = plan.complaints(set(library.harnesses))
    for complaint in failed:
        print(complaint)
    return 1 if not explored(library, root, limits, asked.any_time) or failed else 0


def chosen(plan: sources.Plan, asked: argparse.Namespace) -> tuple[dict[str, int], list[str]]:
    """Returns the requested harnesses with their CPU seconds, and the names that match none."""
    limits = plan.quick if asked.quick else plan.quick | plan.full
    if not asked.harness:
        return limits, []
    if asked.any_time and not asked.quick:
        limits = limits | dict.fromkeys(plan.left_out, asked.any_time)
    # A whole name may be a part of another.
    named = {it: [it] if it in limits else [at for at in limits if it in at] for it in asked.harness}
    wanted = {it for them in named.values() for it in them}
    nameless = [it for it, them in named.items() if not them]
    return {it: limits[it] for it in limits if it in wanted}, nameless


def explored(library: Library, root: Path, limits: dict[str, int], any_time: int | None) -> bool:
    """Runs the harnesses. Returns True if all of them hold."""
    counts, good = sources.covers(root), bool(limits)
    for harness, cpu_seconds in limits.items():
        if harness not in library.harnesses:
            continue
        seen = child.explore(library, harness, any_time or cpu_seconds)
        # -1: a harness without a count of covers must not pass.
        said = complaints(seen, counts.get(harness, -1))
        good = good and not said
        word = "FAILED" if said else "ok    "
        print(f"{word}  {harness}: {covered(seen)}, {seen.seconds:.1f} s CPU", flush=True)
        for complaint in said:
            print(f"        {complaint}")
        record(harness, not said, seen.seconds, covered(seen))
    return good


if __name__ == "__main__":
    sys.exit(main())
