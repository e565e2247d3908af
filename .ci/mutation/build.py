"""Builds the tests with the changes in them."""

import json
import os
import re
import subprocess
from dataclasses import dataclass

from switches import NO_STD, STD_OF_NO_STD, changed, switch

# More attempts than any crate needs: each takes one kind of error out of each crate.
ATTEMPTS_MAX = 60


@dataclass(frozen=True)
class Program:
    """A test program."""

    package: str
    folder: str
    name: str
    kind: str
    path: str


class Tree:
    """A copy of the repository, and what is built of it."""

    def __init__(self, root):
        self.root = root
        self.texts = {}
        found = self._packages()
        # Their names, by their manifests.
        self.packages = {it["manifest_path"]: it["name"] for it in found}
        # The names of those that have a library with unit tests.
        self.libraries = {it["name"] for it in found
                          if any(target["test"] and target["kind"] in (["lib"], ["proc-macro"])
                                 for target in it["targets"])}

    def _packages(self):
        command = ["cargo", "metadata", "--no-deps", "--format-version", "1"]
        found = subprocess.run(command, cwd=self.root, stdout=subprocess.PIPE, check=True)
        return json.loads(found.stdout)["packages"]

    def text(self, file):
        """The text of a file without changes."""
        if file not in self.texts:
            with open(os.path.join(self.root, file), encoding="utf-8") as it:
                self.texts[file] = it.read()
        return self.texts[file]

    def write(self, file, text):
        """Writes a file, unless it has this text: Cargo looks at times."""
        path = os.path.join(self.root, file)
        self.text(file)
        with open(path, encoding="utf-8") as it:
            if it.read() == text:
                return
        with open(path, "w", encoding="utf-8") as it:
            it.write(text)

    def root_file(self, crate):
        """The root of a library without the standard library; None for others."""
        folder = next(os.path.dirname(path) for path, name in self.packages.items() if name == crate)
        file = os.path.relpath(os.path.join(folder, "src/lib.rs"), self.root)
        exists = os.path.exists(os.path.join(self.root, file))
        return file if exists and NO_STD.search(self.text(file)) else None

    def cargo(self, packages, *targets):
        """Builds tests: whether that worked, the test programs, and the compiler's errors."""
        command = ["cargo", "test", "--no-run", "--message-format", "json", *targets]
        command += [it for package in packages for it in ("--package", package)]
        done = subprocess.run(command, cwd=self.root, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        messages = [json.loads(it) for it in done.stdout.splitlines() if it.startswith("{")]
        errors = [it["message"] for it in messages
                  if it["reason"] == "compiler-message" and it["message"]["level"] == "error"]
        programs = [self._program(it) for it in messages
                    if it["reason"] == "compiler-artifact" and it["profile"]["test"] and it.get("executable")]
        if done.returncode and not errors:
            raise RuntimeError(done.stderr)
        return done.returncode == 0, programs, errors

    def _program(self, artifact):
        manifest = artifact["manifest_path"]
        return Program(self.packages[manifest], os.path.dirname(manifest), artifact["target"]["name"],
                       artifact["target"]["kind"][0], artifact["executable"])

    def build_all(self, changes, packages):
        """Builds the tests of the packages with all changes that can be switched, and returns the test programs. The
        others are not switched any more."""
        for _ in range(ATTEMPTS_MAX):
            regions, no_longer_const = self._switch([it for it in changes if it.is_switched])
            done, programs, errors = self.cargo(packages)
            if done:
                return programs
            wrong = {id(it): it for error in errors for it in blamed(error, regions, no_longer_const)}
            if not wrong:
                raise RuntimeError("\n".join(it["rendered"] for it in errors))
            print(f"{len(wrong)} changes do not compile, or not beside others", flush=True)
            for it in wrong.values():
                it.is_switched = False
        raise RuntimeError("there is always one more change that does not compile")

    def _switch(self, changes):
        """Writes all files, with these changes."""
        regions, no_longer_const, files = {}, [], {file: text for file, text in self.texts.items()}
        roots = {crate: self.root_file(crate) for crate in {it.crate for it in changes}}
        for file in {it.file for it in changes}:
            those = [it for it in changes if it.file == file]
            result = switch(self.text(file), those, "std_of_changes" if roots[those[0].crate] else "std")
            files[file], regions[file] = result.text, result.regions
            no_longer_const += result.no_longer_const
        for root in filter(None, roots.values()):
            files[root] = files.get(root, self.text(root)) + STD_OF_NO_STD
        for file, text in files.items():
            self.write(file, text)
        return regions, no_longer_const

    def build_alone(self, change, package):
        """Builds the tests of a package with one change. Yields the programs, first those of its library's unit tests,
        which notice most changes and need neither other programs nor examples; None if it does not compile."""
        for file, text in self.texts.items():
            self.write(file, text)
        self.write(change.file, changed(self.text(change.file), change))
        known = set()
        for targets in ((["--lib"],) if package in self.libraries else ()) + ([],):
            done, programs, _ = self.cargo([package], *targets)
            yield [it for it in programs if it not in known] if done else None
            known.update(programs)


def blamed(error, regions, no_longer_const):
    """The changes that a compiler's error comes from. The first span within a single one has it."""
    hits = []
    for span in sorted(spans(error), key=lambda it: not it["is_primary"]):
        while span and span["file_name"] not in regions:
            span = (span.get("expansion") or {}).get("span")
        if span:
            hits += [it.changes for it in regions[span["file_name"]] if it.first <= span["line_start"] <= it.last]
    if hits:
        return min(hits, key=len)
    # A function that is not const any more is called where only a const one can be.
    called = re.search(r"non-const .*`([^`]*)`", error["message"])
    if not called:
        return []
    name = re.sub(r"<.*?>", "", called[1]).split("::")[-1]
    return [it for it in no_longer_const if it.function.split("::")[-1] == name]


def spans(error):
    found = list(error["spans"])
    for child in error["children"]:
        found += child["spans"]
    return found
