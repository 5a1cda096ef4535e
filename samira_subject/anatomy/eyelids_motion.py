"""Expressions of the left eye's lids: turns about the globe, so that the lids stay on it."""

from __future__ import annotations

import numpy as np

from samira_subject.anatomy.assembly import Anatomy
from samira_subject.anatomy.eyes import EYE, EYE_RADIUS, LID, lid_arch, lid_edge
from samira_subject.anatomy.layout import FAR
from samira_subject.anatomy.pulls import pull
from samira_subject.anatomy.rings import fade

OVERLAP = 0.35
"""Millimetres by which closed lids pass each other, so that no gap is left between straight edges."""


def blink(a: Anatomy) -> np.ndarray:
    """The upper lid comes down to the lower one, which rises a little."""
    return _turned(a, _edge_drop(a, lower_rise=0.8), lower=0.8)


def widen(a: Anatomy) -> np.ndarray:
    """The upper lid rises off the iris, the lower one drops."""
    return _turned(a, lid_arch(a.turn) * -2.2, lower=-0.9)


def squint(a: Anatomy) -> np.ndarray:
    """The lower lid rises with the cheek below it, the upper one comes down a little."""
    cheek = pull(a, (33.0, -17.0, 11.0), 11.0, (0.5, 3.0, 1.5)) + pull(
        a, (50.0, -4.0, -4.0), 9.0, (-1.5, 0.5, 1.0)
    )
    return _turned(a, lid_arch(a.turn) * 1.3, lower=2.0) + cheek


def _is_left_lid(a: Anatomy) -> np.ndarray:
    return (a.lid < FAR) & (a.points[:, 0] > 0.0)


def _edge_drop(a: Anatomy, *, lower_rise: float) -> np.ndarray:
    """(V,) millimetres that the upper lid's edge has to come down above each vertex for the eye to close."""
    upper = lid_edge(np.abs(a.turn))[:, 1]
    lower = lid_edge(-np.abs(a.turn))[:, 1]
    return np.maximum(upper - lower - lower_rise * lid_arch(a.turn), 0.0) + OVERLAP * lid_arch(a.turn)


def _turned(a: Anatomy, drop: np.ndarray, *, lower: float) -> np.ndarray:
    """(V, 3) displacement that turns lids about the globe's horizontal axis.

    Args:
        a: The mean head.
        drop: (V,) millimetres down of the upper lid's edge.
        lower: Millimetres up of the middle of the lower lid's edge.
    """
    on_lid = _is_left_lid(a)
    distance = np.maximum(a.lid, 0.0)
    down = np.where(
        a.turn >= 0.0, drop * fade(distance, 0.5, 13.0), -lower * lid_arch(a.turn) * fade(distance, 0.0, 11.0)
    )
    offset = a.points - EYE
    radius = np.hypot(offset[:, 1], offset[:, 2])
    # the edge comes down by `drop` in front view: an arc of the circle on which it moves
    edge_radius = np.sqrt(np.maximum((EYE_RADIUS + LID) ** 2 - offset[:, 0] ** 2, 25.0))
    start = np.arctan2(offset[:, 1], offset[:, 2])
    upper_edge = lid_edge(a.turn)[:, 1]
    arc = np.arcsin(np.clip(upper_edge / edge_radius, -0.98, 0.98)) - np.arcsin(
        np.clip((upper_edge - down) / edge_radius, -0.98, 0.98)
    )
    end = start - arc
    moved = np.column_stack([offset[:, 0], radius * np.sin(end), radius * np.cos(end)])
    return (moved - offset) * on_lid[:, None]
