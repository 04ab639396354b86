"""Headless Chromium, driven over a pipe: enough to open a page, ask it questions and hear its complaints."""

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
FLAGS = """--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking
    --disable-component-update --disable-sync --enable-unsafe-swiftshader --remote-debugging-pipe --hide-scrollbars""".split()  # noqa: SIM905


class Browser:
    """One page of one browser, a context manager. `requests`: addresses it asked for beyond what the page holds itself;
    `complaints`: errors of its console, exceptions, refused requests."""

    def __init__(self, profile: Path, width: int = 1280, height: int = 900):
        assert CHROMIUM
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._count, self._buffer = 0, b""
        theirs_in, ours_out = os.pipe()
        ours_in, theirs_out = os.pipe()
        # the browser listens on descriptor 3 and speaks on 4; moved up first, as either may be taken by the other
        high_in, high_out = (os.dup2(fd, 100 + i) for i, fd in enumerate((theirs_in, theirs_out)))
        line = f'exec 3<&{high_in} 4>&{high_out}; exec "$@"'
        arguments = [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}", "about:blank"]
        self._process = subprocess.Popen(
            ["bash", "-c", line, "bash", *arguments], pass_fds=(high_in, high_out), stderr=subprocess.DEVNULL
        )
        for fd in (theirs_in, theirs_out, high_in, high_out):
            os.close(fd)
        self._in, self._out = ours_in, ours_out
        target = next(t for t in self._call("Target.getTargets")["targetInfos"] if t["type"] == "page")
        self._session = self._call("Target.attachToTarget", targetId=target["targetId"], flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._call(f"{domain}.enable")

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._process.terminate()
        self._process.wait(20)
        os.close(self._in)
        os.close(self._out)

    def open(self, page: Path | str) -> None:
        """Open a file, or an address."""
        self._call("Page.navigate", url=page if isinstance(page, str) else page.resolve().as_uri())
        self.until("document.readyState === 'complete'")

    def ask(self, expression: str) -> Any:
        """The value of an expression in the page."""
        answer = self._call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, expression: str, seconds: float = 180.0) -> None:
        end = time.monotonic() + seconds
        while not self.ask(expression):
            assert time.monotonic() < end, f"{expression} did not come true; {self.complaints}"
            time.sleep(0.1)

    def type(self, selector: str, text: str) -> None:
        """Put a text in the place of that of a field, as a user who types it."""
        self.ask(f"(field => {{ field.focus(); field.select(); }})(document.querySelector({json.dumps(selector)}))")
        self._call("Input.insertText", text=text)
        self.ask("document.activeElement.blur()")

    def click(self, words: str) -> None:
        """Click the button whose text ends in these words, after an icon or not, once it can be clicked."""
        ends = f"b.innerText.toLowerCase().trim().endsWith({json.dumps(words.lower())})"
        button = f"[...document.querySelectorAll('button')].find(b => {ends})"
        self.until(f"(b => b && !b.disabled && (b.click(), true))({button})")

    def screen(self, width: int, dark: bool = False) -> None:
        """Another width of the window, px, and light or dark as the reader prefers it."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._call("Emulation.setEmulatedMedia", features=[scheme])
        self._call(
            "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=width < 600
        )

    def screenshot(self, path: Path, whole: bool = False) -> Path:
        picture = self._call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(picture["data"]))
        return path

    def pdf(self, path: Path) -> Path:
        paper = self._call("Page.printToPDF", printBackground=True, preferCSSPageSize=True)
        path.write_bytes(base64.b64decode(paper["data"]))
        return path

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if hasattr(self, "_session") and not method.startswith("Target."):
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + 120
        while True:
            while b"\0" not in self._buffer:
                ready, _, _ = select.select([self._in], [], [], max(end - time.monotonic(), 0))
                piece = os.read(self._in, 1 << 20) if ready else b""
                assert piece, f"the browser did not answer {method}"
                self._buffer += piece
            line, _, self._buffer = self._buffer.partition(b"\0")
            answer = json.loads(line)
            if answer.get("id") == self._count:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self._hear(answer.get("method", ""), answer.get("params", {}))

    def _hear(self, event: str, said: dict[str, Any]) -> None:
        if event == "Network.requestWillBeSent":
            self.requests += [url for url in [said["request"]["url"]] if not url.startswith(("data:", "blob:"))]
        elif event == "Network.webSocketCreated":
            self.requests.append(said["url"])
        elif event == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(said["exceptionDetails"])[:2000])
        elif event == "Runtime.consoleAPICalled" and said["type"] in ("error", "assert"):
            self.complaints.append(" ".join(str(item.get("value", item)) for item in said["args"]))
        elif event == "Log.entryAdded" and said["entry"]["level"] == "error":
            self.complaints.append(said["entry"]["text"])
