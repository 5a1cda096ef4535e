"""What the ray caster's surface draws, one direction at a time."""

import warp as wp

from samira_subject.raycaster_sampling import draw_point
from samira_subject.shading import LitPoint, lobe_density, sample_lobe


@wp.func
def bumpy(normal: wp.vec3, view: wp.vec3, roughness: wp.float32) -> LitPoint:
    """A surface that faces +z but for its bumps."""
    surface = LitPoint()
    surface.view = view
    surface.normal = normal
    surface.smooth_normal = wp.vec3(0.0, 0.0, 1.0)
    surface.roughness = roughness
    surface.specular = 0.04
    surface.scatter = 1.0
    return surface


@wp.kernel(enable_backward=False)
def densities(
    first: wp.int32,
    lights: wp.array[wp.vec3],
    normal: wp.vec3,
    view: wp.vec3,
    roughness: wp.float32,
    found: wp.array[wp.float32],
):
    index = first + wp.tid()
    found[index] = lobe_density(bumpy(normal, view, roughness), lights[index])


@wp.kernel(enable_backward=False)
def directions(
    first: wp.int32,
    seed: wp.uint32,
    normal: wp.vec3,
    view: wp.vec3,
    roughness: wp.float32,
    found: wp.array[wp.vec3],
):
    index = first + wp.tid()
    found[index] = sample_lobe(bumpy(normal, view, roughness), draw_point(index, seed))
