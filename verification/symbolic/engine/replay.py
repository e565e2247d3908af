"""Runs each explored path again on the processor, with one of its models.

angr's model of an instruction may be wrong. This module loads and calls the same library.
The outcome must be the predicted one, including each cover.
"""

import ctypes
import multiprocessing
import os
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

fork = multiprocessing.get_context("fork")

HARNESS = ctypes.CFUNCTYPE(None)
ANY = ctypes.CFUNCTYPE(ctypes.c_uint64, ctypes.c_uint32)
ASSUME = ctypes.CFUNCTYPE(None, ctypes.c_bool)
COVER = ctypes.CFUNCTYPE(None, ctypes.c_bool, ctypes.c_void_p, ctypes.c_size_t)
PANIC = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_uint32)


class Answers(ctypes.Structure):
    """`Answers` of `kani/src/hooks.rs`."""

    _fields_ = [("any", ANY), ("assume", ASSUME), ("cover", COVER), ("panic", PANIC)]


@dataclass
class Model:
    """A path, given by the values that its harness gets, and what happens on it."""

    values: list[int]
    # For each cover that is passed: whether it holds.
    covers: list[bool]
    # The place of its panic; empty if it returns.
    place: str = ""


@dataclass
class Entry:
    """The location of a harness in the file of a library."""

    library: Path
    replay: int
    harness: int


def disagreements(entry: Entry, models: list[Model]) -> list[str]:
    """Returns how the processor behaves differently."""
    found = []
    while models:
        done = 0
        for ran in outcomes(entry, models):
            if ran != models[done]:
                found.append(f"{models[done]} on the processor: {ran}")
            done += 1
        if done == 0:
            found.append(f"{models[0]} on the processor: no outcome")
        models = models[max(done, 1) :]
    return found


def outcomes(entry: Entry, models: list[Model]) -> Iterator[Model]:
    """Returns the results of these paths, up to the first that panics."""
    receiver, sender = fork.Pipe(duplex=False)
    child = fork.Process(target=run, args=(entry, models, sender))
    child.start()
    sender.close()
    try:
        while True:
            yield receiver.recv()
    except EOFError:
        child.join()


def run(entry: Entry, models: list[Model], sender: Connection) -> None:
    """Runs in the child, which ends with a panic."""
    replay = ctypes.CDLL(str(entry.library)).sm2_symbolic_replay
    base = ctypes.cast(replay, ctypes.c_void_p).value - entry.replay
    harness = HARNESS(base + entry.harness)
    ran, left = Model([], []), iter(())

    def any_value(_bits: int) -> int:
        ran.values.append(next(left))
        return ran.values[-1]

    def assume(holds: bool) -> None:
        if not holds:
            end("rejected")

    def cover(holds: bool, _text: int, _len: int) -> None:
        ran.covers.append(holds)

    def panicked(file: int, length: int, line: int) -> None:
        end(f"{ctypes.string_at(file, length).decode()}:{line}")

    def end(place: str) -> None:
        ran.place = place
        sender.send(ran)
        os._exit(0)

    answers = Answers(ANY(any_value), ASSUME(assume), COVER(cover), PANIC(panicked))
    for model in models:
        ran, left = Model([], []), iter(model.values)
        replay(harness, ctypes.byref(answers))
        sender.send(ran)
