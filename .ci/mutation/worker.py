"""Runs one test after the other, each in a process of its own. Reads requests from its input, and writes the results.

A changed test can do anything: wait for ever, take all memory, leave processes, kill the processes of others. So this
program runs in a PID namespace of its own where it may, and ends all processes that a test leaves.
"""

import ctypes
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time

PR_SET_CHILD_SUBREAPER = 36
# The private memory of one process.
MEMORY_MAX_BYTES = 4 << 30
OUTPUT_MAX_BYTES = 4000


def children():
    """The children of this process."""
    found = []
    for task in os.listdir("/proc/self/task"):
        with open(f"/proc/self/task/{task}/children", encoding="ascii") as it:
            found += [int(pid) for pid in it.read().split()]
    return found


def sweep():
    """Ends what a test has left. A process whose parent ends becomes a child of this one."""
    while left := children():
        for pid in left:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
        for pid in left:
            os.waitpid(pid, 0)


def limit_memory():
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_MAX_BYTES, MEMORY_MAX_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def run(request, folder):
    """Runs a test, and says how it ended: passed, failed or hung."""
    variables = dict(os.environ, TMPDIR=folder, **request["variables"])
    start = time.monotonic()
    with tempfile.TemporaryFile() as output:
        test = subprocess.Popen(request["command"], cwd=request["folder"], env=variables, stdin=subprocess.DEVNULL,
                                stdout=output, stderr=output, start_new_session=True, preexec_fn=limit_memory)
        # Steps instead of a clock: a test does not hang while this whole program is stopped.
        for _ in range(request["limit_s"]):
            try:
                test.wait(1)
                break
            except subprocess.TimeoutExpired:
                pass
        ended = test.poll()
        seconds = time.monotonic() - start
        sweep_with(test)
        output.seek(max(0, output.seek(0, os.SEEK_END) - OUTPUT_MAX_BYTES))
        text = output.read().decode(errors="replace")
    result = "hung" if ended is None else "passed" if ended == 0 else "failed"
    return {"result": result, "seconds": seconds, "output": text}


def sweep_with(test):
    if test.poll() is None:
        test.kill()
        test.wait()
    sweep()


def main():
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    for line in sys.stdin:
        folder = tempfile.mkdtemp(prefix="sm2-")
        # Tests run programs as other users.
        os.chmod(folder, 0o1777)
        try:
            answer = run(json.loads(line), folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
