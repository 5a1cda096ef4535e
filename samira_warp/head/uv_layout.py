"""A head's UV coordinates: whether they give every point of it a texel of its own, and new ones if not.

Charts are packed, and cut where a head has none, by xatlas (extra ``track``).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError

PROBE = 1024
"""Texels across when covered ones are counted: twice what maps have, so that no visible overlap is missed."""

SHARED = 0.005
"""Share of the covered texels that may belong to two faces: layouts that were drawn by hand touch here and
there."""

EDGE = 1e-4
"""Barycentric coordinates above this lie within a face: neighbours share their edge's texels, and no more."""

PAIRS = 2_000_000
"""Texels that are asked of at once whether they lie in a face, 300 MB; at least one face's."""

SIZE = 512
"""Texels across that charts are packed for."""

MILLIMETRES = 1000.0
"""Of a metre. xatlas leaves out faces of less than 1.2e-7 of whatever the unit is, squared: in metres, 700 of
ICT-FaceKit's, which are a third of a millimetre wide."""

PADDING = 4
"""Texels between charts at that size: maps of half of it still reach two texels over each border."""


def uv_fault(vt: np.ndarray, ft: np.ndarray) -> str | None:
    """What keeps UV coordinates from being one atlas, in a few words; None if nothing does.

    Args:
        vt: (T, 2) UV coordinates.
        ft: (F, 3) their ids at the faces' corners.
    """
    corners = vt[ft].astype(np.float64)
    used = vt[np.unique(ft)]
    if used.min() < -1e-6 or used.max() > 1.0 + 1e-6:
        return f"UV coordinates from {used.min():.2f} to {used.max():.2f}, outside of 0 to 1"
    doubled = np.abs(_doubled_areas(corners))
    together = 0.5 * doubled.sum()
    if together > 1.0 + SHARED:
        return f"faces that cover the map {together:.1f} times over"
    flat = doubled < 1e-12
    if flat.mean() > SHARED:
        return f"{flat.mean():.0%} of the faces without an area in UV"
    covers = _covers(corners[~flat])
    shared = float((covers > 1).sum() / max((covers > 0).sum(), 1))
    if shared > SHARED:
        return f"{shared:.0%} of the texels claimed by more than one face"
    return None


def with_one_atlas(template: HeadTemplate) -> HeadTemplate:
    """The same head with UV coordinates that are one atlas: its own if they are, else `repacked`."""
    return template if uv_fault(template.vt, template.ft) is None else repacked(template)


def repacked(template: HeadTemplate) -> HeadTemplate:
    """The same head with its charts packed into one square, or with new charts where its own overlap.

    Charts have their size on the mean head, and are seen from outside: none is mirrored. Charts of its own
    are kept because artists cut few and large ones, and convolutions see no farther than a chart: xatlas by
    itself cuts a thousand of ICT-FaceKit's head, which has eighty.

    Raises:
        UserError: xatlas is not installed, or cannot make an atlas of the head.
    """
    for own_charts in (True, False):
        vt, ft = _packed(template, own_charts=own_charts)
        fault = uv_fault(vt, ft)
        if fault is None:
            return dataclasses.replace(template, vt=vt, ft=ft)
    raise UserError("UV coordinates", expected="a head that xatlas can unwrap", found=fault)


