"""Where albedo and light start from, when a tracker left both: pictures less the tracker's shading."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from samira_warp.avatar import CanonicalHead
from samira_warp.data import PixelCache, TrackedSequence
from samira_warp.data.appearance import TrackedAppearance
from samira_warp.geometry.mesh import vertex_normals
from samira_warp.head.regions import REGIONS
from samira_warp.head.unwrap import UnwrapView, unwrap
from samira_warp.light import decode_srgb
from samira_warp.light.harmonics import irradiance_functions, mean_radiance
from samira_warp.train.initialize import image_view, spread_out
from samira_warp.train.skin import SKIN_LUMINANCE, SKIN_REGIONS, luminance

DARKEST = 0.1
"""Least irradiance that a picture is divided by, as a share of the light's mean: below, noise and stray light
are most of it."""

MOSTLY = 0.5
"""Texels are skin where the softened masks of skin sum to more."""


class InitialAppearance(NamedTuple):
    """What an avatar starts with.

    Attributes:
        albedo: (h, w, 3) linear texture on the head's atlas, 0 to 1.
        light: (9, 3) radiance in spherical harmonics.
    """

    albedo: Tensor
    light: Tensor


@torch.no_grad()
def initial_appearance(
    sequence: TrackedSequence,
    pixels: PixelCache,
    canonical: CanonicalHead,
    tracked: TrackedAppearance,
    *,
    reference: int,
) -> InitialAppearance:
    """Divide what training frames show by what the tracked light lends it.

    That is finer than an albedo of vertices, which is left to texels that no frame shows. How bright and of
    which colour the tracker's light is says nothing. It is made so that a white face would be white in the
    reference frame, as cameras expose and balance colours; where skin would then be brighter or darker than
    skin was ever measured, it is brought there, and the light the other way.

    Args:
        sequence: The dataset.
        pixels: Its frames at the training size.
        canonical: The subject's head.
        tracked: Albedo and light as the tracker left them.
        reference: Index of the reference frame.
    """
    skin = canonical.atlas.soft_masks[[REGIONS.index(name) for name in SKIN_REGIONS]].sum(dim=0) > MOSTLY
    light = tracked.light.to(canonical.vertices.device)
    first = image_view(sequence, pixels, canonical, reference)
    white = canonical.atlas.positions(_shading(first, canonical, light))
    white = white[skin if bool(skin.any()) else canonical.atlas.valid].mean(dim=0)
    light = light / white

    views = [image_view(sequence, pixels, canonical, index) for index in spread_out(sequence.train)]
    albedo = unwrap(
        [
            view._replace(image=decode_srgb(view.image), shading=_shading(view, canonical, light))
            for view in views
        ],
        atlas=canonical.atlas,
        vertices=canonical.vertices,
        faces=canonical.topology.faces,
        otherwise=tracked.albedo.to(light.device) * white,
    )
    if bool(skin.any()):
        found = luminance(albedo[skin].mean(dim=0))
        factor = found.clamp(*SKIN_LUMINANCE) / found.clamp(min=1e-6)
        albedo, light = albedo * factor, light / factor
    return InitialAppearance(albedo.clamp(0.0, 1.0), light)


def _shading(view: UnwrapView, canonical: CanonicalHead, light: Tensor) -> Tensor:
    """(V, 3) irradiance over pi of the vertices where a view shows them, positive."""
    normals = vertex_normals(view.vertices, canonical.topology.faces)
    return (irradiance_functions(normals) @ light).maximum(DARKEST * mean_radiance(light))
