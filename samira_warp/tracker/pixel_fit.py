"""Every frame refined by pixels: the head looks as it is known to look, and ends where it is known to."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.rays.visibility import visible
from samira_warp.light.color import decode_srgb, encode_srgb
from samira_warp.tracker.appearance import Appearance, estimate
from samira_warp.tracker.film import Film, halved
from samira_warp.tracker.landmark_terms import chunks
from samira_warp.tracker.observed import DISTANCE, View
from samira_warp.tracker.outlines import OutlineFinder, Outlines, OutlineTerm, join, usual_distances
from samira_warp.tracker.photometric import COLOR_SPREAD, PhotometricTerm, grid_of, planes, sample
from samira_warp.tracker.samples import Samples
from samira_warp.tracker.subject import TrackedHead
from samira_warp.tracker.terms import Term, minimise
from samira_warp.tracker.unknowns import Unknowns
from samira_warp.tracker.windows import in_windows

SIDE, LEVELS = 192, 2
"""Pixels of the longer side of the finest pictures, and how many levels there are, each half of the next."""

ROUNDS, STEPS = 2, 3
"""How often, at each level, it is looked up anew which points are seen; and steps in between."""

GRAZING = (0.1, 0.4)
"""Cosines of normal and view between which trust in a point's colour rises from none to all."""

COVERED = 0.9
"""Matte below which a pixel is mixed with what is behind the head."""

MOST_VARIANCE = 0.04
"""Of a point's display values: what differs more is something else in the way."""

BATCH = 16
"""Frames that are posed at once."""


class Seen(NamedTuple):
    """Points of the surface in N frames.

    Attributes:
        colors: (N, S, 3) display values.
        weights: (N, S) trust in them, 0 where a point is hidden.
        normals: (N, S, 3) unit, in the world.
    """

    colors: Tensor
    weights: Tensor
    normals: Tensor


class Known(NamedTuple):
    """What the points look like.

    Attributes:
        appearance: Their albedo, and the light.
        spread: (S,) display values by which they look otherwise, one standard deviation.
    """

    appearance: Appearance
    spread: Tensor


def posed_vertices(head: TrackedHead, unknowns: Unknowns, rows: slice) -> Tensor:
    """(n, V, 3) vertices of some frames, metres in the world."""
    parameters = unknowns.parameters(rows).to(dtype=torch.float32)
    offset = head.basis @ unknowns.offset.float()
    return head.rig.pose(parameters, unknowns.shape.float(), offset).vertices


def observe(
    head: TrackedHead, samples: Samples, unknowns: Unknowns, pictures: Tensor, mattes: Tensor, view: View
) -> Seen:
    """Look up the points of a surface in N pictures.

    Args:
        head: The head.
        samples: Its points.
        unknowns: N frames.
        pictures: (N, H, W, 3) uint8 display values.
        mattes: (N, h, w) uint8 coverage.
        view: The camera, at the frames' own size.
    """
    topology = MeshTopology.build(head.faces, len(head.rig.v_template))
    rays = RayMesh(head.rig.v_template, head.faces)
    camera = torch.tensor([0.0, 0.0, DISTANCE])
    parts: list[Seen] = []
    for rows in chunks(len(unknowns.frames), BATCH):
        vertices = posed_vertices(head, unknowns, rows)
        points = samples.of(vertices)
        normals = torch.nn.functional.normalize(samples.of(mesh_normals(vertices, topology)), dim=-1)
        weights = _trust(points, normals, camera)
        for place, each in enumerate(vertices):
            rays.refit(each)
            weights[place] *= visible(points[place], rays, origin=camera)
        grid = grid_of(view.project(view.in_camera(points), unknowns.focal), view)
        covered = sample(mattes[rows, None].float() / 255.0, grid)[..., 0]
        weights = weights * (covered > COVERED) * (grid[:, 0].abs() < 1.0).all(dim=-1)
        parts.append(Seen(sample(planes(pictures[rows]), grid), weights, normals))
    return Seen(*(torch.cat(part) for part in zip(*parts, strict=True)))


def _trust(points: Tensor, normals: Tensor, camera: Tensor) -> Tensor:
    cosine = (normals * torch.nn.functional.normalize(camera - points, dim=-1)).sum(dim=-1)
    low, high = GRAZING
    return ((cosine - low) / (high - low)).clamp(0.0, 1.0)


