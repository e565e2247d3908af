"""Explores all paths of one function of a library."""

import re
import time
from dataclasses import dataclass, field
from pathlib import Path

import angr
import claripy
import pydemumble
from angr import options
from angr.concretization_strategies import SimConcretizationStrategySolutions
from claripy.ast import BV

from . import arithmetic
from .memory import IMPORTS, Unknown
from .replay import Entry, Model

# The return address of a harness, which has no code.
RETURNED = 0xDEAD0000
# The greatest number of addresses that a symbolic address may have. More is an error, not a guess.
ADDRESSES_MAX = 256


@dataclass
class Exploration:
    """What the paths of one harness did."""

    rejected: int = 0
    # Values for each path that panicked or returned.
    panics: list[Model] = field(default_factory=list)
    models: list[Model] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    # Paths on which the processor behaves differently.
    disagreements: list[str] = field(default_factory=list)
    unconstrained: int = 0
    left: int = 0
    # Each cover that was reached, and whether it can hold.
    covers: dict[str, bool] = field(default_factory=dict)
    # The number of requested values, on all paths.
    values: int = 0
    # The number of possible first values, if they are limited.
    firsts: int = 0
    seconds: float = 0.0


class Hook(angr.SimProcedure):
    """A hook that records what happens."""

    def text(self, at: BV, length: BV) -> str:
        """Reads a string of the library."""
        start, size = self.state.solver.eval_one(at), self.state.solver.eval_one(length)
        if size == 0:
            return ""
        return self.state.solver.eval(self.state.memory.load(start, size), bytes).decode()

    @property
    def seen(self) -> Exploration:
        """The exploration that records the events."""
        return self.state.globals["seen"]


class Any(Hook):
    """Returns an unconstrained value."""

    def run(self, bits: BV) -> BV:
        width = self.state.solver.eval_one(bits[31:0])
        value, first = claripy.BVS("any", width), self.state.globals["first"]
        if first is not None and not self.state.globals["values"]:
            value = claripy.BVV(first, width)
        self.state.globals["values"] += (value,)
        self.seen.values += 1
        return value.zero_extend(64 - width)


class Assume(Hook):
    """Continues only with values for which the condition holds."""

    def run(self, condition: BV) -> None:
        holds = condition[7:0] != 0
        if not self.state.solver.satisfiable(extra_constraints=[holds]):
            self.seen.rejected += 1
        self.state.add_constraints(holds)


class Cover(Hook):
    """Records whether the condition can hold."""

    def run(self, condition: BV, text: BV, length: BV) -> None:
        name, covers = self.text(text, length), self.seen.covers
        holds = condition[7:0] != 0
        self.state.globals["covers"] += (holds,)
        if not covers.setdefault(name, False):
            covers[name] = self.state.solver.satisfiable(extra_constraints=[holds])


class Fail(Hook):
    """Ends a path that has panicked."""

    NO_RET = True

    def run(self, file: BV, length: BV, line: BV) -> None:
        place = f"{self.text(file, length)}:{self.state.solver.eval(line[31:0])}"
        self.seen.panics.append(model(self.state, place))
        self.exit(0)


def model(state: angr.SimState, place: str = "") -> Model:
    """Returns values with which the harness takes this path."""
    values, covers = state.globals["values"], state.globals["covers"]
    bits = [claripy.If(holds, claripy.BVV(1, 1), claripy.BVV(0, 1)) for holds in covers]
    parts = [*values, *bits]
    # One query to the solver, so that all answers are consistent.
    together = state.solver.eval(claripy.Concat(*parts)) if parts else 0
    found = []
    for part in reversed(parts):
        found.append(together & ((1 << part.length) - 1))
        together >>= part.length
    found.reverse()
    return Model(found[: len(values)], [bit == 1 for bit in found[len(values) :]], place)


HOOKS: dict[str, type[Hook]] = {
    "sm2_symbolic_any": Any,
    "sm2_symbolic_assume": Assume,
    "sm2_symbolic_cover": Cover,
    "sm2_symbolic_panic": Fail,
}


class Library:
    """A library that contains harnesses.

    The harnesses in `firsts` are explored with each of the listed values as the first value.
    """

    def __init__(self, path: Path, firsts: dict[str, list[int]], mended: bool = True) -> None:
        arithmetic.mend(mended)
        self.path, self.firsts = path.resolve(), firsts
        self.project = angr.Project(path, auto_load_libs=False, use_sim_procedures=False)
        binary = self.project.loader.main_object
        for name in binary.imports:
            self.project.hook_symbol(name, IMPORTS.get(name, Unknown)(), replace=True)
        for name, hook in HOOKS.items():
            if not self.project.hook_symbol(name, hook(), replace=True):
                raise KeyError(f"{path} has no {name}")
        names, kept = {}, []
        for symbol in binary.symbols:
            name = re.sub(r"\[[0-9a-f]+\]", "", pydemumble.demangle(symbol.name))
            if name.endswith("::HARNESS"):
                kept.append(symbol.rebased_addr)
            elif symbol.is_function:
                names[symbol.rebased_addr] = name
        memory = self.project.loader.memory
        addresses = [memory.unpack_word(at) for at in kept]
        self.harnesses = {names[address]: address for address in addresses}

    def explore(self, harness: str, cpu_seconds: float, first_panic: bool = False) -> Exploration:
        """Explores all paths of a harness, or as many as the CPU time allows.

        With `first_panic` it stops at the first panic, which is enough to show a fault.
        """
        seen, started = Exploration(), time.process_time()
        firsts = self.firsts.get(harness, [])
        seen.firsts = len(firsts)
        open_paths = [self.begin(harness, seen, first) for first in firsts or [None]]
        while open_paths and not (first_panic and seen.panics):
            seen.seconds = time.process_time() - started
            if seen.seconds > cpu_seconds:
                break
            state = open_paths.pop()
            if state.addr == RETURNED:
                seen.models.append(model(state))
                continue
            try:
                after = self.project.factory.successors(state)
            except Exception as cause:  # Whatever it is: this path was not explored.
                seen.errors.append(f"{type(cause).__name__} at {state.addr:#x}: {cause}")
                continue
            seen.unconstrained += len(after.unconstrained_successors)
            open_paths += [it for it in after.flat_successors if it.history.jumpkind != "Ijk_Exit"]
        seen.left = len(open_paths)
        seen.seconds = time.process_time() - started
        return seen

    def entry(self, harness: str) -> Entry:
        """Returns the location of a harness, for runs on the processor."""
        binary = self.project.loader.main_object
        replay = self.project.loader.find_symbol("sm2_symbolic_replay")
        base = binary.mapped_base
        return Entry(self.path, replay.rebased_addr - base, self.harnesses[harness] - base)

    def begin(self, harness: str, seen: Exploration, first: int | None) -> angr.SimState:
        """Returns the state in which a harness is called: unwritten memory is unknown."""
        state = self.project.factory.call_state(
            self.harnesses[harness],
            ret_addr=RETURNED,
            add_options={
                options.STRICT_PAGE_ACCESS,
                options.SYMBOL_FILL_UNCONSTRAINED_MEMORY,
                options.SYMBOL_FILL_UNCONSTRAINED_REGISTERS,
            },
        )
        few = SimConcretizationStrategySolutions(ADDRESSES_MAX)
        state.memory.read_strategies = [few]
        state.memory.write_strategies = [few]
        noted = {"seen": seen, "values": (), "covers": (), "first": first}
        for name, value in noted.items():
            state.globals[name] = value
        return state
