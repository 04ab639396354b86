"""The server answers those who hold its token, and pages of its own."""

import asyncio
import socket
import sys
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from coupler.commands.main import main

pytest.importorskip("nicegui")

from coupler.app import server
from coupler.app.server import Guard
from coupler.app.workspace import Workspace
from coupler.studies.pace import Pace

HOST, TOKEN = b"127.0.0.1:8501", "secret"


def asked(kind="http", query=b"", path="/runs", **headers):
    """The messages that the guard sends for a request: of the page behind it, a 200, or its own."""
    sent = []

    async def page(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    async def receive():
        return {}

    head = [(b"host", HOST), *((name.encode(), value) for name, value in headers.items())]
    scope = {"type": kind, "query_string": query, "path": path, "headers": head}
    asyncio.run(Guard(page, TOKEN, "coldspray-8501")(scope, receive, send))
    return sent


def test_the_token_in_the_address_becomes_a_cookie():
    answer = asked(query=b"token=secret", path="//evil.org")[0]
    headers = dict(answer["headers"])
    assert answer["status"] == 303
    assert headers[b"location"] == b"/evil.org"  # a path of this server, no other one
    assert b"HttpOnly" in headers[b"set-cookie"]
    held = headers[b"set-cookie"].split(b";")[0]
    assert asked(cookie=held)[0]["status"] == 200
    assert asked(cookie=b'other={"a": [1]}; foo[bar]=1; ' + held)[0]["status"] == 200  # of other servers of the machine
    assert dict(asked(query=b"token=secret", path="/\\a\r\n")[0]["headers"])[b"location"] == b"/%5Ca%0D%0A"


@pytest.mark.parametrize(
    "request_of",
    [
        {}, {"query": b"token=wrong"}, {"cookie": b"coldspray-8501=wrong"}, {"cookie": b"coldspray-8502=secret"},
        {"cookie": b"coldspray-8501=secret", "origin": b"http://127.0.0.1:9999"},
        {"cookie": b"coldspray-8501=secret", "origin": b"null"},
    ],
)  # fmt: skip
def test_others_are_refused(request_of):
    assert asked(**request_of)[0]["status"] == 403
    assert asked("websocket", **request_of)[0] == {"type": "websocket.close", "code": 1008}


def test_results_run_their_scripts_apart():
    """A page of results cannot use the cookie of its reader: its origin is its own (sandbox of the content security policy)."""
    known = {"cookie": b"coldspray-8501=secret"}
    assert b"content-security-policy" in dict(asked(path="/files/x/report.html", **known)[0]["headers"])
    assert b"content-security-policy" not in dict(asked(path="/runs", **known)[0]["headers"])


def test_a_port_in_use_is_told(tmp_path, capsys):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert main(["app", str(tmp_path), "--port", str(port), "--no-browser"]) == 2
    error = capsys.readouterr().err
    assert f"port {port} of this machine cannot be used" in error
    assert error.count("\n") == 1


def test_without_its_packages_the_command_names_the_extra(tmp_path, monkeypatch, capsys):
    for name in [name for name in sys.modules if name.startswith("coupler.app.") or name == "nicegui"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "nicegui", None)
    assert main(["app", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "pip install coldspray[app]" in error
    assert error.count("\n") == 1


def test_the_token_is_not_among_the_arguments_of_the_browser(tmp_path, monkeypatch, capsys):
    """All users of a machine see the arguments of a process."""
    opened = []
    monkeypatch.setattr(server.ui, "run", lambda **_: None)
    monkeypatch.setattr(server.app, "add_middleware", lambda *_, **__: None)
    monkeypatch.setattr(server.app, "on_startup", lambda call: call())
    monkeypatch.setattr(server, "add_pages", lambda _: None)
    monkeypatch.setattr(
        server.webbrowser, "open", lambda url: opened.append((url, Path(unquote(urlsplit(url).path)).read_text()))
    )
    server.serve(Workspace(tmp_path, {}, Pace(1.0, "")), 0, show=True)
    (url, page), address = opened[0], capsys.readouterr().out.split()[3]
    assert address in page
    assert address.split("token=")[1] not in url
    assert not list(tmp_path.glob(".open_*"))
