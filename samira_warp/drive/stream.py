"""A live source beside what shows it: the newest frame wins, and what was too fast is left out."""

from __future__ import annotations

import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from typing import NamedTuple

from samira_warp.drive.arkit import FaceSignal
from samira_warp.drive.performer import Performance, Performer, Seen
from samira_warp.drive.sources import FilmedPicture, Source
from samira_warp.support.errors import UserError

SILENT = 1.0
"""Seconds without a frame after which a source is said to have stopped."""

MEMORY = 20
"""Frames that rates and delays are averaged over."""


class Condition(NamedTuple):
    """How a stream is.

    Attributes:
        came: Frames that the source gave.
        shown: Of these, how many moved the avatar.
        rate: Frames a second that moved it, lately.
        delay: Seconds from a frame's arrival until its pose was there, lately.
        silence: Seconds since the last frame came; None before the first.
        ended: Whether nothing more comes.
        reason: Why no face was seen in the last frame, or why the source ended; else "".
    """

    came: int = 0
    shown: int = 0
    rate: float = 0.0
    delay: float = 0.0
    silence: float | None = None
    ended: bool = False
    reason: str = ""

    def words(self, name: str) -> str:
        """In a line or two, as a page says it."""
        if self.ended:
            why = f": {self.reason}" if self.reason else ""
            return f"**`{name}` has ended**{why}. The last pose is held."
        if self.silence is None:
            return f"Waiting for `{name}`."
        if self.silence > SILENT:
            return f"**`{name}` has stopped** {self.silence:.0f} s ago. The last pose is held."
        text = (
            f"`{name}` drives: {self.rate:.0f} poses a second, {1e3 * self.delay:.0f} ms after their frames."
        )
        left_out = self.came - self.shown
        if left_out > 0:
            text += f" {left_out:,} of {self.came:,} frames came too fast and were left out."
        return f"{text} **No face: {self.reason}; the last pose is held.**" if self.reason else text


class Stream:
    """Two threads: one takes what comes, the other makes poses of the newest."""

    def __init__(self, source: Source, performer: Performer) -> None:
        """Prepare; `start` begins.

        Args:
            source: Where frames come from. One that is not live is played at its own speed.
            performer: What makes poses of them.
        """
        self.source, self._performer = source, performer
        self.latest: Performance | None = None
        """The last pose; None before the first."""
        self._changed = threading.Condition()
        self._newest: tuple[float, FilmedPicture | FaceSignal] | None = None
        self._ended = self._neutral = False
        self._came, self._shown, self._reason = 0, 0, ""
        self._arrived: float | None = None
        self._poses: list[tuple[float, float]] = []
        self._threads: list[threading.Thread] = []
        self._on_pose: Callable[[Performance], None] = lambda performance: None

    def start(self, on_pose: Callable[[Performance], None]) -> None:
        """Begin.

        Args:
            on_pose: Called with every pose, from a thread of the stream's.
        """
        self._on_pose = on_pose
        for work in (self._take, self._perform):
            thread = threading.Thread(target=work, name=f"drive{work.__name__}", daemon=True)
            self._threads.append(thread)
            thread.start()

    def end(self, *, timeout: float = 2.0) -> None:
        """Take nothing more, and let the source go."""
        self.source.end()
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join(timeout)

    def take_for_neutral(self) -> None:
        """Take the newest face for the neutral one from the next frame on."""
        with self._changed:
            self._neutral = True

    def condition(self) -> Condition:
        """How it is now."""
        with self._changed:
            silence = None if self._arrived is None else time.monotonic() - self._arrived
            poses, ended = list(self._poses), self._ended and self._newest is None
            came, shown, reason = self._came, self._shown, self._reason
        rate = delay = 0.0
        if len(poses) > 1:
            rate = (len(poses) - 1) / max(poses[-1][0] - poses[0][0], 1e-6)
            delay = sum(late for _, late in poses) / len(poses)
        return Condition(came, shown, rate, delay, silence, ended, reason)

    def _take(self) -> None:
        """Give what comes to the other thread; a newer frame takes an older one's place."""
        try:
            for item in _paced(self.source):
                with self._changed:
                    if self._ended:
                        return
                    self._arrived = time.monotonic()
                    self._newest, self._came = (self._arrived, item), self._came + 1
                    self._changed.notify_all()
        except Exception as fault:
            self._fail(fault)
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _perform(self) -> None:
        """Make poses until there is nothing more to make them of."""
        try:
            self._make()
        except Exception as fault:
            self._fail(fault)
            self.source.end()
            with self._changed:
                self._ended, self._newest = True, None

    def _make(self) -> None:
        """Poses of the newest frames until there are no more."""
        while True:
            with self._changed:
                while self._newest is None and not self._ended:
                    self._changed.wait()
                if self._newest is None:
                    break
                (arrived, item), self._newest = self._newest, None
                neutral, self._neutral = self._neutral, False
            if neutral:
                self._performer.take_for_neutral()
            self._show(arrived, self._performer.see(item))
        self._show(time.monotonic(), self._performer.close())

    def _fail(self, fault: Exception) -> None:
        """End for a reason; the page goes on without the source."""
        if isinstance(fault, UserError):
            self._reason = str(fault)
            print(f"warning: {fault}", file=sys.stderr)
        else:
            self._reason = f"{type(fault).__name__}: {fault}"
            traceback.print_exception(fault, file=sys.stderr)

    def _show(self, arrived: float, seen: list[Seen]) -> None:
        performed = [self._performer.perform(one) for one in seen]
        if not performed:
            return
        now = time.monotonic()
        with self._changed:
            self._shown += len(performed)
            if not self._ended or performed[-1].reason:
                self._reason = performed[-1].reason
            self._poses = [*self._poses[-MEMORY + 1 :], (now, now - arrived)]
        self.latest = performed[-1]
        self._on_pose(performed[-1])


def _paced(source: Source) -> Iterator[FilmedPicture | FaceSignal]:
    """What a source gives, one that is not live at its own speed."""
    began: tuple[float, float] | None = None
    for item in source.frames():
        if not source.live:
            began = began or (time.monotonic(), item.seconds)
            wait = began[0] + item.seconds - began[1] - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
        yield item
