"""How the panel's elements are wired: what a user does counts, what the program sets does not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from samira_warp.view.session import Session
from samira_warp.view.state import State


def on_change(handle: Any, apply: Callable[[Any], None]) -> None:
    """Call ``apply`` with an element's value whenever the user has changed it.

    It runs in the server's event loop, one after the other and in order, so it must be short. A value that
    the program sets calls back, too, but for no client.
    """

    async def changed(event: viser.GuiEvent[Any]) -> None:
        if event.client_id is not None:
            apply(event.target.value)

    handle.on_update(changed)


def on_click(button: Any, do: Callable[[], None]) -> None:
    """Call ``do`` whenever the user clicks a button."""

    async def clicked(_event: viser.GuiEvent[Any]) -> None:
        do()

    button.on_click(clicked)


def chooses(handle: Any, session: Session, how: Callable[[State, Any], State]) -> None:
    """Let an element's value change what its browser is shown."""
    on_change(handle, lambda value: session.change(lambda state: how(state, value)))


def put(handle: Any, value: Any) -> None:
    """Show a value that the program chose, without calling back."""
    handle.value = value
