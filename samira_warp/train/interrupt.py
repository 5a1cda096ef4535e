"""Ctrl-C at a step's end instead of in its middle."""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import threading
from types import FrameType, TracebackType
from typing import Any

STOPPING = "stopping after this step, saving a checkpoint"
STILL_SAVING = "still saving; Ctrl-C once more gives up the steps since the last checkpoint"


class StopRequest:
    """While entered, Ctrl-C or SIGTERM sets ``asked``, and says so at once.

    A second Ctrl-C says what a third would lose, and the third interrupts. The words come from a thread of
    their own, which the system wakes: Python's handlers wait for the main thread to come back from the call
    that it is in, and that may be a kernel's compilation.
    """

    def __init__(self) -> None:
        self.asked = False
        self._given_up = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is not threading.main_thread():
            return self  # signals are the main thread's
        read, self._signals = os.pipe()
        os.set_blocking(self._signals, False)
        self._woken_before = signal.set_wakeup_fd(self._signals, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            self._previous[number] = signal.signal(number, self._handle)
        self._watcher = threading.Thread(target=self._watch, args=(read,), daemon=True)
        self._watcher.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._previous:
            return
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._woken_before)
        os.close(self._signals)
        self._watcher.join()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        if self._given_up:
            self._given_up = False
            raise KeyboardInterrupt

    def _watch(self, signals: int) -> None:
        """Read the numbers of the signals that come, until the other end is closed."""
        came, presses = 0, 0
        while number := os.read(signals, 1):
            pressed = number[0] == signal.SIGINT
            came, presses = came + 1, presses + pressed
            if came == 1:
                self.asked = True
                _say(STOPPING)
            elif pressed and presses == 2:
                _say(STILL_SAVING)
            elif pressed and presses == 3:
                self._given_up = True
                _thread.interrupt_main(signal.SIGINT)
        os.close(signals)


def _say(text: str) -> None:
    """Write a line on standard error, below a progress bar that may be there."""
    with contextlib.suppress(OSError):
        os.write(2, f"\n{text}\n".encode())
