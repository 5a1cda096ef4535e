"""Shading of pictures that nobody differentiates: what `light.shading.shade` does, where something shows."""

from __future__ import annotations

from dataclasses import replace

from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.shading.aiming import aim
from samira_warp.light import ColorSpace, FilteredLight, Shaded, shade
from samira_warp.light.color import compose
from samira_warp.support.constants import COVERED_ALPHA
from samira_warp.support.tone_names import ToneMap
from samira_warp.surface import Surface


def shade_picture(
    surface: Surface,
    camera: Camera,
    light: FilteredLight,
    *,
    alpha: Tensor,
    background: Tensor | float,
    color_space: ColorSpace,
    tone_map: ToneMap,
) -> Shaded:
    """What `shade` makes of all pixels of a camera's picture, some float32 roundings apart; constants.

    Most of a portrait is background. Directions are made and turned, and colours are bent by a tone map,
    where the head is.

    Args:
        surface: Channels (H W, width) float32, row by row.
        camera: The view.
        light: The filtered light, on the same device.
        alpha: (H W, 1) coverage.
        background: As for `shade`.
        color_space: Likewise.
        tone_map: Likewise.

    Raises:
        UserError: As for `shade`.
    """
    aimed = aim(surface.normal, alpha, camera, rotate=light.rotate)
    shaded = shade(
        replace(surface, normal=aimed.normal),
        aimed.view,
        replace(light, rotate=0.0),
        alpha=alpha,
        background=background,
        color_space=color_space if tone_map == "none" else "raw",  # what is bent is encoded after that
    )
    if tone_map == "none":
        return shaded
    covered = (alpha[:, 0] >= COVERED_ALPHA).nonzero()[:, 0]
    behind = background
    if isinstance(background, Tensor) and len(background) > 1:
        behind = background.index_select(0, covered)
    composed = compose(
        shaded.color.index_select(0, covered),
        alpha.index_select(0, covered),
        behind,
        color_space=color_space,
        tone_map=tone_map,
    )
    image = shaded.image.index_copy(0, covered, composed)
    return shaded._replace(image=image)
