"""One browser's side of the viewer: what it has chosen, what it was shown, and what is due next."""

from __future__ import annotations

import math
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np

from samira_warp.head import FrameParameters
from samira_warp.support.errors import UserError
from samira_warp.view.lights import Detail
from samira_warp.view.look import Look
from samira_warp.view.scene import Scene, Sides
from samira_warp.view.sizes import MovingSize, fit
from samira_warp.view.splats import BrowserSplats
from samira_warp.view.state import State

AT_REST = 0.25
"""Seconds after the last change at which the picture is made as fine as the window."""

QUICK_QUALITY, REST_QUALITY = 80, 92
"""Of JPEG files, while something moves and when it rests."""


class Screen(Protocol):
    """What a session shows to its browser."""

    def show(self, picture: np.ndarray, *, quality: int) -> None:
        """Show a picture (H, W, 3) uint8, stretched over the window."""

    def show_splats(self, splats: BrowserSplats, *, background: str) -> None:
        """Have the browser draw splats in place of pictures, before white, black or a colour #rrggbb."""

    def hide_splats(self) -> None:
        """Draw them no more."""

    def say(self, title: str, text: str) -> None:
        """Show a line of words for a while."""

    def at_frame(self, number: int) -> None:
        """Show which frame is played."""

    def settled(self, state: State, *, height: int) -> None:
        """Show what else belongs to a state that rests, in a window of a height."""

    def download(self, name: str, content: bytes) -> None:
        """Have the browser keep a file."""


Job = Iterator[None]
"""Work beside the pictures: each step makes about one."""


