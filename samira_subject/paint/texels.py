"""What painters know of each texel of the atlas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt

from samira_subject.anatomy.assembly import PARTS, Anatomy
from samira_warp.kernels.mesh.uv_raster import rasterize_uv


@dataclass(frozen=True, eq=False)
class Texels:
    """The N texels of a square atlas that some face covers.

    Attributes:
        size: Width and height of the atlas.
        covered: (S, S) bool.
        face: (N,) id of the face.
        points: (N, 3) millimetres of the mean head.
        part: (N,) number in PARTS of the face's part.
        lid: (N,) millimetres from the nearest lids' edge, as `Anatomy` has it.
        lip: (N,) millimetres from the lips' border.
        turn: (N,) radians about the opening.
        cavity: (N,) 0 at the lips to 1 at the throat.
        tooth: (N, 2) teeth from the midline, and 0 at the gum to 1 at the edge.
    """

    size: int
    covered: np.ndarray
    face: np.ndarray
    points: np.ndarray
    part: np.ndarray
    lid: np.ndarray
    lip: np.ndarray
    turn: np.ndarray
    cavity: np.ndarray
    tooth: np.ndarray

    @classmethod
    def build(cls, anatomy: Anatomy, *, size: int) -> Texels:
        """Rasterise the atlas."""
        raster = rasterize_uv(
            torch.from_numpy(anatomy.vt.astype(np.float32)),
            torch.from_numpy(anatomy.ft.astype(np.int32)),
            size=size,
        )
        face = raster.face.numpy()
        covered = face >= 0
        corners = anatomy.faces[face[covered]]
        weights = raster.barycentrics.numpy()[covered].astype(np.float64)

        def at_texels(values: np.ndarray) -> np.ndarray:
            return (weights.reshape(*weights.shape, *[1] * (values.ndim - 1)) * values[corners]).sum(axis=1)

        # where mouth and skin meet, a face belongs to the mouth, as its place in the atlas does
        return cls(
            size=size,
            covered=covered,
            face=face[covered],
            points=at_texels(anatomy.points),
            part=anatomy.part[corners].max(axis=1),
            **{name: at_texels(getattr(anatomy, name)) for name in ("lid", "lip", "turn", "cavity", "tooth")},
        )

    def is_part(self, *names: str) -> np.ndarray:
        """(N,) bool: the texels of some parts."""
        return np.isin(self.part, [PARTS.index(name) for name in names])

    def on_left(self) -> np.ndarray:
        """(N, 3) points, those on the subject's right mirrored to the left."""
        return np.column_stack([np.abs(self.points[:, 0]), self.points[:, 1:]])

    def spread(self, values: np.ndarray) -> np.ndarray:
        """(S, S, C) map of (N, C) values; texels that no face covers copy the nearest that one does."""
        image = np.zeros((self.size, self.size, values.shape[1]))
        image[self.covered] = values
        rows, columns = distance_transform_edt(~self.covered, return_distances=False, return_indices=True)
        return image[rows, columns]
