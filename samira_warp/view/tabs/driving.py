"""The tab of what drives the avatar live: how it goes, whether this browser follows, and what is neutral."""

from __future__ import annotations

from collections.abc import Callable

import viser

from samira_warp.drive.stream import Condition
from samira_warp.view.controls import on_change, on_click
from samira_warp.view.session import Session


class DriveTab:
    """How the stream is, in words."""

    def __init__(
        self,
        gui: viser.GuiApi,
        session: Session,
        name: str,
        condition: Condition,
        *,
        take_for_neutral: Callable[[], None],
    ) -> None:
        self._name = name
        self._words = gui.add_markdown(condition.words(name))
        follows = gui.add_checkbox("Follow it", True, hint="Else what the tab Play has.")
        neutral = gui.add_button(
            "This face is neutral", icon=viser.Icon.MOOD_EMPTY, hint="What comes is taken relative to it."
        )
        on_change(follows, session.follow)
        on_click(neutral, take_for_neutral)

    def show(self, condition: Condition) -> None:
        """Show how the stream is by now."""
        self._words.content = condition.words(self._name)
