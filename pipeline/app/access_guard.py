"""Decides who may ask the server: this machine by its secret address, and paired devices in the same network.

The first part of every path is a secret token. The Host header is checked against DNS rebinding, and the Origin of
every change. A second device gets a token of its own by a code that works once.
"""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass, field
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from pipeline.app.refusals import Refusal, refuse_status

LOOPBACK, HTTP_PORT = "127.0.0.1", 80
# s that a code of pairing and the session of a paired device last.
CODE_S, SESSION_S = 300.0, 12 * 3600.0
# Characters of a code, without those that look alike; 8 of them are 39 bits.
CODE_LETTERS, CODE_LENGTH = "23456789abcdefghjkmnpqrstuvwxyz", 8
# Wrong codes that end a pairing.
MAX_WRONG_CODES = 5
# Requests of one device in the network: so many at once, and so many per second in the long run. A page with thumbnails
# of 200 shots opens at once.
BURST, RATE_HZ = 300.0, 30.0
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data: blob:; media-src 'self' blob:;"
    " style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
# Type of every refusal, and headers of a library's refusal that are kept: the size of a file without the asked part.
JSON_TYPE, KEPT_HEADERS = "application/json", ("content-range", "allow")


@dataclass(slots=True)
class Pairing:
    """A code that pairs one device."""

    code: str
    ends: float
    """Time of the monotonic clock, s."""
    wrong: int = 0


@dataclass(slots=True)
class AccessKeys:
    """The secrets of a running server; they end with it."""

    token: str = field(default_factory=lambda: secrets.token_urlsafe(18))
    """Of the pages on this machine."""
    pairing: Pairing | None = None
    devices: dict[str, tuple[str, float]] = field(default_factory=dict)
    """Address of each paired device and the end of its session, s, by its token."""

    def start_pairing(self) -> Pairing:
        """Make a code that works once; an earlier one ends."""
        code = "".join(secrets.choice(CODE_LETTERS) for _ in range(CODE_LENGTH))
        self.pairing = Pairing(code, time.monotonic() + CODE_S)
        return self.pairing

    def pair(self, code: str, device: str) -> str:
        """Pair a device.

        Args:
            code: What it read.
            device: Its address in the network.

        Returns:
            The token of the device.

        Raises:
            Refusal: There is no such code, or no longer.
        """
        pairing = self.pairing
        if pairing is None or time.monotonic() > pairing.ends:
            raise Refusal(403, "There is no code now; ask for a new one on the page of the computer.")
        if not secrets.compare_digest(code.encode(), pairing.code.encode()):
            pairing.wrong += 1
            if pairing.wrong >= MAX_WRONG_CODES:
                self.pairing = None
            raise Refusal(403, "This code is wrong; scan the code on the page of the computer again.")
        self.pairing = None
        token = secrets.token_urlsafe(18)
        self.devices[token] = device, time.monotonic() + SESSION_S
        return token

    def admits(self, token: str, device: str = "") -> bool:
        """Whether a token opens the page for a device, or for this machine itself where that is empty."""
        now = time.monotonic()
        tokens = [one for one, (owner, ends) in self.devices.items() if now < ends and owner == device]
        tokens = tokens if device else [self.token]
        return any(secrets.compare_digest(token.encode(), one.encode()) for one in tokens)


@dataclass(slots=True)
class _Allowance:
    """How many requests a device may still make, refilled with time."""

    left: float = BURST
    at: float = field(default_factory=time.monotonic)

    def take(self) -> bool:
        """Take one request, if there is one."""
        now = time.monotonic()
        self.left, self.at = min(BURST, self.left + RATE_HZ * (now - self.at)), now
        if self.left < 1:
            return False
        self.left -= 1
        return True


class AccessGuard:
    """Middleware that lets admitted requests pass and adds the headers of security to every answer."""

    def __init__(self, app: ASGIApp, keys: AccessKeys) -> None:
        self._app, self._keys = app, keys
        self._allowances: dict[str, _Allowance] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return

        async def send_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in SECURITY_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        is_refused = False

        async def send_secured(message: Message) -> None:
            nonlocal is_refused
            if message["type"] == "http.response.start" and message["status"] >= 400:
                headers = Headers(raw=message["headers"])
                is_refused = headers.get("content-type") != JSON_TYPE  # by a library, in words of its own or in none
                if is_refused:
                    response = refuse_status(message["status"]).to_response()
                    response.headers.update({name: headers[name] for name in KEPT_HEADERS if name in headers})
                    await response(scope, receive, send_headers)
            if not is_refused:
                await send_headers(message)

        try:
            response = self._admit(scope)
        except Refusal as refusal:
            response = refusal.to_response()
        await (self._app if response is None else response)(scope, receive, send_secured)

    def _admit(self, scope: Scope) -> Response | None:
        """Admit a request, or answer it here; raises Refusal."""
        headers = Headers(scope=scope)
        host, port = scope["server"]
        is_local = host == LOOPBACK
        names = (LOOPBACK, "localhost") if is_local else (host,)
        # A browser does not state the standard port.
        hosts = {f"{name}{end}" for name in names for end in ((f":{port}", "") if port == HTTP_PORT else (f":{port}",))}
        if headers.getlist("host") == [] or not hosts.issuperset(headers.getlist("host")):
            raise Refusal(400, "This server answers to its own address only.")
        device = "" if is_local else str(scope["client"][0])
        if device and not self._allowances.setdefault(device, _Allowance()).take():
            raise Refusal(429, "These are too many requests; wait a few seconds.")
        if scope["path"] == "/pair" and device and scope["method"] == "GET":
            codes = parse_qs(scope["query_string"].decode("latin-1")).get("code", [""])
            return RedirectResponse(f"/{self._keys.pair(codes[0], device)}/", 303)
        if not self._keys.admits(scope["path"].partition("/")[2].partition("/")[0], device):
            raise Refusal(404, "There is nothing at this address.")
        is_change = scope["method"] not in ("GET", "HEAD")
        if is_change and headers.get("origin", f"http://{headers['host']}") != f"http://{headers['host']}":
            raise Refusal(403, "Changes are accepted from the page of this server only.")
        scope["state"] = {**scope.get("state", {}), "is_local": is_local}
        return None
