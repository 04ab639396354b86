"""The pages in a real browser: from a form to a report, with all that comes between."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import CHROMIUM, Browser

pytest.importorskip("nicegui")

from coupler.app.pages import LINKS

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")]


class Server:
    """`coldspray app` in a process of its own. base, address: without and with the token."""

    def __init__(self, root: Path):
        command = [sys.executable, "-m", "coupler", "app", str(root), "--port", "0", "--no-browser"]
        environment = {
            key: value for key, value in os.environ.items() if key != "PYTEST_CURRENT_TEST"
        }  # nicegui reads it
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        assert self.process.stdout
        self.address = self.process.stdout.readline().split()[-1]
        self.base = self.address.partition("/?")[0]

    def stop(self, number: int = signal.SIGINT) -> None:
        self.process.send_signal(number)
        self.process.wait(30)


@pytest.fixture
def root(tmp_path: Path) -> Iterator[Path]:
    """A workspace, whose processes end with the test."""
    yield tmp_path / "work"
    for pid in tmp_path.glob("work/runs/*/app.pid"):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(int(pid.read_text()), signal.SIGKILL)


@pytest.fixture
def server(root: Path) -> Iterator[Server]:
    started = Server(root)
    yield started
    started.stop()


@pytest.fixture
def browser(tmp_path: Path, server: Server) -> Iterator[Browser]:
    with Browser(tmp_path / "profile") as browser:
        enter(browser, server)
        yield browser


def enter(browser: Browser, server: Server) -> None:
    """Open the address with the token: the server prints it a moment before it listens."""
    for _ in range(100):
        browser.open(server.address)
        if browser.ask(says("Gas and window")):
            break


def says(words: str) -> str:
    return f"document.body?.innerText.includes({words!r})"


def field(label: str) -> str:
    return f"input[aria-label='{label}']"


def begin(browser: Browser, server: Server) -> None:
    """A short impact from the form."""
    browser.open(f"{server.base}/impact")
    browser.until(says("wall time"))
    browser.type(field("particle diameter"), "20 um")
    browser.click("run")
    browser.until("location.pathname === '/run/single-1'")


def test_each_page_is_whole_on_a_telephone_and_in_the_dark(browser: Browser, server: Server) -> None:
    for width, dark in ((1280, False), (390, True)):
        browser.screen(width, dark)
        for path, title in LINKS.items():
            browser.open(server.base + path)
            browser.until(says(title))
            if path not in ("/runs", "/metals"):
                browser.until(f"{says('wall time')} || {says('Velocity at impact')}")
            assert browser.ask("document.documentElement.scrollWidth") <= width, path
            assert browser.ask("document.body.classList.contains('body--dark')") == dark
    assert all(url.startswith((server.base, server.base.replace("http", "ws"))) for url in browser.requests)
    assert browser.complaints == []


def test_a_wrong_unit_is_told_at_its_field_of_this_tab_alone(browser: Browser, server: Server, tmp_path: Path) -> None:
    browser.open(f"{server.base}/impact")
    browser.until(says("wall time"))
    browser.type(field("particle velocity"), "500 mm")
    browser.until(says('is a length: needs a velocity with its unit, such as "500 m/s"'))
    assert browser.ask("[...document.querySelectorAll('button')].find(b => b.innerText.endsWith('RUN')).disabled")
    with Browser(tmp_path / "other") as other:
        enter(other, server)
        other.open(f"{server.base}/impact")
        other.until(says("wall time"))
        assert other.ask(f"document.querySelector({field('particle velocity')!r}).value") == "500 m/s"
    browser.type(field("particle velocity"), "400 m/s")
    browser.until(says("400 m/s at 0 deg"))


def test_a_run_from_the_form_to_its_report(browser: Browser, server: Server, root: Path) -> None:
    begin(browser, server)
    browser.until("document.querySelector('iframe')?.src.includes('report.html')")
    assert browser.ask(says("finished"))
    assert browser.ask(says("rebounds"))
    browser.until("[...document.images].some(image => image.naturalWidth > 500)")  # the cut
    assert browser.ask("document.querySelectorAll('.main-svg').length") > 0  # energies
    assert (root / "runs" / "single-1" / "report.html").is_file()
    browser.click("copy scene")
    browser.until("location.pathname === '/impact'")
    browser.until(says("20 um"))
    assert browser.ask(f"document.querySelector({field('particle diameter')!r}).value") == "20 um"
    assert browser.ask(f"document.querySelector({field('name')!r}).value") == "single-2"


def test_a_run_is_stopped_goes_on_and_outlives_tab_and_server(
    browser: Browser, server: Server, root: Path, tmp_path: Path
) -> None:
    browser.open(f"{server.base}/coating")  # long enough to be stopped
    browser.until(says("wall time"))
    browser.type(field("coating number"), "4")
    browser.click("run")
    browser.until(says("remaining kinetic energy"))
    browser.click("stop")
    browser.until(says("stopped"))
    assert not (root / "runs" / "coating-1" / "summary.json").exists()
    browser.click("go on")
    browser.until(says("running"))
    browser.open("about:blank")  # the tab is closed
    server.stop(signal.SIGKILL)
    second = Server(root)
    try:
        enter(browser, second)
        browser.open(f"{second.base}/runs")
        browser.until(says("coating-1"))
        browser.open(f"{second.base}/run/coating-1")
        browser.until(says("finished"))
        browser.until(says("of 4 particles"))
    finally:
        second.stop()
