"""The live page's server: one page and one WebSocket, for browsers on this machine.

Pages of other sites in the same browser must not get the data. So the WebSocket accepts only pages of this server
(header ``Origin``), and every request must name this machine (header ``Host``), which refuses foreign names that
resolve to this machine. Commands also need a key, which is printed when the server starts.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import ipaddress
import json
import re
import secrets
import socket
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tornado.httpserver
import tornado.ioloop
import tornado.web
import tornado.websocket
from typing_extensions import override

from pam_antagonist.errors import BadInput

if TYPE_CHECKING:
    from pam_antagonist.nodes.watch import PipelineWatch

FRAMES = 30.0
"""Frames a second."""
_REPORTS = 15
"""Number of frames between two reports."""
_PAGES = 8
"""Largest number of open pages."""
_LONGEST_ORDER = 1000
"""Largest size of a command [bytes]."""
_PAGE = Path(__file__).with_name("watch.html")
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)


class Server:
    """Serves the page until it is stopped. `port`: to listen on; 0: any free port."""

    def __init__(
        self, source: PipelineWatch, host: str = "127.0.0.1", port: int = 8765, commands: bool = False
    ) -> None:
        self.source = source
        self.pages: set[_Live] = set()
        self.key = secrets.token_urlsafe(16) if commands else ""
        self._count = 0
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            listening = socket.create_server((host, port), family=family)
        except OSError as error:
            raise BadInput(f"cannot listen on {host}, port {port}: {error.strerror or error}") from None
        page = _PAGE.read_text(encoding="utf-8")
        application = tornado.web.Application(
            [("/", _Page, {"page": page}), ("/live", _Live, {"server": self})],
            websocket_ping_interval=10,
            websocket_max_message_size=_LONGEST_ORDER,
            log_function=lambda handler: None,
        )
        self._http = tornado.httpserver.HTTPServer(application)
        listening.setblocking(False)
        self._http.add_sockets([listening])
        taken = listening.getsockname()
        shown = f"[{taken[0]}]" if ":" in taken[0] else taken[0]
        self.address = f"http://{shown}:{taken[1]}/" + (f"#{self.key}" if commands else "")
        self._timer = tornado.ioloop.PeriodicCallback(self._tick, 1000.0 / FRAMES)
        self._timer.start()

    def stop(self) -> None:
        """Close every page and the port."""
        self._timer.stop()
        for page in list(self.pages):
            page.close()
        self._http.stop()

    def joined(self, page: _Live) -> None:
        """Add a page that has opened its WebSocket."""
        self.pages.add(page)
        self.source.listen(True)
        self._count = 0

    def left(self, page: _Live) -> None:
        """Remove a page that was closed."""
        self.pages.discard(page)
        if not self.pages:
            self.source.listen(False)

    def _tick(self) -> None:
        if not self.pages:
            return
        content: dict[str, Any] = {"frame": self.source.frame()}
        if self._count % _REPORTS == 0:
            content["report"] = {**self.source.report(), "commands": bool(self.key)}
        self._count += 1
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        for page in list(self.pages):
            page.send(text)


class _Handler(tornado.web.RequestHandler):
    """Refuses requests that do not name this machine."""

    @override
    def prepare(self) -> None:
        if not names_this_machine(self.request.host_name):
            raise tornado.web.HTTPError(403, "another host")

    @override
    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain")
        self.finish(f"{status_code}: {self._reason}\n")


class _Page(_Handler):
    @override
    def initialize(self, page: str) -> None:
        self._page = page

    @override
    def set_default_headers(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")

    @override
    def get(self) -> None:
        (script,) = _SCRIPT.findall(self._page)
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        self.set_header(
            "Content-Security-Policy",
            f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; connect-src 'self'; "
            "base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        )
        self.finish(self._page)


class _Live(_Handler, tornado.websocket.WebSocketHandler):
    @override
    def initialize(self, server: Server) -> None:
        self._server = server
        self._sending: Any = None

    @override
    def prepare(self) -> None:
        super().prepare()
        # Checked here as well, because versions of Tornado differ in when they call check_origin.
        if not all(self.check_origin(origin) for origin in self.request.headers.get_list("Origin")):
            raise tornado.web.HTTPError(403, "another page")
        if len(self._server.pages) >= _PAGES:
            raise tornado.web.HTTPError(503, "too many pages")

    @override
    def check_origin(self, origin: str) -> bool:
        # Programs other than browsers send no origin.
        return origin.lower() == f"{self.request.protocol}://{self.request.host}".lower()

    @override
    def open(self, *_: str, **__: str) -> None:
        self.set_nodelay(True)
        self._server.joined(self)

    @override
    def on_close(self) -> None:
        self._server.left(self)

    def send(self, text: str) -> None:
        """Send a frame, unless the page has not taken the last one."""
        if self._sending is not None and not self._sending.done():
            return
        try:
            self._sending = self.write_message(text)
        except tornado.websocket.WebSocketClosedError:
            self._server.left(self)

    @override
    def on_message(self, message: str | bytes) -> None:
        try:
            self._server.source.command(self._order(message))
        except BadInput as error:
            self.send(json.dumps({"refused": str(error)}))

    def _order(self, message: str | bytes) -> dict[str, Any]:
        """The command in a message of a page."""
        if not self._server.key:
            raise BadInput("read-only: start watch with --allow-commands")
        try:
            order = json.loads(message)
        except (ValueError, RecursionError):
            order = None
        if not isinstance(order, dict):
            raise BadInput("a command: expected JSON")
        if not hmac.compare_digest(str(order.get("key")).encode(), self._server.key.encode()):
            raise BadInput("a command: expected the key of the address that watch printed")
        return order


def names_this_machine(host: str) -> bool:
    """Whether the name in a request's ``Host`` is an IP address, ``localhost`` or this machine's name."""
    name = host.strip("[]").lower()
    try:
        ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return name in ("localhost", own, f"{own}.local")
    return True
