"""python3 .ci/mutation TREE OUTPUT CRATE=[BEYOND,...]...: makes changes of crates in TREE, a copy of the repository,
and runs their tests.

OUTPUT/CRATE/changes.txt has the names of the changes, and all.json the list of cargo-mutants. The names go to
found.txt, hung.txt, survived.txt and unviable.txt, or failed.txt has the tests that fail without a change, if they are
many.

All changes are in one build, and each process chooses one. Those that cannot be switched, in constants for example, are
built one by one. First, each test runs alone and without a change. A test that fails then is not used, and the
functions that it enters are noted. The tests that enter a changed function then run with the change, first those of its
crate, the shortest first, until one fails. A change is found if the test passes without it, and fails with it again.
"""

import json
import os
import queue
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from build import Program, Tree
from switches import Change

# Crates whose code runs while others are built: a change of theirs reaches the tests of these only by a new build.
AT_BUILD = ("sm2-node-derive", "sm2-ros-build")
# The tests of the form of the sources.
SKIPPED = ("tidy::", "documents::")
# Without a change, a test has more time than any needs; with one, it has this many times as long as without.
BASELINE_LIMIT_S, TIMES_AS_LONG, SHORTEST_LIMIT_S = 300, 20, 30
# At most this part of a crate's tests may fail without a change.
FAILED_MAX = 0.05
NAMESPACE = ["unshare", "--pid", "--fork", "--mount-proc", "--kill-child"]


@dataclass
class Test:
    program: Program
    name: str
    seconds: float = 0.0
    passes: bool = False
    # The places of the functions that it enters.
    reached: set = field(default_factory=set)

    def __str__(self):
        return f"{self.program.package} {self.program.name} {self.name}"