class Session:
    """What one browser is shown; its controls may call from any thread, one thread makes its pictures."""

    def __init__(
        self, scene: Scene, state: State, screen: Screen, *, longest: int, wake: Callable[[], None]
    ) -> None:
        """Begin with a state.

        Args:
            scene: What all browsers look at.
            state: What is shown first.
            screen: The browser.
            longest: Longer side of a picture at rest, pixels.
            wake: Called when something has become due.
        """
        self.scene, self.screen = scene, screen
        self._longest, self._wake = longest, wake
        self._lock = threading.Lock()
        self._state, self._window = state, (1, 1)
        self._version, self._shown, self._rested = 1, 0, 0
        self._changed = -math.inf
        self._fps, self._play_from, self._play_began, self._next_frame = 0.0, 0, 0.0, 0.0
        self._jobs: deque[Job] = deque()
        self._follows = True
        self._sides, self._size = Sides.new(), MovingSize()
        self._avatar = 0  # how many were replaced
        self._sent: tuple[int, State, Detail] | None = None  # what the browser's splats are of
        self.served = -math.inf
        """When its last picture was made; the longest ago is next."""
        self.pictures = 0
        """How many were made."""

    @property
    def state(self) -> State:
        """What is chosen now."""
        return self._state

    @property
    def window(self) -> tuple[int, int]:
        """Width and height of the browser's picture, pixels."""
        return self._window

    def change(self, how: Callable[[State], State]) -> None:
        """Choose something else; a picture that was due for an older choice is not made any more."""
        with self._lock:
            state = how(self._state)
            if state == self._state:
                return
            self._state = state
            self._touch()
        self._wake()

    def see(self, look: Look, *, width: int, height: int) -> None:
        """Look from somewhere, through a window of a size."""
        with self._lock:
            if (look, (width, height)) == (self._state.look, self._window):
                return
            self._state, self._window = replace(self._state, look=look), (width, height)
            self._touch()
        self._wake()

    def refresh(self) -> None:
        """Make the picture again: the avatar is another one."""
        with self._lock:
            self._avatar += 1
            self._touch()
        self._wake()

    def play(self, frames_per_second: float) -> None:
        """Play the sequence from its present frame, or stop it at 0 frames per second."""
        with self._lock:
            self._fps = frames_per_second
            self._play_from, self._play_began = self._state.pose.frame, time.monotonic()
            self._next_frame = self._play_began
            self._touch()
        self._wake()

    def follow(self, follows: bool) -> None:
        """Let what drives the avatar live move this browser's, or the sequence again."""
        with self._lock:
            self._follows = follows
            if not follows:
                self._state = replace(self._state, pose=replace(self._state.pose, live=None))
            self._touch()
        self._wake()

    def drive(self, parameters: FrameParameters) -> None:
        """Show what a live source gave; a picture of an older one that was due is not made any more."""
        if self._follows:
            self.change(lambda state: replace(state, pose=replace(state.pose, live=parameters)))

    def begin(self, job: Job) -> None:
        """Do work beside the pictures, a step at a time."""
        with self._lock:
            self._jobs.append(job)
        self._wake()

    def due(self) -> float:
        """When (`time.monotonic`) there is something to do; infinity where nothing is."""
        with self._lock:
            if self._jobs or self._shown != self._version:
                return -math.inf
            times = [math.inf]
            if self._rested != self._version:
                times.append(self._changed + AT_REST)
            if self._fps > 0.0:
                times.append(self._next_frame)
            return min(times)

    def work(self) -> None:
        """Make the picture that is due, and a step of what is done beside it.

        Nothing is raised: a mistake is said to the browser, a fault to standard error as well.
        """
        self.served = time.monotonic()
        try:
            if self._picture_is_due():
                self._draw()
            self._step()
        except UserError as mistake:
            self.screen.say("That cannot be shown", str(mistake))
        except Exception as fault:
            traceback.print_exc(file=sys.stderr)
            self.screen.say("Something went wrong here", f"{type(fault).__name__}: {fault}")

    def _touch(self) -> None:
        self._version += 1
        self._changed = time.monotonic()

    def _picture_is_due(self) -> bool:
        with self._lock:
            now = time.monotonic()
            rests = self._rested != self._version and now >= self._changed + AT_REST
            plays = self._fps > 0.0 and now >= self._next_frame
            return self._shown != self._version or rests or plays

    def _draw(self) -> None:
        """The picture: small and soon while something moves, fine when it rests."""
        with self._lock:
            playing = self._fps > 0.0
            if playing:
                self._advance()
            version, state, window = self._version, self._state, self._window
            rests = self._shown == version and not playing
            # made or not, the same is not tried again
            self._shown = version
            if rests or playing:
                self._rested = version
        if state.splats:
            self._send_splats(state, rests=rests)
        else:
            self._send_picture(state, window=window, rests=rests)
        if playing:
            self.screen.at_frame(state.pose.frame)
        if rests:
            self.screen.settled(state, height=window[1])

    def _send_picture(self, state: State, *, window: tuple[int, int], rests: bool) -> None:
        longer = self._longest if rests else min(self._size.side, self._longest)
        wide, high = fit(*window, longer=longer)
        began = time.perf_counter()
        picture = self.scene.picture(
            state, self._sides, width=wide, height=high, detail="rest" if rests else "quick"
        )
        if not rests:
            self._size.took(time.perf_counter() - began)
        self.pictures += 1
        self.screen.show(picture, quality=REST_QUALITY if rests else QUICK_QUALITY)
        if self._sent is not None:
            self._sent = None
            self.screen.hide_splats()

    def _send_splats(self, state: State, *, rests: bool) -> None:
        """The splats, where they are others than the browser has.

        The browser follows its own camera: while that alone moves nothing is sent, and highlights wait.
        """
        avatar, sent = self._avatar, self._sent
        asked: tuple[int, State, Detail] = (avatar, state, "rest" if rests else "quick")
        if sent is not None:
            waits = not rests and (avatar, replace(state, look=sent[1].look)) == sent[:2]
            if waits or asked == sent:
                return
        splats = self.scene.splats(state, self._sides.left, detail=asked[2])
        self._sent = asked
        self.pictures += 1
        self.screen.show_splats(splats, background=state.background)

    def _advance(self) -> None:
        """The frame of this moment; frames are left out where pictures take longer than they."""
        now = time.monotonic()
        passed = int((now - self._play_began) * self._fps)
        count = len(self.scene.shown.poser.frames)
        frame = (self._play_from + passed) % count
        self._state = replace(self._state, pose=replace(self._state.pose, frame=frame))
        self._next_frame = self._play_began + (passed + 1) / self._fps

    def _step(self) -> None:
        with self._lock:
            job = self._jobs[0] if self._jobs else None
        if job is None:
            return
        done = True
        try:
            next(job)
            done = False
        except StopIteration:
            pass
        finally:
            if done:
                with self._lock:
                    self._jobs.popleft()
