"""Makes deliberate faults in a copy of the sources: each must be found."""

import shutil
import tomllib
from dataclasses import dataclass
from pathlib import Path

from . import child, sources
from .build import HERE, build
from .machine import Exploration, Library
from .verdict import complaints

# Files that Cargo does not need.
NOT_COPIED = shutil.ignore_patterns("target", ".git", "corpus", "artifacts")


@dataclass
class Fault:
    """A text that occurs once in a file, its replacement, and how the fault must be found."""

    name: str
    file: str
    text: str
    instead: str
    harness: str
    said: str

    def make(self, copy: Path) -> None:
        """Makes the fault in a copy of the sources."""
        file = copy / self.file
        sound = file.read_text()
        if sound.count(self.text) != 1:
            raise ValueError(f"not once in {self.file}: `{self.text}`; mend faults.toml")
        file.write_text(sound.replace(self.text, self.instead))


def faults() -> list[Fault]:
    """Reads the faults of `faults.toml`."""
    return [Fault(**it) for it in tomllib.loads((HERE / "faults.toml").read_text())["fault"]]


def check(root: Path, target: Path, cpu_seconds: int) -> bool:
    """Makes the faults, and prints how each was found."""
    copy, made = target / "faulty", faults()
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(root, copy, ignore=NOT_COPIED)
    for fault in made:
        fault.make(copy)
    firsts = sources.plan().firsts()
    library = Library(build(copy, target / "faulty-build"), firsts)
    counts, found = sources.covers(copy), []
    for fault in made:
        seen = child.explore(library, fault.harness, cpu_seconds, first_panic=True)
        # A counterexample must also fail on the processor.
        said = [] if seen.disagreements else complaints(seen, counts[fault.harness])
        found.append(tell(fault.name, fault.said, said, seen))
    sound = Library(build(root, target), firsts, mended=False)
    found.append(finds_wrong_arithmetic(sound, sources.covers(root), cpu_seconds))
    return all(found)


def finds_wrong_arithmetic(library: Library, counts: dict[str, int], cpu_seconds: int) -> bool:
    """Whether the processor finds what `arithmetic.py` mends, if that is left out."""
    harness = "sm2_proto::link::proofs::slots_are_inside"
    seen = child.explore(library, harness, cpu_seconds, first_panic=True)
    said = complaints(seen, counts[harness])
    return tell("angr's own multiplication", "paths go elsewhere when run", said, seen)


def tell(name: str, expected: str, said: list[str], seen: Exploration) -> bool:
    """Prints the result, and whether it is the expected one."""
    found = any(expected in complaint for complaint in said)
    print(f"{'found ' if found else 'MISSED'}  {name} ({seen.seconds:.1f} s CPU)", flush=True)
    for complaint in said:
        print(f"        {complaint}")
    return found
