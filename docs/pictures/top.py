"""Draws the screen of `sm2 top` for some seconds as a moving SVG: top.py SM2 FLEET FILE (see `tools`)."""

import os
import pty
import select
import signal
import subprocess
import sys
import tempfile
import time
from html import escape
from itertools import groupby

import pyte

SM2, FLEET, FILE = sys.argv[1:]
COLUMNS, ROWS = 120, 14
# How long `sm2 top` runs before its screen is drawn: the sparklines fill meanwhile.
SECONDS = 15
# How many screens are drawn, one second apart.
FRAMES = 12
# The limit of whatever has to succeed, in seconds.
SOON = 60

# Sizes in pixels.
CELL, LINE, SIZE, MARGIN = 8.4, 18, 14, 14
# By the names that pyte gives to the colours of `sm2 top`.
COLOURS = {"default": "#d7dae0", "cd0000": "#ff7b72", "00cdcd": "#76e3ea"}
BACKGROUND = "#16181d"


def frames():
    """The screens of `sm2 top` in a domain with the example `fleet`."""
    with tempfile.TemporaryDirectory() as folder:
        socket = os.path.join(folder, "sm2.sock")
        processes = [start(SM2, "manager", "--socket", socket)]
        try:
            limit = time.monotonic() + SOON
            while not os.path.exists(socket):
                assert time.monotonic() < limit, "the Manager does not listen"
                time.sleep(0.01)
            processes.append(start(FLEET, socket, "1"))
            return watch(socket)
        finally:
            for process in reversed(processes):
                process.kill()
                process.wait()


def start(*command):
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def watch(socket):
    shown = pyte.Screen(COLUMNS, ROWS)
    stream = pyte.ByteStream(shown)
    time_of_first = time.monotonic() + SECONDS
    child, terminal = pty.fork()
    if child == 0:
        os.environ["TERM"] = "xterm-256color"
        size = f"stty rows {ROWS} cols {COLUMNS}"
        os.execlp("sh", "sh", "-c", f'{size} && exec "$0" "$@"', SM2, "top", "--socket", socket)
    seen = []
    for number in range(FRAMES):
        end = time_of_first + number
        while (left := end - time.monotonic()) > 0:
            if select.select([terminal], [], [], left)[0]:
                stream.feed(os.read(terminal, 65536))
        seen.append([list(runs_of(shown, row)) for row in range(ROWS)])
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return seen


def runs_of(shown, row):
    """The characters of a row that have one style: their column, text, colour, and whether they are bold and reversed."""
    style = lambda column: (lambda it: (it.fg, it.bold, it.reverse))(shown.buffer[row][column])
    for (colour, bold, reverse), columns in groupby(range(COLUMNS), style):
        columns = list(columns)
        text = "".join(shown.buffer[row][column].data for column in columns)
        yield columns[0], text, COLOURS[colour], bold, reverse


def svg(seen):
    width, height = COLUMNS * CELL + 2 * MARGIN, ROWS * LINE + 2 * MARGIN
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" font-size="{SIZE}" '
        f'font-family="ui-monospace, Menlo, Consolas, monospace" role="img" aria-label="The screen of sm2 top">'
    )
    # A frame is visible for its second. Whoever prefers a page that does not move sees the first one.
    yield (
        f"<style>@keyframes second{{0%{{visibility:visible}}{100 / FRAMES:.3f}%,100%{{visibility:hidden}}}}"
        f".frame{{visibility:hidden;animation:second {FRAMES}s step-end infinite}}"
        f"@media(prefers-reduced-motion:reduce){{.frame{{animation:none}}.first{{visibility:visible}}}}</style>"
    )
    yield f'<rect width="{width:g}" height="{height:g}" rx="8" fill="{BACKGROUND}"/>'
    moves = [any(frame[row] != seen[0][row] for frame in seen) for row in range(ROWS)]
    yield from rows(seen[0], (row for row in range(ROWS) if not moves[row]))
    for number, frame in enumerate(seen):
        first = "" if number else " first"
        yield f'<g class="frame{first}" style="animation-delay:{number - FRAMES}s">'
        yield from rows(frame, (row for row in range(ROWS) if moves[row]))
        yield "</g>"
    yield "</svg>"


def rows(frame, numbers):
    for row in numbers:
        for of_run in frame[row]:
            yield from run(row, *of_run)


def run(row, column, text, colour, bold, reverse):
    """Characters of one style. They keep their places whatever font the viewer has."""
    x, y = MARGIN + column * CELL, MARGIN + row * LINE
    if reverse:
        yield f'<rect x="{x:g}" y="{y:g}" width="{len(text) * CELL:g}" height="{LINE}" fill="{colour}"/>'
        colour = BACKGROUND
    text = text.rstrip()
    if text:
        weight = ' font-weight="bold"' if bold else ""
        yield (
            f'<text x="{x:g}" y="{y + SIZE:g}" fill="{colour}"{weight} xml:space="preserve" '
            f'textLength="{len(text) * CELL:g}" lengthAdjust="spacingAndGlyphs">{escape(text)}</text>'
        )


with open(FILE, "w", encoding="utf-8") as file:
    file.write("\n".join(svg(frames())) + "\n")
