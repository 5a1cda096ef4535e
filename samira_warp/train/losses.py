"""The training objective (Eqs. rgb to total_loss) and the terms of our own."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch

from samira_warp.avatar import Avatar, Motion, Rendering
from samira_warp.avatar.residual import POSITION_LIMIT
from samira_warp.kernels.image.structural_similarity import structural_similarity
from samira_warp.kernels.mesh.triangle_frames import triangle_frames
from samira_warp.light import decode_srgb
from samira_warp.train.config import Ablation
from samira_warp.train.materials import MaterialPrior, material_prior, material_terms
from samira_warp.train.neighbours import Neighbourhood, neighbourhood
from samira_warp.train.skin import mean_skin, skin_prior

SURFACE_ALPHA = 0.5
"""Neighbouring pixels both covered more than this make a pair of the smoothness term."""

TERMS = (
    "l1", "ssim", "mask", "residual", "wrinkles", "lpips", "albedo", "skin", "light", "materials",
    "normal_smoothness", "normal_prior", "response", "mse",
)  # fmt: skip
"""Everything that `total_loss` may give, in its order, and what is logged beside it."""

LIGHT_LEAST = 1e-3
"""Of radiance in a logarithm: black is a hundred times as dark as a dim wall, and no darker."""

ALBEDO_MASK = 0.95
"""Pseudo-albedo is compared where the matte is above this: at soft edges it is mixed with the background."""


@dataclass(frozen=True)
class LossWeights:
    """Weights of the training objective (Eqs. rgb to total_loss), and the terms of our own."""

    ssim: float = 0.2
    """lambda_1 of Eq. rgb."""
    lpips: float = 0.05
    """lambda_2 of Eq. rgb."""
    normal_smoothness: float = 0.15
    """lambda_3 of Eq. normal_loss."""
    normal_prior: float = 0.1
    """lambda_4 of Eq. normal_loss."""
    albedo: float = 0.1
    """lambda_5 of Eq. albedo_loss."""
    mask: float = 0.1
    """L1 of alpha against the matte: on white, low opacity buys highlights, and relit faces would leak
    white."""
    residual: float = 0.1
    """Mean square of the UV residual as a share of its limits: without it the network drifts by millimetres
    that the Gaussians' means take back, and memorises the tracker's noise frame by frame
    (docs/measurements.md)."""
    wrinkles: float = 0.01
    """Mean square of the slopes that turn normals: what stays is the normals' own."""
    response: float = 1e-3
    """Prior on the squared response logits: (albedo / c, c tau) looks the same until the light changes."""
    materials: float = 0.01
    """Square of what roughness and reflectance differ by from what was measured (`train.materials`)."""
    materials_contrast: float = 0.05
    """The same from their neighbours' on the surface."""
    light: float = 1e-3
    """Variance of the logarithm of the light's radiance over all directions: what shines from behind is seen
    along the outline at best, and would be of any colour and brightness. A lamp costs next to nothing: it is
    small."""
    skin: float = 0.1
    """Prior on skin's mean albedo where no pseudo-albedo says what it is (`train.skin`). Twice too bright
    costs a slope of 0.14 in its logarithm: more than the image's error weighs against it while the light
    follows. Skin that is as skin was measured costs nothing."""


def loss_weights(ablated: Collection[Ablation] = ()) -> LossWeights:
    """The objective's weights, less what is ablated."""
    weights = LossWeights()
    if "no-normal-prior" in ablated:
        weights = replace(weights, normal_prior=0.0)
    if "no-albedo" in ablated:
        weights = replace(weights, albedo=0.0)
    if "no-mask" in ablated:
        weights = replace(weights, mask=0.0)
    return weights


class Target(NamedTuple):
    """One training frame's pixels on the device.

    Attributes:
        image: (H, W, 3) display values on the background.
        mask: (H, W) matte, 0..1, or None where the frame has none: nothing is said of coverage then.
        albedo: (H, W, 3) linear pseudo-albedo, or None; it wants a mask.
        background: (3,) display values behind the head.
    """

    image: torch.Tensor
    mask: torch.Tensor | None
    albedo: torch.Tensor | None
    background: torch.Tensor


class Known(NamedTuple):
    """What is known of a head before any picture of it.

    Attributes:
        materials: Roughness and reflectance.
        neighbours: Which Gaussians are each other's neighbours on its surface.
        face_scales: (F,) k of every triangle at rest, metres.
        skin: (F,) bool, faces of skin whose albedo is held to what was measured, or None where it is not.
    """

    materials: MaterialPrior
    neighbours: Neighbourhood
    face_scales: torch.Tensor
    skin: torch.Tensor | None

    @classmethod
    def of(cls, avatar: Avatar, *, skin: torch.Tensor | None = None) -> Known:
        """What is known of an avatar's head, on its device."""
        device, canonical = avatar.gaussians.means.device, avatar.canonical
        materials = MaterialPrior(*(values.to(device) for values in material_prior(canonical.template)))
        face_scales = triangle_frames(canonical.vertices, canonical.topology).scale
        return cls(materials, neighbourhood(avatar.gaussians, canonical), face_scales, skin)


Perceptual = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


