"""Why does a network camera give no video? Ask its address as plainly as can be, and say it in words.

The library that decodes video says only that it could not. So, once it has failed: is there such a host, does anybody
listen, and what does it answer to DESCRIBE (RTSP, RFC 2326) or GET (HTTP) with user and password, Basic or Digest
(RFC 7617, 2617)?
"""

from __future__ import annotations

import base64
import hashlib
import re
import socket
import ssl
import time
from urllib.parse import SplitResult, unquote, urlsplit

__all__ = ["why_no_stream"]

PORTS = {"rtsp": 554, "rtsps": 322, "http": 80, "https": 443}
PATIENCE = 4.0
"""Seconds for each step, and for the whole answer."""
LONGEST = 16_384
"""Bytes of an answer's head."""
NONCE = "61747269756d"


def why_no_stream(url: str) -> str:
    """Return what is wrong with a stream's address, camera or password; the text holds none of its secrets."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname or "", parts.port or PORTS[parts.scheme]
    except (ValueError, KeyError):
        return "the address is none: check it, and write characters such as @ : / ? # in a password as %40 and so on"
    try:
        status = _asked(parts, host, port, "")
        if status.code == 401 and parts.username is not None and status.challenge:
            status = _asked(parts, host, port, status.challenge)
    except (socket.gaierror, UnicodeError):  # the latter: two dots in a row, or a label that is too long
        return f"there is no host {host}: check the name, or write the camera's number (192.168. …)"
    except ConnectionRefusedError:
        return f"at {host} nobody listens on port {port}: check the port, and that RTSP or HTTP is switched on there"
    except (TimeoutError, OSError):
        return f"{host} does not answer: check that the camera is on, its address, and the network between"
    if status.code == 401:
        return (
            "the camera wants a user and a password, and the address has none: rtsp://USER:PASSWORD@…"
            if parts.username is None
            else "the camera refuses this user and password: try them in a browser; is their variable set?"
        )
    if status.code == 403:
        return "the camera knows this user and forbids the stream: give it the right to see live video"
    if status.code in (404, 454):
        return f"the camera answers, and has no stream at {parts.path or '/'}: look up its path in the manual"
    if status.code == 0:
        return (
            f"what answers at {host}:{port} does not speak {parts.scheme.upper()}: check the port and {parts.scheme}://"
        )
    if status.code >= 400:
        return f"the camera answers with error {status.code}: too many viewers at once, or start it again"
    return "the camera answers, and sends no video that can be decoded: set it to H.264 or MJPEG"


class _Status:
    def __init__(self, head: bytes) -> None:
        text = head.decode("latin-1")
        found = re.match(r"(?:RTSP|HTTP)/[\d.]+ (\d{3})", text)
        self.code = int(found[1]) if found else 0
        offers = re.findall(r"(?im)^WWW-Authenticate:\s*(.+?)\s*$", text)
        self.challenge = next((offer for offer in offers if offer.lower().startswith("digest")), "".join(offers[:1]))


def _asked(parts: SplitResult, host: str, port: int, challenge: str) -> _Status:
    """Ask once, with an answer to ``challenge`` if there is one.

    Raises:
        OSError: nobody answers.
    """
    streaming = parts.scheme in ("rtsp", "rtsps")
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    method, target = ("DESCRIBE", f"{parts.scheme}://{host}:{port}{path}") if streaming else ("GET", path)
    lines = [f"{method} {target} {'RTSP' if streaming else 'HTTP'}/1.0"]
    lines += ["CSeq: 1", "Accept: application/sdp"] if streaming else [f"Host: {host}"]
    if challenge:
        user, password = unquote(parts.username or ""), unquote(parts.password or "")
        lines.append(f"Authorization: {_credentials(challenge, method, target, user, password)}")
    with socket.create_connection((host, port), timeout=PATIENCE) as plain:
        link = plain
        if parts.scheme in ("rtsps", "https"):
            # Cameras sign their own certificates; the decoder does not check them either.
            link = ssl._create_unverified_context().wrap_socket(plain, server_hostname=host)  # noqa: S323
        link.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        head, until = b"", time.monotonic() + PATIENCE
        while b"\r\n\r\n" not in head and len(head) < LONGEST and (more := link.recv(4096)):
            head += more
            if time.monotonic() > until:
                raise TimeoutError
    return _Status(head)


def _credentials(challenge: str, method: str, target: str, user: str, password: str) -> str:
    if not challenge.lower().startswith("digest"):
        return "Basic " + base64.b64encode(f"{user}:{password}".encode()).decode()
    said = {
        key.lower(): quoted or bare for key, quoted, bare in re.findall(r'(\w+)=(?:"([^"]*)"|([^\s,]+))', challenge)
    }
    realm, nonce = said.get("realm", ""), said.get("nonce", "")
    secret, asked = _md5(f"{user}:{realm}:{password}"), _md5(f"{method}:{target}")
    fields = {"username": user, "realm": realm, "nonce": nonce, "uri": target}
    more = ""
    if "auth" in said.get("qop", "").split(","):
        fields |= {"cnonce": NONCE}
        more = ", qop=auth, nc=00000001"
        fields["response"] = _md5(f"{secret}:{nonce}:00000001:{NONCE}:auth:{asked}")
    else:
        fields["response"] = _md5(f"{secret}:{nonce}:{asked}")
    return "Digest " + ", ".join(f'{name}="{value}"' for name, value in fields.items()) + more


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
