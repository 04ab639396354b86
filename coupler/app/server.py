"""The web server. It accepts connections only from this machine, and only requests that have the secret token."""

import hmac
import secrets
import socket
import webbrowser
from collections.abc import Awaitable, Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

from nicegui import app, ui
from starlette.requests import cookie_parser

from ..errors import ColdsprayError
from .pages import add_pages
from .workspace import Workspace

HOST = "127.0.0.1"
REFUSED = b"Open the address that `coldspray app` has printed: it ends in ?token=..."
# A page of results may run its own scripts, but not speak to the server as the reader does
SANDBOX = (b"content-security-policy", b"sandbox allow-scripts allow-downloads allow-popups")
ALWAYS = [(b"referrer-policy", b"same-origin"), (b"x-content-type-options", b"nosniff")]
Scope = dict[str, Any]
Message = Callable[..., Awaitable[Any]]


class Guard:
    """ASGI application that accepts only requests with the token, in the address or in the cookie that it sets afterwards. It refuses
    requests from pages of other web sites."""

    def __init__(self, app: Callable[..., Awaitable[None]], token: str, cookie: str):
        self.app, self.token, self.cookie = app, token, cookie

    async def __call__(self, scope: Scope, receive: Message, send: Message) -> None:
        if scope["type"] not in ("http", "websocket"):
            return await self.app(scope, receive, send)
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        origin = headers.get(b"origin")
        is_own = origin is None or urlsplit(origin).netloc == headers.get(b"host")
        # takes what browsers send: cookies of other servers of this machine need not follow the standard
        held = cookie_parser(headers.get(b"cookie", "")).get(self.cookie, "")
        given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if is_own and self._fits(held):
            await self.app(scope, receive, self._with_headers(scope, send))
        elif is_own and scope["type"] == "http" and self._fits(given):
            cookie = f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Lax"
            to = [(b"location", ("/" + quote(scope["path"].lstrip("/"))).encode()), (b"set-cookie", cookie.encode())]
            await _answer(send, 303, b"", to)
        elif scope["type"] == "http":
            await _answer(send, 403, REFUSED, [(b"content-type", b"text/plain")])
        else:
            await receive()
            await send({"type": "websocket.close", "code": 1008})

    def _fits(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.token.encode())

    def _with_headers(self, scope: Scope, send: Message) -> Message:
        more = [*ALWAYS, *([SANDBOX] if scope["path"].startswith("/files/") else [])]

        async def sent(message: Scope) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", ()), *more]}
            await send(message)

        return sent


async def _answer(send: Message, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
    await send({"type": "http.response.start", "status": status, "headers": [*headers, *ALWAYS]})
    await send({"type": "http.response.body", "body": body})


def serve(workspace: Workspace, port: int, show: bool) -> None:
    """Run the web server for a workspace until Ctrl-C. port: port number, 0 for any free one; show: whether to open a browser. Raises
    ColdsprayError if the port is in use."""
    token = secrets.token_urlsafe(24)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            why = f"port {port} of this machine cannot be used ({error.strerror})"
            raise ColdsprayError(f"{why}: give another port with --port, or --port 0 for any free port") from None
        port = probe.getsockname()[1]
    app.add_static_files("/files", workspace.runs, max_cache_age=0)
    app.add_middleware(Guard, token=token, cookie=f"coldspray-{port}")
    add_pages(workspace)
    address = f"http://{HOST}:{port}/?token={token}"
    print(f"coldspray on {workspace.root}: {address}", flush=True)
    print("Ctrl-C stops the page; its runs continue", flush=True)
    with TemporaryDirectory(prefix=".open_", dir=workspace.root) as private:
        # the arguments of a browser are visible to all users of the machine: it gets a file that leads to the address
        leads = Path(private) / "open.html"
        leads.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
        if show:
            app.on_startup(lambda: webbrowser.open(leads.as_uri()))
        ui.run(
            host=HOST, port=port, title="coldspray", dark=None, reload=False, show=False,
            show_welcome_message=False, uvicorn_logging_level="warning", favicon="❄",
        )  # fmt: skip