class Worker:
    """A process that runs tests."""

    def __init__(self, prefix):
        self.command = [*prefix, sys.executable, os.path.join(os.path.dirname(__file__), "worker.py")]
        self._start()

    def _start(self):
        self.process = subprocess.Popen(self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def run(self, test, change=0, reached="", limit_s=0, path=""):
        """Runs a test with the change of this number."""
        request = {
            "command": [path or test.program.path, "--exact", test.name],
            "folder": test.program.folder,
            "variables": {"SM2_MUTANT": str(change), "CARGO_MANIFEST_DIR": test.program.folder,
                          **({"SM2_REACHED": reached} if reached else {})},
            "limit_s": limit_s or max(SHORTEST_LIMIT_S, int(TIMES_AS_LONG * test.seconds)),
        }
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        if answer := self.process.stdout.readline():
            return json.loads(answer)
        # The test has killed it.
        self._start()
        return {"result": "failed", "seconds": 0.0, "output": ""}


class Workers:
    """Runs functions that need a worker, several at a time: tests wait more than they compute."""

    def __init__(self):
        allowed = subprocess.run([*NAMESPACE, "true"], stderr=subprocess.DEVNULL, check=False).returncode == 0
        self.number = 2 * len(os.sched_getaffinity(0))
        self.idle = queue.Queue()
        for _ in range(self.number):
            self.idle.put(Worker(NAMESPACE if allowed else []))

    def each(self, function, items):
        """The results of `function(worker, item)`."""
        def one(item):
            worker = self.idle.get()
            try:
                return function(worker, item)
            finally:
                self.idle.put(worker)
        with ThreadPoolExecutor(self.number) as pool:
            return list(pool.map(one, items))


def listed(program):
    """The tests of a program, but not those that are ignored."""
    def names(*options):
        out = subprocess.run([program.path, "--list", "--format", "terse", *options], cwd=program.folder,
                             stdout=subprocess.PIPE, text=True, check=True).stdout
        return [it.removesuffix(": test") for it in out.splitlines() if it.endswith(": test")]
    ignored = set(names("--ignored"))
    return [Test(program, it) for it in names() if it not in ignored and not it.startswith(SKIPPED)]


def measure(worker, test):
    """Runs a test without a change, twice if it fails."""
    with tempfile.TemporaryDirectory() as reached:
        for _ in range(2):
            answer = worker.run(test, reached=reached, limit_s=BASELINE_LIMIT_S)
            if answer["result"] == "passed":
                break
        test.seconds, test.passes = answer["seconds"], answer["result"] == "passed"
        test.reached = {int(it) for it in os.listdir(reached)}
    if not test.passes:
        print(f"fails without a change: {test}\n{answer['output']}", flush=True)


def notices(worker, test, change, path=""):
    """How a test ends that notices a change: found or hung; None if it does not notice the change. `path` is that of
    the test program if it has the change alone."""
    number = 0 if path else change.number
    first = worker.run(test, number, path=path)["result"]
    if first == "passed":
        return None
    # A busy machine can break a test, too.
    if path or worker.run(test)["result"] == "passed":
        if first == "hung":
            return "hung"
        if worker.run(test, number, path=path)["result"] != "passed":
            return "found"
    print(f"failed once: {test}, with {change.name}", flush=True)
    return None


class Trial:
    """The changes of some crates, and all tests that can notice them."""

    def __init__(self, tree, output, beyond):
        self.tree, self.output, self.beyond = tree, output, beyond
        self.workers = Workers()
        self.changes = []
        for crate in beyond:
            with open(os.path.join(output, crate, "all.json"), encoding="utf-8") as it:
                known = {made["name"]: made for made in json.load(it)}
            with open(self._path(crate, "changes"), encoding="utf-8") as it:
                for name in it.read().splitlines():
                    self.changes.append(Change(len(self.changes) + 1, crate, known[name]))
        self.tests = []

    def _path(self, crate, word):
        return os.path.join(self.output, crate, word + ".txt")

    def packages(self, crate):
        return [crate, *self.beyond[crate]]

    def of(self, crate):
        return [it for it in self.changes if it.crate == crate]

    def run(self):
        start = time.monotonic()
        packages = sorted({it for crate in self.beyond for it in self.packages(crate)})
        programs = self.tree.build_all(self.changes, packages)
        print(f"one build: {time.monotonic() - start:.0f} s", flush=True)
        start = time.monotonic()
        self.tests = [it for program in programs for it in listed(program)]
        self.workers.each(measure, self.tests)
        print(f"{len(self.tests)} tests without a change: {time.monotonic() - start:.0f} s", flush=True)
        for crate in list(self.beyond):
            self._leave_out_if_failed(crate)
        self.tests = [it for it in self.tests if it.passes]
        self.workers.each(self._try, [it for it in self.changes if it.is_switched])
        for change in self.changes:
            if not change.is_switched or (change.outcome == "survived" and change.crate in AT_BUILD):
                self._try_alone(change)
        for crate in self.beyond:
            for word in ("found", "hung", "survived", "unviable"):
                self._write(crate, word, [it.name for it in self.of(crate) if it.outcome == word])

    def _write(self, crate, word, lines):
        with open(self._path(crate, word), "w", encoding="utf-8") as it:
            it.writelines(line + "\n" for line in lines)

    def _leave_out_if_failed(self, crate):
        """A crate whose tests fail without a change says nothing."""
        own = [it for it in self.tests if it.program.package == crate]
        failed = [str(it) for it in own if not it.passes]
        if len(failed) > FAILED_MAX * len(own):
            self._write(crate, "failed", failed)
            self.changes = [it for it in self.changes if it.crate != crate]

    def _in_order(self, crate, of_package):
        """The tests of a crate, then those beyond it, the shortest of each first."""
        order = {package: at for at, package in enumerate(self.packages(crate))}
        those = [it for it in self.tests if it.program.package in of_package]
        return sorted(those, key=lambda it: (order[it.program.package], it.seconds))

    def _try(self, worker, change):
        start = time.monotonic()
        for test in self._in_order(change.crate, self.packages(change.crate)):
            if change.place in test.reached and (outcome := notices(worker, test, change)):
                self._end(change, outcome, start, test)
                return
        self._end(change, "survived", start)

    def _try_alone(self, change):
        """Builds a change, and runs the tests of its crate, then those beyond it."""
        start = time.monotonic()
        for package in self.packages(change.crate):
            for programs in self.tree.build_alone(change, package):
                if programs is None:
                    # Code that it generates does not compile, or it does not itself.
                    return self._end(change, "unviable" if package == change.crate else "found", start)
                if noticed := self._noticed_alone(change, package, programs):
                    return self._end(change, noticed[0], start, noticed[1])
        self._end(change, "survived", start)

    def _noticed_alone(self, change, package, programs):
        """How which test of these programs notices the change that is built into them; None if none does."""
        paths = {(it.package, it.name, it.kind): it.path for it in programs}
        noticed = []

        def one(worker, test):
            path = paths.get((test.program.package, test.program.name, test.program.kind))
            if path and not noticed and (outcome := notices(worker, test, change, path)):
                noticed.append((outcome, test))

        self.workers.each(one, self._in_order(change.crate, [package]))
        return noticed[0] if noticed else None

    def _end(self, change, outcome, start, test=""):
        change.outcome = outcome
        how = "" if change.is_switched else " (a build of its own)"
        print(f"{outcome:9} {time.monotonic() - start:4.0f} s{how} {change.name} [{test}]", flush=True)


def main():
    tree, output, *crates = sys.argv[1:]
    beyond = {}
    for it in crates:
        crate, _, others = it.partition("=")
        beyond[crate] = list(filter(None, others.split(",")))
    sysroot = subprocess.run(["rustc", "--print", "target-libdir"], stdout=subprocess.PIPE, text=True, check=True)
    # Tests of procedural macros need the compiler's libraries.
    os.environ["LD_LIBRARY_PATH"] = sysroot.stdout.strip()
    Trial(Tree(tree), output, beyond).run()


if __name__ == "__main__":
    main()
