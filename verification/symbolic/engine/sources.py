"""Reads the sources and `harnesses.toml`: the harnesses, and how each is explored."""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

from .build import CRATE, HERE

EXPLORED = re.compile(r"kani::explored!\s*\{(.*?)\}", re.DOTALL)
COVERS = re.compile(r"(\w+):\s*(\d+)")


def covers(root: Path) -> dict[str, int]:
    """Returns the number of covers of each harness, from `kani::explored!` at the end of its file."""
    sources = root / CRATE / "src"
    found: dict[str, int] = {}
    for file in sorted(sources.rglob("*.rs")):
        module = [CRATE.replace("-", "_"), *file.relative_to(sources).with_suffix("").parts]
        for block in EXPLORED.findall(file.read_text()):
            for name, count in COVERS.findall(block):
                found["::".join([*module, name])] = int(count)
    return found


@dataclass
class Plan:
    """The harnesses that are explored, with their CPU seconds, and the reason for each that is not."""

    quick: dict[str, int]
    full: dict[str, int]
    left_out: dict[str, str]
    # For some harnesses: the range of powers of two (each also less one) of the first value.
    around: dict[str, list[int]]

    def firsts(self) -> dict[str, list[int]]:
        """Returns the first values of each of these harnesses."""
        return {name: near(*powers) for name, powers in self.around.items()}

    def complaints(self, there: set[str]) -> list[str]:
        """Returns the differences between the plan and the harnesses of the sources."""
        lists = [*self.quick, *self.full, *self.left_out]
        return [
            *(f"{name} is not in harnesses.toml" for name in sorted(there - set(lists))),
            *(f"{name} is not in the sources" for name in sorted(set(lists) - there)),
            *(f"{name} has a first value only" for name in sorted(set(self.around) - set(lists))),
            *(f"{name} is listed twice" for name in sorted(set(lists)) if lists.count(name) > 1),
        ]


def near(least: int, most: int) -> list[int]:
    """Returns these powers of two, and the number before each."""
    powers = [1 << power for power in range(least, most + 1)]
    return sorted({value for power in powers for value in (power - 1, power)})


def plan() -> Plan:
    """Reads the plan of `harnesses.toml`."""
    return Plan(**tomllib.loads((HERE / "harnesses.toml").read_text()))
