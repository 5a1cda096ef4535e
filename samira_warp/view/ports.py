"""The port of the page."""

from __future__ import annotations

import socket

from samira_warp.support.errors import UserError, reason


def free_port(host: str, port: int) -> int:
    """The port, or a free one for 0.

    Raises:
        UserError: It is in use, or the host is not this machine.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            # what a server that has just ended leaves behind does not count
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            return int(probe.getsockname()[1])
    except (OSError, UnicodeError) as error:
        found = reason(error) if isinstance(error, OSError) else error
        raise UserError(f"{host}:{port}", expected="a port that is free here", found=found) from error
