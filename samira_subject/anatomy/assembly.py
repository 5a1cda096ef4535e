"""All parts of the head in one mesh, with what painters and sculptors need to know of each vertex."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from threadpoolctl import threadpool_limits

from samira_subject.anatomy.atlas import Chart, part_chart, skin_chart
from samira_subject.anatomy.ears import ear
from samira_subject.anatomy.eyes import eyeball
from samira_subject.anatomy.layout import FAR, half_skin
from samira_subject.anatomy.mouth import WITHIN
from samira_subject.anatomy.teeth import teeth, tongue

PARTS = (
    "skin",
    "mouth",
    "left_eyeball",
    "right_eyeball",
    "left_ear",
    "right_ear",
    "teeth_upper",
    "teeth_lower",
    "tongue",
)
"""Names of the parts, by number."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _Vertices:
    """What is known of each vertex, of one part or of the whole head.

    Attributes:
        points: (V, 3) float64.
        faces: (F, 3) int64 vertex ids, counter-clockwise from outside (in the mouth: from within it).
        part: (V,) int64 number in `PARTS`.
        mirror: (V,) int64 the vertex on the other side of the head.
        lid: (V,) millimetres of skin to the lids' edge, negative behind it; FAR away from the eyes.
        lip: (V,) millimetres of skin to the lips' border, negative on the lips, WITHIN and less in the mouth;
            FAR away from the mouth.
        turn: (V,) radians about the opening, 0 at its outer corner, positive above; 0 away from openings.
        cavity: (V,) 0 at the lips to 1 at the throat.
        tooth: (V, 2) teeth counted from the midline, and 0 at the gum's line to 1 at the edge; 0 off the
            teeth.
    """

    points: np.ndarray
    faces: np.ndarray
    part: np.ndarray
    mirror: np.ndarray
    lid: np.ndarray
    lip: np.ndarray
    turn: np.ndarray
    cavity: np.ndarray
    tooth: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Anatomy(_Vertices):
    """The mean head in millimetres.

    The origin lies midway between the eyes, x to the subject's left, y up, z out of the face.

    Attributes:
        vt: (T, 2) float64 places in the atlas.
        ft: (F, 3) int64 ids into vt.
    """

    vt: np.ndarray
    ft: np.ndarray

    def is_part(self, *names: str) -> np.ndarray:
        """(V,) bool: the vertices of some parts."""
        return np.isin(self.part, [PARTS.index(name) for name in names])


@dataclass(frozen=True, eq=False, kw_only=True)
class _Piece(_Vertices):
    """One part, whose faces, mirror images and chart count from 0."""

    chart: Chart


@cache
def mean_anatomy() -> Anatomy:
    """Put the parts together."""
    # with more threads, sums of products end in other bits
    with threadpool_limits(limits=1, user_api="blas"):
        pieces = [_skin_piece(), *_pairs(), *_middle_pieces()]
    offsets = np.cumsum([0, *(len(piece.points) for piece in pieces)])
    vt_offsets = np.cumsum([0, *(len(piece.chart.vt) for piece in pieces)])
    mirrors = [piece.mirror + offset for piece, offset in zip(pieces, offsets, strict=False)]
    for left in (1, 3):
        mirrors[left], mirrors[left + 1] = (
            pieces[left].mirror + offsets[left + 1],
            pieces[left + 1].mirror + offsets[left],
        )
    return Anatomy(
        points=np.concatenate([piece.points for piece in pieces]),
        faces=np.concatenate([piece.faces + offset for piece, offset in zip(pieces, offsets, strict=False)]),
        vt=np.concatenate([piece.chart.vt for piece in pieces]),
        ft=np.concatenate(
            [piece.chart.ft + offset for piece, offset in zip(pieces, vt_offsets, strict=False)]
        ),
        mirror=np.concatenate(mirrors),
        **{
            name: np.concatenate([getattr(piece, name) for piece in pieces])
            for name in ("part", "lid", "lip", "turn", "cavity", "tooth")
        },
    )


def _skin_piece() -> _Piece:
    """Both halves of the skin, sewn along the midline."""
    half = half_skin()
    count = len(half.points)
    off_midline = half.points[:, 0] != 0.0
    other = np.where(off_midline, count - 1 + np.cumsum(off_midline), np.arange(count))
    mirror = np.concatenate([other, np.flatnonzero(off_midline)])
    faces = np.concatenate([half.triangles, other[half.triangles][:, [0, 2, 1]]])

    def both(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, values[off_midline]])

    points = np.concatenate([half.points, half.points[off_midline] * (-1.0, 1.0, 1.0)])
    inside = both(half.lip) <= WITHIN
    return _Piece(
        points=points,
        faces=faces,
        chart=skin_chart(half),
        part=np.where(inside, PARTS.index("mouth"), PARTS.index("skin")),
        mirror=mirror,
        lid=both(half.lid),
        lip=both(half.lip),
        turn=both(half.turn),
        cavity=both(half.cavity),
        tooth=np.zeros((len(points), 2)),
    )


def _plain(
    points: np.ndarray,
    faces: np.ndarray,
    chart: Chart,
    name: str,
    mirror: np.ndarray,
    tooth: np.ndarray | None = None,
) -> _Piece:
    """A part that is neither skin nor lining."""
    count = len(points)
    return _Piece(
        points=points,
        faces=faces,
        chart=chart,
        part=np.full(count, PARTS.index(name)),
        mirror=mirror,
        lid=np.full(count, FAR),
        lip=np.full(count, FAR),
        turn=np.zeros(count),
        cavity=np.zeros(count),
        tooth=np.zeros((count, 2)) if tooth is None else tooth,
    )


def _pairs() -> list[_Piece]:
    """Eyeballs and ears, left and right."""
    pieces = []
    for name, (points, faces, flat) in (("eyeball", eyeball()), ("ear", ear())):
        same = np.arange(len(points))
        pieces.append(_plain(points, faces, part_chart(flat, faces, f"left_{name}"), f"left_{name}", same))
        turned = faces[:, [0, 2, 1]]
        mirrored = _plain(
            points * (-1.0, 1.0, 1.0),
            turned,
            part_chart(flat * (-1.0, 1.0), turned, f"right_{name}"),
            f"right_{name}",
            same,
        )
        pieces.append(mirrored)
    return pieces


def _middle_pieces() -> list[_Piece]:
    """Teeth and tongue."""
    pieces = []
    for name, part in (
        ("teeth_upper", teeth(upper=True)),
        ("teeth_lower", teeth(upper=False)),
        ("tongue", tongue()),
    ):
        distances = np.linalg.norm(part.points[:, None] * (-1.0, 1.0, 1.0) - part.points[None], axis=-1)
        pieces.append(
            _plain(
                part.points,
                part.triangles,
                part_chart(part.chart, part.triangles, name),
                name,
                distances.argmin(axis=1),
                part.paint,
            )
        )
    return pieces