def total_loss(
    rendering: Rendering,
    target: Target,
    avatar: Avatar,
    weights: LossWeights,
    known: Known,
    *,
    stage_two: bool,
    perceptual: Perceptual | None,
) -> dict[str, torch.Tensor]:
    """Every weighted term by name; the objective is their sum.

    Args:
        rendering: The rendered frame.
        target: The true one.
        avatar: Whose parameters are regularised.
        weights: The lambdas.
        known: Of the avatar's head.
        stage_two: Normal and response terms are on.
        perceptual: LPIPS of two (H, W, 3) display images, or None when it is off.
    """
    prediction, truth = rendering.image, target.image
    terms = {
        "l1": (1.0 - weights.ssim) * (prediction - truth).abs().mean(),
        "ssim": weights.ssim * (1.0 - structural_similarity(prediction, truth)),
    }
    if target.mask is not None:
        terms["mask"] = weights.mask * (rendering.gbuffer.alpha[..., 0] - target.mask).abs().mean()
    if avatar.settings.residual:
        terms["residual"] = weights.residual * residual_prior(rendering.motion, avatar.canonical.atlas.valid)
    if avatar.settings.residual and avatar.settings.motion.wrinkles and stage_two:
        terms["wrinkles"] = weights.wrinkles * slopes_prior(rendering.motion, avatar.canonical.atlas.valid)
    if perceptual is not None:
        terms["lpips"] = weights.lpips * perceptual(prediction, truth)
    if target.albedo is not None and target.mask is not None:
        terms["albedo"] = weights.albedo * albedo_loss(rendering.gbuffer.albedo, target.albedo, target.mask)
    if known.skin is not None:
        terms["skin"] = weights.skin * skin_prior(mean_skin(avatar.gaussians, known.skin))
    terms["light"] = weights.light * light_prior(*avatar.light.radiance())
    off, contrast = material_terms(avatar.gaussians, known.materials, known.neighbours)
    terms["materials"] = weights.materials * off + weights.materials_contrast * contrast
    if stage_two:
        terms["normal_smoothness"] = weights.normal_smoothness * normal_smoothness(
            rendering.gbuffer.normal, rendering.gbuffer.alpha
        )
        # as wrinkles have turned them: what they turn in all frames costs what the normals' own turn does
        terms["normal_prior"] = weights.normal_prior * normal_prior(
            rendering.motion.normals, avatar.gaussians.initial_normals
        )
        terms["response"] = weights.response * avatar.response_logits.square().mean()
    return terms


def residual_prior(motion: Motion, valid: torch.Tensor) -> torch.Tensor:
    """Mean square of the residual's position and rotation, each as a share of its limit (s_mu and pi).

    Args:
        motion: With the residual's UV maps.
        valid: (H, W) texels of the atlas, over which the mean goes.
    """
    limited = motion.limited
    position, rotation = limited.position / POSITION_LIMIT, limited.rotation / torch.pi
    squares = (position.square() + rotation.square()).mean(dim=-1)
    return (squares * valid).sum() / valid.sum()


def slopes_prior(motion: Motion, valid: torch.Tensor) -> torch.Tensor:
    """Mean square of the wrinkles' slopes, along either axis.

    Args:
        motion: With the slopes' UV map.
        valid: (H, W) texels of the atlas, over which the mean goes.
    """
    return (motion.slopes.square().mean(dim=-1) * valid).sum() / valid.sum()


def normal_smoothness(normal: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """L_n^sm: mean of 1 - n_p . n_q over horizontal and vertical neighbours that are both surface.

    Args:
        normal: (H, W, 3) unit.
        alpha: (H, W, 1).
    """
    surface = (alpha[..., 0] > SURFACE_ALPHA).to(normal.dtype)
    right = surface[:, 1:] * surface[:, :-1]
    down = surface[1:] * surface[:-1]
    difference = (right * (1.0 - (normal[:, 1:] * normal[:, :-1]).sum(-1))).sum()
    difference = difference + (down * (1.0 - (normal[1:] * normal[:-1]).sum(-1))).sum()
    return difference / (right.sum() + down.sum()).clamp(min=1.0)


def normal_prior(normals: torch.Tensor, initial: torch.Tensor) -> torch.Tensor:
    """L_n^prior: mean of 1 - n^c . n^m over canonical normals.

    Args:
        normals: (N, 3), normalised here.
        initial: (N, 3) unit, what they started as.
    """
    return (1.0 - (torch.nn.functional.normalize(normals, dim=-1) * initial).sum(-1)).mean()


def light_prior(*maps: torch.Tensor) -> torch.Tensor:
    """Variance of the logarithm of a light's radiance, mean over its maps (6, R, R, 3).

    All three colours are about one mean: what costs nothing is grey.
    """
    return torch.stack([radiance.clamp(min=LIGHT_LEAST).log().var(correction=0) for radiance in maps]).mean()


def albedo_loss(albedo: torch.Tensor, truth: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """L_alb: mean absolute difference of straight linear albedo inside the matte.

    Args:
        albedo: (H, W, 3), rendered.
        truth: (H, W, 3) pseudo-albedo.
        mask: (H, W) matte.
    """
    inside = (mask > ALBEDO_MASK).to(albedo.dtype)[..., None]
    return (inside * (albedo - truth).abs()).sum() / (3.0 * inside.sum()).clamp(min=1.0)


def linear_albedo(albedo: torch.Tensor, *, color_space: str) -> torch.Tensor:
    """Pseudo-albedo as it is compared: decoded from sRGB, or as stored where shading is in image values."""
    return decode_srgb(albedo) if color_space == "srgb" else albedo
