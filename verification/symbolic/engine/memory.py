"""The imports of the library: functions on memory, exact for any length that a path allows.

angr's own procedures choose one length where several are possible. These functions build one
expression for all lengths, or report an error.
"""

import angr
import claripy
from claripy.ast import BV

# A longer range with a symbolic length is an error, not a guess.
SYMBOLIC_LENGTH_MAX = 4096


class Unexplored(angr.errors.SimError):
    """The path leads to an operation that this engine does not explore."""


def longest(state: angr.SimState, length: BV) -> int:
    """Returns the greatest value of a length."""
    if state.solver.single_valued(length):
        return state.solver.eval(length)
    most = state.solver.max(length)
    if most > SYMBOLIC_LENGTH_MAX:
        raise Unexplored(f"a length of up to {most} bytes")
    return most


def byte(value: BV, index: int) -> BV:
    """Returns the byte at `index` in memory."""
    return value.get_byte(index)


def store(state: angr.SimState, to: BV, value: BV, length: BV) -> None:
    """Writes the first `length` bytes of `value`, which is as long as the greatest length."""
    most = value.length // 8
    if not state.solver.single_valued(length):
        before = state.memory.load(to, most)
        kept = [
            claripy.If(
                claripy.UGT(length, at),
                byte(value, at),
                byte(before, at),
            )
            for at in range(most)
        ]
        value = claripy.Concat(*kept)
    state.memory.store(to, value)


class Copy(angr.SimProcedure):
    """memcpy and memmove."""

    def run(self, to: BV, source: BV, length: BV) -> BV:
        if most := longest(self.state, length):
            store(self.state, to, self.state.memory.load(source, most), length)
        return to


class Fill(angr.SimProcedure):
    """memset."""

    def run(self, to: BV, value: BV, length: BV) -> BV:
        if most := longest(self.state, length):
            filled = claripy.Concat(*[value[7:0]] * most)
            store(self.state, to, filled, length)
        return to


class Compare(angr.SimProcedure):
    """memcmp and bcmp."""

    def run(self, left: BV, right: BV, length: BV) -> BV:
        outcome = claripy.BVV(0, 32)
        most = longest(self.state, length)
        if most == 0:
            return outcome
        one = self.state.memory.load(left, most)
        other = self.state.memory.load(right, most)
        for at in reversed(range(most)):
            a, b = byte(one, at), byte(other, at)
            differs = claripy.And(claripy.UGT(length, at), a != b)
            difference = a.zero_extend(24) - b.zero_extend(24)
            outcome = claripy.If(differs, difference, outcome)
        return outcome


class Unknown(angr.SimProcedure):
    """An import without a model."""

    def run(self) -> None:
        raise Unexplored(f"a call of {self.display_name}")


IMPORTS: dict[str, type[angr.SimProcedure]] = {
    "memcpy": Copy,
    "memmove": Copy,
    "memset": Fill,
    "memcmp": Compare,
    "bcmp": Compare,
}
