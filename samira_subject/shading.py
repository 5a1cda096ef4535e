"""How a ray caster's surface answers light: Lambert below, GGX above, and how to draw directions for both.

Everything is a Warp function; the kernels are in `samira_subject.raycaster_kernels`. The specular lobe is GGX
with Smith's height-correlated masking and Schlick's Fresnel term, its directions are drawn from the visible
normals (Dupuy and Benyoub, 2023).
"""

from __future__ import annotations

import math

import warp as wp

PI = wp.constant(math.pi)

SPECULAR_SHARE = wp.constant(0.5)
"""Share of the drawn directions that follow the specular lobe: skin reflects little of the light, but in a
narrow cone."""

SCATTER = wp.constant(wp.vec3(0.75, 0.4, 0.2))
"""How far skin's diffuse light forgets small bumps, by channel: red light travels furthest below the surface
(Ma et al., 2007)."""


@wp.struct
class LitPoint:
    """A point of the head as light meets it, in world space.

    Attributes:
        position: Metres, where shadow rays start.
        view: Unit direction towards the viewer.
        normal: Unit shading normal, on the viewer's side, with bumps.
        smooth_normal: The same without bumps.
        albedo: Diffuse reflectance, linear.
        roughness: Perceptual; its square is GGX's alpha.
        specular: Reflectance at normal incidence.
        scatter: 0 for opaque, 1 for skin.
    """

    position: wp.vec3
    view: wp.vec3
    normal: wp.vec3
    smooth_normal: wp.vec3
    albedo: wp.vec3
    roughness: wp.float32
    specular: wp.float32
    scatter: wp.float32


@wp.func
def tangent_of(normal: wp.vec3) -> wp.vec3:
    """Any unit vector across ``normal``."""
    other = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(normal[0]) > 0.7:
        other = wp.vec3(0.0, 1.0, 0.0)
    return wp.normalize(wp.cross(other, normal))


@wp.func
def _distribution(normal_half: wp.float32, alpha: wp.float32) -> wp.float32:
    """GGX density of facets."""
    squared = alpha * alpha
    spread = normal_half * normal_half * (squared - 1.0) + 1.0
    return squared / (PI * spread * spread)


@wp.func
def _slope_term(cosine: wp.float32, alpha: wp.float32) -> wp.float32:
    """Smith's square root for one direction."""
    return wp.sqrt(alpha * alpha + (1.0 - alpha * alpha) * cosine * cosine)


@wp.func
def channel_normal(surface: LitPoint, channel: wp.int32) -> wp.vec3:
    """The normal whose cosine a channel's diffuse light follows.

    The further light travels below, the less of the bumps is in it. It is shorter than 1 where the two
    normals differ, as light that comes out of a rough surface is the mean over its slopes.
    """
    return surface.normal + (surface.scatter * SCATTER[channel]) * (surface.smooth_normal - surface.normal)


@wp.func
def reflect_diffuse(surface: LitPoint, light: wp.vec3) -> wp.vec3:
    """The diffuse reflectance function times the cosine for light from a unit direction."""
    cosines = wp.vec3(
        wp.max(wp.dot(channel_normal(surface, 0), light), 0.0),
        wp.max(wp.dot(channel_normal(surface, 1), light), 0.0),
        wp.max(wp.dot(channel_normal(surface, 2), light), 0.0),
    )
    return wp.cw_mul(surface.albedo, cosines) / PI


@wp.func
def reflect_specular(surface: LitPoint, light: wp.vec3) -> wp.float32:
    """The specular reflectance function times the cosine for light from a unit direction."""
    normal_light = wp.dot(surface.normal, light)
    normal_view = wp.dot(surface.normal, surface.view)
    if normal_light <= 0.0 or normal_view <= 0.0 or surface.specular <= 0.0:
        return 0.0
    alpha = surface.roughness * surface.roughness
    half = wp.normalize(surface.view + light)
    fresnel = surface.specular + (1.0 - surface.specular) * wp.pow(1.0 - wp.dot(surface.view, half), 5.0)
    masking = normal_view * _slope_term(normal_light, alpha) + normal_light * _slope_term(normal_view, alpha)
    return 0.5 * fresnel * _distribution(wp.dot(surface.normal, half), alpha) * normal_light / masking


@wp.func
def lobe_density(surface: LitPoint, light: wp.vec3) -> wp.float32:
    """Chance per steradian that `sample_lobe` draws a direction.

    Diffuse directions are drawn about both normals: about one alone, those that lie low over it but not over
    the other, which diffuse light follows as well, would come rarely and count much.
    """
    cosine = wp.max(wp.dot(surface.normal, light), 0.0)
    smooth_cosine = wp.max(wp.dot(surface.smooth_normal, light), 0.0)
    alpha = surface.roughness * surface.roughness
    normal_view = wp.max(wp.dot(surface.normal, surface.view), 1.0e-4)
    half = wp.normalize(surface.view + light)
    normal_half = wp.dot(surface.normal, half)
    # visible normals reflect some directions to below the surface: they are drawn all the same
    visible = wp.float32(0.0)
    if normal_half > 0.0:
        visible = 0.5 * _distribution(normal_half, alpha) / (normal_view + _slope_term(normal_view, alpha))
    return SPECULAR_SHARE * visible + (1.0 - SPECULAR_SHARE) * 0.5 * (cosine + smooth_cosine) / PI


@wp.func
def sample_cosine(normal: wp.vec3, u: wp.vec2) -> wp.vec3:
    """A unit direction drawn by its cosine with a unit normal."""
    tangent = tangent_of(normal)
    turn = 2.0 * PI * u[1]
    across = wp.sqrt(u[0]) * (wp.cos(turn) * tangent + wp.sin(turn) * wp.cross(normal, tangent))
    return across + wp.sqrt(1.0 - u[0]) * normal


@wp.func
def sample_lobe(surface: LitPoint, u: wp.vec2) -> wp.vec3:
    """A unit direction from the mixture of both lobes; below the surface it counts nothing."""
    if u[0] >= SPECULAR_SHARE:
        half_share = 2.0 * wp.min((u[0] - SPECULAR_SHARE) / (1.0 - SPECULAR_SHARE), 1.0)
        if half_share < 1.0:
            return sample_cosine(surface.normal, wp.vec2(half_share, u[1]))
        return sample_cosine(surface.smooth_normal, wp.vec2(half_share - 1.0, u[1]))
    tangent = tangent_of(surface.normal)
    bitangent = wp.cross(surface.normal, tangent)
    alpha = surface.roughness * surface.roughness
    view = wp.vec3(
        wp.dot(surface.view, tangent),
        wp.dot(surface.view, bitangent),
        wp.max(wp.dot(surface.view, surface.normal), 1.0e-4),
    )
    stretched = wp.normalize(wp.vec3(alpha * view[0], alpha * view[1], view[2]))
    turn = 2.0 * PI * u[1]
    up = (1.0 - u[0] / SPECULAR_SHARE) * (1.0 + stretched[2]) - stretched[2]
    across_cap = wp.sqrt(wp.max(1.0 - up * up, 0.0))
    cap = wp.vec3(across_cap * wp.cos(turn), across_cap * wp.sin(turn), up) + stretched
    half = wp.normalize(wp.vec3(alpha * cap[0], alpha * cap[1], wp.max(cap[2], 1.0e-7)))
    light = 2.0 * wp.dot(view, half) * half - view
    return wp.normalize(light[0] * tangent + light[1] * bitangent + light[2] * surface.normal)