def _packed(template: HeadTemplate, *, own_charts: bool) -> tuple[np.ndarray, np.ndarray]:
    """(T, 2) float32 UV coordinates in one square and (F, 3) int32 ids at the corners."""
    xatlas = _xatlas()
    uvs = _seen_from_outside(template) if own_charts else np.zeros((1, 2))
    ft = template.ft if own_charts else np.zeros_like(template.faces)
    # xatlas wants a vertex for each pair of a place and its UV coordinates
    pairs, corners = np.unique(
        np.stack([template.faces.ravel(), ft.ravel()], axis=1), axis=0, return_inverse=True
    )
    atlas = xatlas.Atlas()
    points = MILLIMETRES * template.v_template[pairs[:, 0]].astype(np.float32)
    ids = corners.reshape(-1, 3).astype(np.uint32)
    chart_options, pack_options = xatlas.ChartOptions(), xatlas.PackOptions()
    if own_charts:
        atlas.add_mesh(points, ids, uvs=uvs[pairs[:, 1]].astype(np.float32))
        chart_options.use_input_mesh_uvs = True
    else:
        atlas.add_mesh(points, ids)
    # by default some charts are mirrored: the first option alone leaves those that packing turns over
    chart_options.fix_winding = True
    pack_options.rotate_charts = False
    pack_options.resolution, pack_options.padding, pack_options.bilinear = SIZE, PADDING, True
    atlas.generate(chart_options, pack_options)
    _, found, normalised = atlas.get_mesh(0)
    # u and v are normalised by the atlas's own width and height, which differ
    side = max(atlas.width, atlas.height)
    vt = normalised * np.array([atlas.width, atlas.height]) / side
    return vt.astype(np.float32), found.astype(np.int32)


def _xatlas() -> Any:
    try:
        import xatlas
    except ImportError as error:
        wanted = "what packs UV charts (pip install 'samira-warp[track]')"
        raise UserError("xatlas", expected=wanted, found=error) from error
    return xatlas


def _seen_from_outside(template: HeadTemplate) -> np.ndarray:
    """(T, 2) the head's own UV coordinates, mirrored chart by chart where a chart is seen from within."""
    vt, ft = template.vt.astype(np.float64), template.ft
    start, end = ft.ravel(), np.roll(ft, -1, axis=1).ravel()
    graph = csr_array((np.ones(len(start), bool), (start, end)), shape=(len(vt), len(vt)))
    chart = connected_components(graph, directed=False)[1]
    areas = np.bincount(chart[ft[:, 0]], _doubled_areas(vt[ft]), minlength=len(vt))
    return np.where((areas < 0.0)[chart][:, None], vt * (-1.0, 1.0), vt)


def _doubled_areas(corners: np.ndarray) -> np.ndarray:
    """(F,) of (F, 3, 2) triangles, positive where they turn counter-clockwise."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def _covers(corners: np.ndarray) -> np.ndarray:
    """(PROBE * PROBE,) how many of (F, 3, 2) triangles hold each texel's centre in their inside."""
    texels = corners * PROBE - 0.5
    low = np.ceil(texels.min(axis=1)).clip(0, PROBE).astype(np.int64)
    high = np.floor(texels.max(axis=1)).clip(-1, PROBE - 1).astype(np.int64)
    sizes = np.maximum(high - low + 1, 0)
    covers = np.zeros(PROBE * PROBE, np.int64)
    ends = np.cumsum(sizes.prod(axis=1))
    first = 0
    while first < len(corners):
        before = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, before + PAIRS, side="right")), first + 1)
        some = slice(first, last)
        covers += np.bincount(_inside(texels[some], low[some], sizes[some]), minlength=PROBE * PROBE)
        first = last
    return covers


def _inside(texels: np.ndarray, low: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Texels, by number, whose centres lie in (f, 3, 2) triangles, of the boxes about these."""
    counts = sizes.prod(axis=1)
    face = np.repeat(np.arange(len(texels)), counts)
    number = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    column = low[face, 0] + number % np.maximum(sizes[face, 0], 1)
    row = low[face, 1] + number // np.maximum(sizes[face, 0], 1)
    start, end, last = np.moveaxis(texels[face], 1, 0)
    place = np.stack([column, row], axis=1)
    doubled = _doubled_areas(texels)[face]
    inside = np.ones(len(face), bool)
    for here, there in ((start, end), (end, last), (last, start)):
        inside &= _doubled_areas(np.stack([place, here, there], axis=1)) / doubled > EDGE
    return (row * PROBE + column)[inside]