def know(seen: Seen) -> Known:
    """What points look like that are seen in some frames."""
    appearance = estimate(decode_srgb(seen.colors), seen.weights, seen.normals)
    squared = (seen.colors - encode_srgb(appearance.shade(seen.normals))).square().mean(dim=-1)
    total = seen.weights.sum(dim=0).clamp(min=1e-6)
    variance = (seen.weights * squared.clamp(max=MOST_VARIANCE)).sum(dim=0) / total
    return Known(appearance, (COLOR_SPREAD**2 + variance).sqrt())


def fit_pixels(
    head: TrackedHead,
    unknowns: Unknowns,
    film: Film,
    keys: Tensor,
    terms: Callable[[slice], list[Term]],
    *,
    say: Callable[[str], None],
) -> Unknowns:
    """Refine the frames of a film, from coarse to fine, the subject held.

    Args:
        head: The head.
        unknowns: Where to begin.
        film: The pictures.
        keys: (K,) frames that tell what the points look like, and how far outlines are apart.
        terms: What else pulls at some frames: landmarks and what is known of heads.
        say: Told of progress.
    """
    pixels = _Pixels(Samples.build(head), OutlineFinder.build(head, film.view))
    key_levels, key_mattes = _levels(film, keys)
    levels_of = lru_cache(maxsize=1)(lambda first, end: _levels(film, every[first:end]))
    every = torch.arange(len(unknowns.frames))
    for level, key_pictures in enumerate(key_levels):
        for _ in range(ROUNDS):
            known = pixels.know(unknowns.chosen(keys), key_pictures, key_mattes)

            def fit(rows: slice, begun: Unknowns, level: int = level, known: KnownHead = known) -> Unknowns:
                levels, mattes = levels_of(rows.start, rows.stop)
                pulls = pixels.terms(begun, levels[level], mattes, known)
                return minimise(begun, [*terms(rows), *pulls], steps=STEPS, hold_subject=True)[0]

            moved = in_windows(unknowns, fit)
            say(f"pixels at {max(key_pictures.shape[1:3])} along the longer side")
            unknowns = moved
    return unknowns


class KnownHead(NamedTuple):
    """What is known of a head in pictures.

    Attributes:
        look: What points of its surface look like.
        distances: (S,) pixels from its outline to the matte's, by point.
    """

    look: Known
    distances: Tensor


class _Pixels(NamedTuple):
    """Where a head is compared with pictures and mattes."""

    samples: Samples
    finder: OutlineFinder

    def know(self, unknowns: Unknowns, pictures: Tensor, mattes: Tensor) -> KnownHead:
        """Learn from key frames."""
        finder = self.finder
        seen = observe(finder.head, self.samples, unknowns, pictures, mattes, finder.view)
        return KnownHead(know(seen), usual_distances(self._outlines(unknowns, mattes)))

    def terms(self, unknowns: Unknowns, pictures: Tensor, mattes: Tensor, known: KnownHead) -> list[Term]:
        """What pulls at N frames."""
        finder, look = self.finder, known.look
        seen = observe(finder.head, self.samples, unknowns, pictures, mattes, finder.view)
        predicted = encode_srgb(look.appearance.shade(seen.normals))
        return [
            PhotometricTerm(self.samples.points, pictures, finder.view, predicted, seen.weights, look.spread),
            OutlineTerm(
                finder.samples.points, finder.view, self._outlines(unknowns, mattes), known.distances
            ),
        ]

    def _outlines(self, unknowns: Unknowns, mattes: Tensor) -> Outlines:
        parts = [
            self.finder.find(
                posed_vertices(self.finder.head, unknowns, rows), mattes[rows], focal=unknowns.focal
            )
            for rows in chunks(len(unknowns.frames), BATCH)
        ]
        return join(parts)


def _levels(film: Film, rows: Tensor) -> tuple[list[Tensor], Tensor]:
    """Pictures from coarse to fine, and mattes."""
    pictures, mattes = film.load(rows, SIDE)
    levels = [pictures]
    for _ in range(LEVELS - 1):
        levels.insert(0, halved(levels[0]))
    return levels, mattes
