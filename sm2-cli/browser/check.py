"""Checks the page of `sm2 view` in a browser: check.py CHROMIUM SM2 FLEET FOLDER (see `run`)."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import expect, sync_playwright

CHROMIUM, SM2, FLEET, FOLDER = sys.argv[1:]
# The limit of whatever has to succeed, in milliseconds.
SOON = 60_000
HOSTILE = "</script><img src=x onerror=alert(1)>\"'`${1}&lt;"
ROBOTS = 60

expect.set_options(timeout=SOON)


class Domain:
    """A Manager, the example `fleet`, and `sm2 view`, in a folder of their own."""

    def __init__(self, robots):
        self.folder = tempfile.TemporaryDirectory()
        self.socket = os.path.join(self.folder.name, "sm2.sock")
        self.processes = []
        self.start(SM2, "manager", "--socket", self.socket)
        while not os.path.exists(self.socket):
            time.sleep(0.01)
        self.robots = robots
        self.fleet = self.start(FLEET, self.socket, str(robots))
        view = self.start(SM2, "view", "--socket", self.socket, stdout=subprocess.PIPE, text=True)
        self.url = view.stdout.readline().strip()

    def start(self, *command, **options):
        options.setdefault("stdout", subprocess.DEVNULL)
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, **options)
        self.processes.append(process)
        return process

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in reversed(self.processes):
            process.kill()
            process.wait()
        self.folder.cleanup()


class Page:
    """A page that must log no error, and request nothing from elsewhere."""

    def __init__(self, browser, url, scheme="light"):
        self.problems = []
        self.page = browser.new_page(viewport={"width": 1500, "height": 850}, color_scheme=scheme)
        self.page.set_default_timeout(SOON)
        self.page.on("console", lambda line: line.type == "error" and self.problems.append(line.text))
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on("dialog", lambda dialog: self.problems.append("a dialog: " + dialog.message))
        origin = url.rsplit("/", 2)[0] if url.endswith("/") else url
        self.page.on("request", lambda it: it.url.startswith((origin, "data:")) or self.problems.append(it.url))
        self.url = url

    def __enter__(self):
        return self

    def __exit__(self, kind, *_):
        self.page.close()
        if kind is None:
            assert self.problems == [], self.problems

    def open(self):
        start = time.monotonic()
        self.page.goto(self.url)
        self.page.wait_for_selector(".vertex")
        return time.monotonic() - start

    def shot(self, name):
        self.page.screenshot(path=Path(FOLDER, name + ".png"))

    def vertex(self, vertex):
        return self.page.locator(f'[data-id="{vertex}"]')

    def status(self, text):
        expect(self.page.locator("#status")).to_contain_text(text)

    def heading(self, text):
        expect(self.page.locator("h2")).to_contain_text(text)


def small_domain(browser):
    with Domain(1) as domain, Page(browser, domain.url) as it:
        page = it.page
        print(f"the page shows 6 nodes after {it.open():.2f} s")
        it.status("6 nodes")
        expect(it.vertex("t:image")).to_contain_text("MB/s")
        # Two samples, so that rates have settled.
        page.wait_for_timeout(2500)
        it.shot("small-light")
        it.vertex("t:scans").click()
        page.get_by_role("button", name="Why is it not linked?").click()
        page.wait_for_selector(".answer >> text=their names differ")
        it.vertex("t:image").click()
        page.get_by_role("button", name="Show the fields of a message").click()
        page.wait_for_selector(".answer >> text=type bytes")
        it.vertex("t:scans").click()
        it.shot("why-light")
        keyboard(it)
        tables(it)
        names(page)
        with Page(browser, domain.url, "dark") as dark:
            dark.open()
            dark.page.wait_for_timeout(2500)
            dark.shot("small-dark")
            dark.vertex("t:image").click()
            dark.page.wait_for_timeout(1500)
            dark.shot("topic-dark")
        domain.fleet.kill()
        it.status("0 nodes")
        page.keyboard.press("Escape")
        page.wait_for_selector(".events .left >> text=camera")
        domain.start(FLEET, domain.socket, "1")
        it.status("6 nodes")
        page.wait_for_selector(".events .joined >> text=camera")


def keyboard(it):
    """Each vertex can be reached and selected without a mouse."""
    page = it.page
    page.keyboard.press("Escape")
    page.keyboard.press("/")
    page.keyboard.type("camera")
    expect(page.locator(".vertex")).to_have_count(2)
    page.fill("#filter", "")
    it.vertex("n:camera").focus()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    it.heading("image")
    page.keyboard.press("Escape")
    it.heading("Domain")


def tables(it):
    """The tables have what the graph has."""
    page = it.page
    page.get_by_role("button", name="Topics", exact=True).click()
    assert page.get_by_role("row").count() == 1 + 8, "8 topics and services"
    page.get_by_role("button", name="Bandwidth").click()
    assert page.get_by_role("rowheader").first.text_content() == "image"
    it.shot("topics-light")
    page.get_by_role("button", name="Nodes", exact=True).click()
    page.get_by_role("rowheader", name="planner").get_by_role("button").click()
    it.heading("planner")
    page.get_by_role("button", name="Graph", exact=True).click()


def names(page):
    """A screen reader has a name for each control."""
    nameless = page.evaluate(
        """[...document.querySelectorAll('button, [role=button], input, [role=img]')]
        .filter((it) => !(it.getAttribute('aria-label') || it.textContent.trim() || it.labels?.length))
        .map((it) => it.outerHTML)"""
    )
    assert nameless == [], nameless


def hostile_texts(browser):
    """A server whose texts are markup."""
    with Domain(1) as domain, Page(browser, domain.url) as it:
        it.page.route("**/api/events", lambda route: route.fulfill(content_type="text/event-stream", body=hostile()))
        it.page.goto(domain.url)
        it.page.wait_for_selector(".vertex")
        shown = it.page.locator("body").text_content()
        assert HOSTILE in shown, shown
        it.vertex("t:x").click()
        it.heading("x")
        for tab in ["Topics", "Nodes"]:
            it.page.get_by_role("button", name=tab, exact=True).click()
        assert it.page.locator("img, iframe, body script").count() == 0


def hostile():
    kind = {"name": HOSTILE, "schema": HOSTILE}
    qos = {"depth": 1, "sealed": False}
    face = {"node": HOSTILE, "node_id": 1, "interface": 1, "kind": "publisher", "name": "x", "type": kind, "qos": qos}
    link = {"link": HOSTILE, "offering": HOSTILE + ":x", "demanding": "b:x", "counters": None, "taken": None}
    sample = {
        "sample": 1,
        "connected": True,
        "domain": {
            "epoch": HOSTILE,
            "revision": 1,
            "nodes": [{"id": 1, "name": HOSTILE, "pid": 1, "uid": 0, "resuming": False}],
            "interfaces": [
                {**face, "links": 0, "refused": HOSTILE},
                {**face, "interface": 2, "name": HOSTILE, "links": 1},
            ],
            "links": [link],
            "open": [{"item": "unlinked", "offering": HOSTILE, "demanding": HOSTILE, "reason": HOSTILE}],
            "quotas": [{"of": HOSTILE, "quota": HOSTILE, "used": 1, "limit": 2}],
            "without_counters": [HOSTILE],
        },
        "figures": [],
        "events": [{"number": 1, "at_ms": 0, "kind": "refusal", "node": HOSTILE, "name": "x", "text": HOSTILE}],
        "checks": [{"level": "bad", "check": HOSTILE, "found": HOSTILE, "advice": HOSTILE}],
    }
    return f"retry: 100000\ndata: {json.dumps(sample)}\n\n"


def large_domain(browser):
    with Domain(ROBOTS) as domain, Page(browser, domain.url) as it:
        print(f"the page shows {5 * ROBOTS + 1} nodes after {it.open():.2f} s")
        it.status(f"{5 * ROBOTS + 1} nodes")
        it.page.wait_for_timeout(2500)
        it.shot("large-light")
        print("collapsed:", frames(it.page))
        it.vertex("g:robot07").click()
        it.page.wait_for_selector('[data-id="n:robot07/planner"]')
        it.shot("large-expanded-light")
        it.page.fill("#filter", "battery")
        it.page.wait_for_selector('[data-id="t:robot07/battery"]')
        it.page.fill("#filter", "")
        it.page.get_by_role("button", name="Collapse or expand all groups of names").click()
        it.page.wait_for_timeout(1500)
        it.page.get_by_role("button", name="Collapse or expand all groups of names").click()
        # Of each robot 5 nodes, 7 topics and a service.
        expect(it.page.locator(".vertex")).to_have_count(13 * ROBOTS + 1)
        it.shot("large-all-light")
        print("expanded:", frames(it.page))


def frames(page):
    """The time between frames, while samples come."""
    times = page.evaluate(
        """new Promise((done) => {
            const times = [];
            const next = (time) => {
                times.push(time);
                times[0] + 4000 < time ? done(times) : requestAnimationFrame(next);
            };
            requestAnimationFrame(next);
        })"""
    )
    between = sorted(later - earlier for earlier, later in zip(times, times[1:]))
    return f"frame time: median {between[len(between) // 2]:.1f} ms, longest {between[-1]:.1f} ms"


with sync_playwright() as playwright:
    chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
    for check in [small_domain, hostile_texts, large_domain]:
        print(check.__name__)
        check(chromium)
    chromium.close()
print("screenshots:", FOLDER)
