"""One thread makes the pictures of all browsers, in turns."""

from __future__ import annotations

import math
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable

from samira_warp.view.session import Session


class Turns:
    """The sessions of all browsers, and the thread that serves them: whoever waits longest is next."""

    def __init__(self) -> None:
        self._sessions: list[Session] = []
        self._errands: deque[Callable[[], object]] = deque()
        self._changed = threading.Condition()
        self._ended = False
        self._thread = threading.Thread(target=self._serve, name="pictures", daemon=True)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def join(self, session: Session) -> None:
        """Serve a browser from now on."""
        with self._changed:
            self._sessions.append(session)
            self._changed.notify()

    def leave(self, session: Session) -> None:
        """Serve it no more; a picture that is being made for it is made to its end."""
        with self._changed:
            if session in self._sessions:
                self._sessions.remove(session)

    def sessions(self) -> list[Session]:
        """Those that are served."""
        with self._changed:
            return list(self._sessions)

    def wake(self) -> None:
        """Look again what is due."""
        with self._changed:
            self._changed.notify()

    def between(self, errand: Callable[[], object]) -> None:
        """Do something that no picture may be made during."""
        with self._changed:
            self._errands.append(errand)
            self._changed.notify()

    def end(self, *, timeout: float = 5.0) -> None:
        """Finish the picture that is being made, and stop."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _serve(self) -> None:
        while True:
            work = self._next()
            if work is None:
                return
            try:
                work()
            except Exception:  # of an errand: browsers are served on
                traceback.print_exc(file=sys.stderr)

    def _next(self) -> Callable[[], object] | None:
        """Wait for an errand, or for the session whose turn it is; None at the end."""
        with self._changed:
            while not self._ended:
                if self._errands:
                    return self._errands.popleft()
                now = time.monotonic()
                dues = [(session.due(), session) for session in self._sessions]
                ready = [session for due, session in dues if due <= now]
                if ready:
                    return min(ready, key=lambda session: session.served).work
                soonest = min((due for due, _ in dues), default=math.inf)
                self._changed.wait(None if soonest == math.inf else soonest - now)
            return None
