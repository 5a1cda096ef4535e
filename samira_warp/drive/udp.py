"""A port of this machine as a source: phones send a datagram for every frame."""

from __future__ import annotations

import math
import socket
import sys
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

from samira_warp.drive.arkit import FaceSignal
from samira_warp.drive.live_link_packet import is_live_link, read_live_link
from samira_warp.drive.osc_packet import OscFace, is_osc
from samira_warp.drive.text_packet import is_text, read_text
from samira_warp.support.errors import UserError, reason

LONGEST = 65535
"""Bytes of a datagram."""

WAIT = 0.1
"""Seconds after which a port that is silent looks whether it should end."""


class UdpSource:
    """Faces in datagrams: Live Link Face's layout, iFacialMocap's text, Face Cap's and VMC's messages.

    Which of them a datagram is, its first bytes tell.
    """

    live = True
    pictures = False

    def __init__(self, text: str) -> None:
        """Listen.

        Args:
            text: udp://HOST:PORT; HOST is this machine's address to listen at, 0.0.0.0 or none for all.

        Raises:
            UserError: It is not of that form, the port is in use, or the host is not this machine.
        """
        host, port = _address(text)
        self.name = text
        self._ended = self._begun = False
        self._osc: OscFace | None = None
        self._refused = 0
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
        except (OSError, UnicodeError) as fault:
            raise UserError(text, expected="a host of this machine", found=_found(fault)) from fault
        try:
            self._socket.bind(address)
        except OSError as fault:
            self._socket.close()
            raise UserError(text, expected="a port that is free here", found=_found(fault)) from fault
        self._socket.settimeout(WAIT)

    @property
    def port(self) -> int:
        """The port that it listens at."""
        return int(self._socket.getsockname()[1])

    def frames(self, *, patience: float = math.inf) -> Iterator[FaceSignal]:
        """Faces as they come. Other datagrams are left out, and the first of them is said.

        Raises:
            UserError: They are Open Sound Control, and python-osc is not there.
        """
        self._begun, last = True, math.inf
        try:
            while not self._ended and time.monotonic() - last < patience:
                try:
                    packet = self._socket.recv(LONGEST)
                except TimeoutError:
                    continue
                except OSError as fault:
                    raise UserError(self.name, expected="its next datagram", found=_found(fault)) from fault
                face = self._read(packet)
                if face is not None:
                    last = face.seconds
                    yield face
        finally:
            self._socket.close()

    def end(self) -> None:
        """Listen no more."""
        self._ended = True
        if not self._begun:
            self._socket.close()

    def _read(self, packet: bytes) -> FaceSignal | None:
        now = time.monotonic()
        try:
            if is_osc(packet):
                self._osc = self._osc or OscFace()
                return self._osc.read(packet, now)
            if is_live_link(packet):
                return read_live_link(packet, now)
            if is_text(packet):
                return read_text(packet, now)
            raise ValueError(f"it begins with {packet[:8]!r}, as none that is known does")
        except UserError:
            raise
        except ValueError as fault:
            self._refused += 1
            if self._refused == 1:
                print(f"warning: {self.name}: a datagram is left out: {fault}", file=sys.stderr)
            return None


def _address(text: str) -> tuple[str, int]:
    expected = "udp://HOST:PORT, such as udp://0.0.0.0:11111"
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError as fault:
        raise UserError("--drive", expected=expected, found=repr(text)) from fault
    if port is None or parts.path.strip("/") or parts.username or parts.query:
        raise UserError("--drive", expected=expected, found=repr(text))
    return parts.hostname or "0.0.0.0", port


def _found(fault: Exception) -> str:
    return reason(fault) if isinstance(fault, OSError) else str(fault)
