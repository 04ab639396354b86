"""The web server. It accepts connections only from this machine, and only requests that have the secret token."""

import hmac
import secrets
import socket
import webbrowser
from collections.abc import Awaitable, Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote, urlsplit

from nicegui import app, ui
from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse, Response

from ..errors import ColdsprayError
from .pages import add_pages
from .workspace import Workspace

HOST = "127.0.0.1"
REFUSED = "Open the address that `coldspray app` has printed: it ends in ?token=..."
# A page of results may run its own scripts, but not send requests to the server in the name of the user
SANDBOX = {"content-security-policy": "sandbox allow-scripts allow-downloads allow-popups"}
ALWAYS = {"referrer-policy": "same-origin", "x-content-type-options": "nosniff"}
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
        request = HTTPConnection(scope)
        origin = request.headers.get("origin")
        is_own = origin is None or urlsplit(origin).netloc == request.headers.get("host")
        if is_own and self._fits(request.cookies.get(self.cookie, "")):
            return await self.app(scope, receive, self._with_headers(scope, send))
        if scope["type"] == "websocket":
            await receive()
            return await send({"type": "websocket.close", "code": 1008})
        answer: Response = PlainTextResponse(REFUSED, 403, ALWAYS)
        if is_own and self._fits(request.query_params.get("token", "")):
            answer = RedirectResponse("/" + quote(scope["path"].lstrip("/")), 303, ALWAYS)
            answer.set_cookie(self.cookie, self.token, httponly=True, samesite="lax")
        await answer(scope, receive, send)

    def _fits(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.token.encode())

    def _with_headers(self, scope: Scope, send: Message) -> Message:
        more = ALWAYS | (SANDBOX if scope["path"].startswith("/files/") else {})

        async def sent(message: Scope) -> None:
            if message["type"] == "http.response.start":
                message.setdefault("headers", [])
                MutableHeaders(scope=message).update(more)
            await send(message)

        return sent


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
        # arguments of a process are visible to all users of the machine: the browser gets a file, which opens the address
        leads = Path(private) / "open.html"
        leads.write_text(f'<meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
        if show:
            app.on_startup(lambda: webbrowser.open(leads.as_uri()))
        ui.run(
            host=HOST, port=port, title="coldspray", dark=None, reload=False, show=False,
            show_welcome_message=False, uvicorn_logging_level="warning", favicon="❄",
        )  # fmt: skip
