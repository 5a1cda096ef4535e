"""The ten regions of a head, disjoint, from masks that overlap and leave gaps."""

from __future__ import annotations

import numpy as np

from samira_warp.head.template import HeadTemplate

REGIONS = ("forehead", "left_eye", "right_eye", "nose", "lips", "mouth", "cheeks", "ears", "scalp", "neck")
"""Names of the K = 10 regions, in the order of every map's channels; cheeks is the rest of the face, chin
included."""

_MASKS_BY_PRIORITY = {
    "left_eye": ("left_eye_region", "left_eyeball"),
    "right_eye": ("right_eye_region", "right_eyeball"),
    "lips": ("lips",),
    "mouth": ("mouth", "teeth", "teeth_upper", "teeth_lower"),
    "nose": ("nose",),
    "forehead": ("forehead",),
    "ears": ("left_ear", "right_ear"),
    "neck": ("neck", "boundary"),
    "scalp": ("scalp",),
    "cheeks": ("face",),
}
"""The masks of a template that make up each region; a vertex in several masks belongs to the first region
listed."""


def route_vertices(template: HeadTemplate) -> np.ndarray:
    """(V,) int64 region of each vertex: the first by priority whose masks hold it, else cheeks."""
    regions = np.full(len(template.v_template), REGIONS.index("cheeks"))
    for name, masks in reversed(_MASKS_BY_PRIORITY.items()):
        for mask in masks:
            regions[template.masks.get(mask, [])] = REGIONS.index(name)
    return regions


def route_faces(template: HeadTemplate) -> np.ndarray:
    """(F,) int64 region of each face: the one most of its vertices belong to.

    Where all three differ, it is the first of theirs by priority.
    """
    rank_of = np.empty(len(REGIONS), dtype=np.int64)
    rank_of[[REGIONS.index(name) for name in _MASKS_BY_PRIORITY]] = np.arange(len(REGIONS))
    ranks = np.sort(rank_of[route_vertices(template)][template.faces], axis=1)
    most = np.where(ranks[:, 1] == ranks[:, 2], ranks[:, 1], ranks[:, 0])
    return np.argsort(rank_of)[most]


def response_coverage(template: HeadTemplate) -> np.ndarray:
    """(F,) bool: whether most of a face's vertices are in some mask of a region.

    The other faces respond neutrally to light.
    """
    in_mask = np.zeros(len(template.v_template), dtype=bool)
    for masks in _MASKS_BY_PRIORITY.values():
        for mask in masks:
            in_mask[template.masks.get(mask, [])] = True
    return in_mask[template.faces].sum(axis=1) >= 2
