"""Puts many changes of a file into its text at once. A process makes the one whose number is in SM2_MUTANT.

A function with changes gets an arm for each, with a copy of its body:

    match CHOSEN { 7 => { body with change 7 } 9 => { body with change 9 } _ => { body } }

SM2_REACHED names a folder, in which each process leaves a file for each function with changes that it enters.
"""

import re
from dataclasses import dataclass, field

NO_STD = re.compile(r"^#!\[no_std\]", re.MULTILINE)
# Appended to the root of a crate without the standard library.
STD_OF_NO_STD = "\n#[allow(unused_extern_crates)]\nextern crate std as std_of_changes;\n"
CONST = re.compile(r"\bconst\s+(?=(?:async\s+|unsafe\s+|extern\s+(?:\"[^\"]*\"\s+)?)*fn\b)")
CHOSEN = """{{ static CHOSEN: ::{std}::sync::OnceLock<u32> = ::{std}::sync::OnceLock::new(); *CHOSEN.get_or_init(|| {{
if let Ok(folder) = ::{std}::env::var("SM2_REACHED") {{
    let _ = ::{std}::fs::write(::{std}::format!("{{folder}}/{place}"), "");
}}
::{std}::env::var("SM2_MUTANT").ok().and_then(|it| it.parse().ok()).unwrap_or(0) }}) }}"""


@dataclass
class Change:
    """One change, as `cargo mutants --list --json` describes it."""

    number: int
    crate: str
    made: dict
    # False: it needs a build of its own.
    is_switched: bool = True
    # The number of the first change of its function, which stands for the function in the folder SM2_REACHED.
    place: int = 0
    # How it ended: found, hung, survived or unviable.
    outcome: str = ""

    @property
    def name(self):
        return self.made["name"]

    @property
    def file(self):
        return self.made["file"]

    @property
    def function(self):
        return (self.made.get("function") or {}).get("function_name", "")


@dataclass
class Region:
    """Lines of the new text, and the changes that they come from."""

    first: int
    last: int
    changes: list


@dataclass
class Switched:
    text: str
    regions: list = field(default_factory=list)
    # The changes whose functions are not const any more.
    no_longer_const: list = field(default_factory=list)


class Positions:
    """Offsets of lines and columns."""

    def __init__(self, text):
        self.lines = [0]
        for line in text.split("\n"):
            self.lines.append(self.lines[-1] + len(line) + 1)

    def span(self, span):
        return tuple(self.lines[it["line"] - 1] + it["column"] - 1 for it in (span["start"], span["end"]))


def body_start(text, start, end):
    """The offset of the brace that opens the body of the function there; None if there is none."""
    at, depth = start + re.search(r"\bfn\b", text[start:end]).end(), 0
    while at < end:
        if text.startswith("//", at):
            at = text.index("\n", at)
        elif text.startswith("->", at):
            at += 1
        elif text[at] in "([":
            depth += 1
        elif text[at] in ")]":
            depth -= 1
        elif text[at] == "{" and depth == 0:
            return at
        at += 1
    return None


def changed(text, change):
    """The text with this change alone."""
    start, end = Positions(text).span(change.made["span"])
    return text[:start] + change.made["replacement"] + " " + text[end:]


def functions(text, changes):
    """The outermost functions with changes: their start, the start of their body, their end, and the changes, each
    with the offsets of what it replaces. Changes outside of a body are not switched."""
    positions, found = Positions(text), []
    for change in changes:
        span = change.made.get("function") and positions.span(change.made["function"]["span"])
        body = span and body_start(text, *span)
        start, end = positions.span(change.made["span"])
        if not body or start <= body:
            change.is_switched = False
            continue
        found.append((span[0], body, span[1], [(change, start, end)]))
    merged = []
    for it in sorted(found, key=lambda it: (it[0], -it[2])):
        if merged and it[0] < merged[-1][2]:
            merged[-1][3].extend(it[3])
        else:
            merged.append(it)
    return merged


def switch(text, changes, std):
    """The text with all these changes. `std` is the name of the standard library in it."""
    result, parts, at, line = Switched(text), [], 0, 1

    def put(part):
        nonlocal line
        first = line
        parts.append(part)
        line += part.count("\n")
        return first

    for start, body, end, those in functions(text, changes):
        head, end = text[start:body], end - 1
        place = min(change.number for change, _, _ in those)
        if CONST.search(head):
            head = CONST.sub("", head, count=1)
            result.no_longer_const += [change for change, _, _ in those]
        first = put(text[at:start] + head + "{\nmatch " + CHOSEN.format(std=std, place=place) + " {\n")
        first = line
        for change, since, until in those:
            change.place = place
            new = text[body + 1:since] + change.made["replacement"] + " " + text[until:end]
            arm = put(f"{change.number} => {{\n{new}\n}}\n")
            result.regions.append(Region(arm, line - 1, [change]))
        put("_ => {" + text[body + 1:end] + "\n}\n}\n")
        result.regions.append(Region(first, line, [change for change, _, _ in those]))
        at = end
    put(text[at:])
    result.text = "".join(parts)
    return result
