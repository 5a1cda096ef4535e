"""The joints of a rig: their names, and which one carries the head."""

from __future__ import annotations

FLAME_JOINTS = ("root", "neck", "jaw", "left_eye", "right_eye")
"""FLAME's joints in its order: those of a template that names none."""

ROOT = "root"
"""What the first joint is known by to others, whatever its template calls it; no other may be called so."""

HEAD_JOINTS = ("head", "neck")
"""Joints that carry the head, where a template does not say which one does: the first that it has."""


def known_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """A template's joints as files and other templates know them: the first is `ROOT` whatever its name."""
    return (ROOT, *names[1:])


def default_head_joint(names: tuple[str, ...]) -> str:
    """The joint that carries the head where a template does not say: of `HEAD_JOINTS`, else the root."""
    return next((name for name in HEAD_JOINTS if name in names), names[0])
