"""The built-in subject before a camera: its head posed, rounded and lit, one picture at a time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor

from samira_subject.eyelids import EYEBALLS, Eyelids
from samira_subject.hidden_motion import HiddenMotion
from samira_subject.raycaster import Effort, Picture, PosedSkin, Skin
from samira_subject.raycaster_sampling import SkyTables
from samira_subject.subdivision import LoopSubdivision, split_corners
from samira_warp.geometry.camera import Camera
from samira_warp.head import FrameParameters, HeadTemplate, Rig
from samira_warp.light.color import compose

FOCAL_SHARE = 3.2
"""Focal length over image width: a portrait lens."""

DISTANCE = 1.0
"""Metres from the camera to the middle of the head."""


class MaterialsLike(Protocol):
    """What a head's surface is made of, in its UV layout; all float32 on the CPU."""

    @property
    def albedo(self) -> Tensor:
        """(S, S, 3) linear diffuse reflectance."""

    @property
    def finish(self) -> Tensor:
        """(S, S, 3) roughness, reflectance at normal incidence, and how much light scatters below."""

    def relief(self, expression: Tensor, jaw: float) -> Tensor:
        """(S, S, 3) gradient of the bumps' height over the mean head at rest.

        It has the wrinkles of an expression (E,) and of the jaw, radians.
        """


@dataclass(frozen=True, eq=False)
class Cast:
    """A person.

    Attributes:
        template: The head model.
        identity: (S,) float32 coefficients of its identity shapes.
        materials: What its surface is made of.
        hidden: Motion that the head model has no shapes for; None is none.
    """

    template: HeadTemplate
    identity: Tensor
    materials: MaterialsLike
    hidden: HiddenMotion | None = None


class Studio:
    """A head, a camera before it, and the rays that it takes to make a picture.

    Pictures have the same bits for any number of threads: rays are cast on as many as torch used when the
    studio was made, all else on one.
    """

    def __init__(self, cast: Cast, *, size: int, effort: Effort) -> None:
        """Prepare the head.

        Args:
            cast: Who is before the camera.
            size: Width and height of the pictures, pixels.
            effort: How many rays.
        """
        self._threads = torch.get_num_threads()
        with threads(1):
            template = cast.template
            self._materials = cast.materials
            self._effort = effort
            self._rig = Rig.build(template)
            self._identity = cast.identity
            self._hidden = cast.hidden
            self._subdivision = LoopSubdivision.build(template.faces, vertices=len(template.v_template))
            self._skin = Skin(
                faces=self._subdivision.faces,
                corner_uv=split_corners(torch.from_numpy(template.vt[template.ft])).contiguous(),
                albedo=cast.materials.albedo.contiguous(),
                finish=cast.materials.finish.contiguous(),
                rest=self._subdivision.refine(self._rig.v_template),
            )
            own_rest = self._subdivision.refine(self._rig.pose(self._rig.rest(), self._identity).vertices)
            in_eyeball = {
                name: self._refined_mask(template, name) for name in EYEBALLS if name in template.masks
            }
            self._eyelids = Eyelids.both(template, own_rest, in_eyeball)
        self.camera = portrait_camera(template, size=size)

    def pose(self, parameters: FrameParameters) -> PosedSkin:
        """The head of one frame, ready for its picture."""
        with threads(1):
            posed = self._rig.pose(parameters, self._identity)
            moved = posed.vertices
            if self._hidden is not None:
                moved = moved + self._hidden.in_world(parameters, posed)
            vertices = self._subdivision.refine(moved)
            for lids in self._eyelids:
                vertices = lids.clear(vertices, posed.joint_transforms)
            has_jaw = "jaw" in self._rig.joint_names
            opening = float(parameters.rotations[self._rig.joint("jaw"), 0]) if has_jaw else 0.0
            slopes = self._materials.relief(parameters.expression, opening)
            return PosedSkin(self._skin, vertices, slopes)

    def take(self, posed: PosedSkin, sky: SkyTables, *, seed: int, camera: Camera | None = None) -> Picture:
        """A picture under a sky, exposed.

        Args:
            posed: The head.
            sky: The light.
            seed: Decides every number drawn.
            camera: The view; None is the studio's own.
        """
        with threads(self._threads):
            return posed.render(camera or self.camera, sky, effort=self._effort, seed=seed)

    def _refined_mask(self, template: HeadTemplate, name: str) -> Tensor:
        """(V',) bool: the vertices of the finer mesh that lie in a mask, with all that they come from."""
        members = torch.zeros(len(template.v_template), 1)
        members[template.masks[name]] = 1.0
        return self._subdivision.refine(members)[:, 0] > 0.99


def portrait_camera(template: HeadTemplate, *, size: int) -> Camera:
    """A camera that looks along -z at the middle of the head without its neck."""
    of_head = np.ones(len(template.v_template), dtype=bool)
    for name in ("neck", "boundary"):
        of_head[template.masks.get(name, [])] = False
    heights = template.v_template[of_head, 1]
    # whole millimetres: the transforms file says exactly what the rays did
    height = round(500.0 * float(heights.min() + heights.max())) / 1000.0
    world_to_camera = torch.tensor(
        [[1.0, 0, 0, 0], [0, -1.0, 0, height], [0, 0, -1.0, DISTANCE], [0, 0, 0, 1.0]]
    )
    return Camera(world_to_camera, FOCAL_SHARE * size, FOCAL_SHARE * size, 0.5 * size, 0.5 * size, size, size)


def developed(picture: Picture) -> np.ndarray:
    """(H, W, 3) display values on white, clipped before they meet it: as an 8-bit file has them."""
    return on_white(picture.radiance, picture.coverage)


def on_white(linear: Tensor, coverage: Tensor) -> np.ndarray:
    """(H, W, 3) display values of linear colour (H, W, 3) under coverage (H, W)."""
    return compose(linear.clamp(0.0, 1.0), coverage[..., None], torch.ones(())).numpy()


@contextlib.contextmanager
def threads(count: int) -> Iterator[None]:
    """Let torch and BLAS use so many threads.

    Sums that they divide among them depend on the number in their last bits.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        with threadpool_limits(limits=count, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)
