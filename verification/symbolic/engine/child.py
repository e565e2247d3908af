"""Explores each harness in a separate process, which ends when its time is up."""

import multiprocessing
import resource
from multiprocessing.connection import Connection

from .machine import Exploration, Library
from .replay import disagreements

# Memory limit of a harness, since the machine has other work to do.
MEMORY_BYTES = 6 << 30


def explore(
    library: Library,
    harness: str,
    cpu_seconds: int,
    first_panic: bool = False,
) -> Exploration:
    """Returns the result of the exploration. If the time was too short, some paths are unexplored."""
    fork = multiprocessing.get_context("fork")
    receiver, sender = fork.Pipe(duplex=False)
    child = fork.Process(target=work, args=(library, harness, cpu_seconds, first_panic, sender))
    child.start()
    sender.close()
    try:
        seen = receiver.recv()
    except EOFError:
        # Killed within one query to the solver, so there is no result for this harness.
        seen = Exploration(left=1, errors=["no time or no memory was left"])
        seen.seconds = float(cpu_seconds)
    child.join()
    return seen


def work(
    library: Library,
    harness: str,
    cpu_seconds: int,
    first_panic: bool,
    sender: Connection,
) -> None:
    """Runs in the child from start to end."""
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds + 5, cpu_seconds + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    seen = library.explore(harness, cpu_seconds, first_panic)
    seen.disagreements = disagreements(library.entry(harness), seen.models + seen.panics)
    sender.send(seen)
