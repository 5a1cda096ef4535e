"""One pixel of a path-traced picture: camera rays, the sky with shadows, two bounces between surfaces."""

from __future__ import annotations

import math

import warp as wp

from samira_subject.raycaster_sampling import (
    Sky,
    draw_point,
    look_at_sky,
    look_up_irradiance,
    sample_lit_sky,
    sample_sky,
)
from samira_subject.shading import (
    LitPoint,
    channel_normal,
    lobe_density,
    reflect_diffuse,
    reflect_specular,
    sample_cosine,
    sample_lobe,
)
from samira_warp.light.color import LUMINANCE as LUMINANCE_WEIGHTS

PI = wp.constant(math.pi)

FAR = wp.constant(10.0)
"""Metres; a ray that meets nothing before sees the sky."""

LIFT = wp.constant(2.0e-5)
"""Metres by which a ray starts above its surface: some hundred times what float32 leaves uncertain there."""

LUMINANCE = wp.constant(wp.vec3(*LUMINANCE_WEIGHTS))

GRAZING = wp.constant(0.02)
"""Least cosine between the shading normal and the view: bumps must not turn a visible point away from its
viewer."""


@wp.struct
class Head:
    """A posed head for rays: geometry in world space and maps in UV space."""

    mesh: wp.uint64
    faces: wp.array2d[wp.int32]
    points: wp.array[wp.vec3]
    normals: wp.array[wp.vec3]
    turns: wp.array[wp.mat33]
    corner_uv: wp.array2d[wp.vec2]
    albedo: wp.array2d[wp.vec3]
    finish: wp.array2d[wp.vec3]
    slopes: wp.array2d[wp.vec3]


@wp.func
def _texture(texels: wp.array2d[wp.vec3], uv: wp.vec2) -> wp.vec3:
    """Bilinear value at u, v."""
    height = texels.shape[0]
    width = texels.shape[1]
    x = wp.clamp(uv[0] * wp.float32(width) - 0.5, 0.0, wp.float32(width) - 1.001)
    y = wp.clamp((1.0 - uv[1]) * wp.float32(height) - 0.5, 0.0, wp.float32(height) - 1.001)
    column = wp.int32(x)
    row = wp.int32(y)
    across = x - wp.float32(column)
    down = y - wp.float32(row)
    upper = (1.0 - across) * texels[row, column] + across * texels[row, column + 1]
    lower = (1.0 - across) * texels[row + 1, column] + across * texels[row + 1, column + 1]
    return (1.0 - down) * upper + down * lower


@wp.func
def _surface_at(head: Head, face: wp.int32, u: wp.float32, v: wp.float32, view: wp.vec3) -> LitPoint:
    """What a ray that came from along ``view`` meets.

    ``u`` and ``v`` are the weights of the face's first two corners, as Warp's ray queries give them. Shadow
    rays start from the point lifted off the flat face towards the surface that the vertex normals mean, so
    that the light's edge shows no facets (Hanika, Hacking the Shadow Terminator, 2021).
    """
    w = 1.0 - u - v
    a = head.faces[face, 0]
    b = head.faces[face, 1]
    c = head.faces[face, 2]

    # geometry: everything on the side that the ray came from
    flat = wp.normalize(wp.cross(head.points[b] - head.points[a], head.points[c] - head.points[a]))
    side = wp.float32(1.0)
    if wp.dot(flat, view) < 0.0:
        side = wp.float32(-1.0)
    na = side * head.normals[a]
    nb = side * head.normals[b]
    nc = side * head.normals[c]

    # the surface that the vertex normals mean: the point projected onto each corner's tangent plane
    point = u * head.points[a] + v * head.points[b] + w * head.points[c]
    round_point = point
    round_point -= u * wp.min(wp.dot(point - head.points[a], na), 0.0) * na
    round_point -= v * wp.min(wp.dot(point - head.points[b], nb), 0.0) * nb
    round_point -= w * wp.min(wp.dot(point - head.points[c], nc), 0.0) * nc
    smooth = wp.normalize(u * na + v * nb + w * nc)

    # the maps: bumps tilt the normal, in the frame that turned with the face
    uv = u * head.corner_uv[face, 0] + v * head.corner_uv[face, 1] + w * head.corner_uv[face, 2]
    slope = side * (head.turns[face] * _texture(head.slopes, uv))
    finish = _texture(head.finish, uv)
    surface = LitPoint()
    surface.view = view
    surface.smooth_normal = _facing(smooth, view)
    surface.normal = _facing(wp.normalize(smooth - slope + wp.dot(slope, smooth) * smooth), view)
    surface.position = round_point + side * LIFT * flat
    surface.albedo = _texture(head.albedo, uv)
    surface.roughness = finish[0]
    surface.specular = finish[1]
    surface.scatter = finish[2]
    return surface


@wp.func
def _facing(normal: wp.vec3, view: wp.vec3) -> wp.vec3:
    """The normal, bent towards the viewer as far as it must."""
    cosine = wp.dot(normal, view)
    if cosine >= GRAZING:
        return normal
    return wp.normalize(normal + (GRAZING - cosine) * view)


@wp.func
def _sees_sky(head: Head, surface: LitPoint, direction: wp.vec3) -> wp.bool:
    """Whether nothing of the head lies in a direction."""
    return not wp.mesh_query_ray_anyhit(head.mesh, surface.position, direction, FAR)


@wp.func
def _direct_light(head: Head, sky: Sky, surface: LitPoint, number: wp.int32, seed: wp.uint32) -> wp.vec3:
    """Diffuse radiance, from one direction of the sky, where bumps and highlights do not matter."""
    sample = sample_lit_sky(sky, surface.smooth_normal, number, seed)
    cosine = wp.dot(surface.smooth_normal, sample.direction)
    if sample.density <= 0.0:
        return wp.vec3(0.0)
    if not _sees_sky(head, surface, sample.direction):
        return wp.vec3(0.0)
    return wp.cw_mul(surface.albedo, sample.radiance) * (cosine / (PI * sample.density))


@wp.func
def _bounced_light(
    head: Head, sky: Sky, hit: wp.MeshQueryRay, direction: wp.vec3, number: wp.int32, seed: wp.uint32
) -> wp.vec3:
    """Radiance that other parts of the head send back.

    It is that of the part which was hit, and what reaches it from a second one. Without the second one, what
    lies between lips and teeth is black.
    """
    other = _surface_at(head, hit.face, hit.u, hit.v, -direction)
    light = _direct_light(head, sky, other, number, seed + wp.uint32(3))
    onward = sample_cosine(other.smooth_normal, draw_point(number, seed + wp.uint32(4)))
    next_hit = wp.mesh_query_ray(head.mesh, other.position, onward, FAR)
    if next_hit.result:
        further = _surface_at(head, next_hit.face, next_hit.u, next_hit.v, -onward)
        light += wp.cw_mul(other.albedo, _direct_light(head, sky, further, number, seed + wp.uint32(5)))
    return light


@wp.struct
class LightParts:
    """What one camera ray sees of the light, by its parts.

    Attributes:
        open: Diffuse light as it were if nothing of the head stood before the sky: exact.
        drawn: An estimate of the same from drawn directions.
        seen: What of ``drawn`` comes from where the surface sees the sky.
        rest: Specular light, and what other surfaces send back.
        specular: What of ``rest`` is specular.
    """

    open: wp.vec3
    drawn: wp.vec3
    seen: wp.vec3
    rest: wp.vec3
    specular: wp.vec3


@wp.func
def _open_light(sky: Sky, surface: LitPoint) -> wp.vec3:
    """Diffuse light from the whole sky."""
    light = wp.vec3(0.0)
    for channel in range(3):
        normal = channel_normal(surface, channel)
        length = wp.length(normal)
        light[channel] = (
            surface.albedo[channel] * look_up_irradiance(sky, normal / length)[channel] * length / PI
        )
    return light


@wp.func
def _shade(
    head: Head,
    sky: Sky,
    surface: LitPoint,
    index: wp.int32,
    lights: wp.int32,
    lobes: wp.int32,
    seed: wp.uint32,
) -> LightParts:
    """Light towards the viewer from directions drawn by the sky's brightness and from the surface's lobes.

    Both ways of drawing are weighted by the balance heuristic (Veach, 1997).
    """
    light = LightParts()
    light.open = _open_light(sky, surface)

    # towards the sky's bright parts
    by_sky = wp.float32(lights)
    by_lobes = wp.float32(lobes)
    for draw in range(lights):
        sample = sample_sky(sky, draw_point(index * lights + draw, seed + wp.uint32(1)))
        if (
            wp.max(wp.dot(surface.normal, sample.direction), wp.dot(surface.smooth_normal, sample.direction))
            > 0.0
        ):
            chance = by_sky * sample.density + by_lobes * lobe_density(surface, sample.direction)
            diffuse = wp.cw_mul(reflect_diffuse(surface, sample.direction), sample.radiance) / chance
            light.drawn += diffuse
            if _sees_sky(head, surface, sample.direction):
                light.seen += diffuse
                highlight = reflect_specular(surface, sample.direction) * sample.radiance / chance
                light.rest += highlight
                light.specular += highlight

    # where the surface reflects: there the head may stand before the sky, and send light of its own
    for draw in range(lobes):
        number = index * lobes + draw
        direction = sample_lobe(surface, draw_point(number, seed + wp.uint32(2)))
        if wp.max(wp.dot(surface.normal, direction), wp.dot(surface.smooth_normal, direction)) > 0.0:
            sample = look_at_sky(sky, direction)
            by_lobe = by_lobes * lobe_density(surface, direction)
            chance = by_sky * sample.density + by_lobe
            reflected = reflect_diffuse(surface, direction)
            specular = reflect_specular(surface, direction)
            diffuse = wp.cw_mul(reflected, sample.radiance) / chance
            light.drawn += diffuse
            hit = wp.mesh_query_ray(head.mesh, surface.position, direction, FAR)
            if hit.result:
                bounced = _bounced_light(head, sky, hit, direction, number, seed)
                light.rest += wp.cw_mul(reflected + wp.vec3(specular), bounced) / by_lobe
                light.specular += specular * bounced / by_lobe
            else:
                light.seen += diffuse
                light.rest += specular * sample.radiance / chance
                light.specular += specular * sample.radiance / chance
    return light


@wp.func
def _head_of(
    mesh: wp.uint64,
    faces: wp.array2d[wp.int32],
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    turns: wp.array[wp.mat33],
    corner_uv: wp.array2d[wp.vec2],
    albedo: wp.array2d[wp.vec3],
    finish: wp.array2d[wp.vec3],
    slopes: wp.array2d[wp.vec3],
) -> Head:
    """A kernel's arguments as one head."""
    head = Head()
    head.mesh = mesh
    head.faces = faces
    head.points = points
    head.normals = normals
    head.turns = turns
    head.corner_uv = corner_uv
    head.albedo = albedo
    head.finish = finish
    head.slopes = slopes
    return head


@wp.func
def _sky_of(
    radiance: wp.array2d[wp.vec3],
    rows: wp.array[wp.float32],
    columns: wp.array2d[wp.float32],
    density: wp.array2d[wp.float32],
    irradiance: wp.array2d[wp.vec3],
) -> Sky:
    """A kernel's arguments as one sky."""
    sky = Sky()
    sky.radiance = radiance
    sky.rows = rows
    sky.columns = columns
    sky.density = density
    sky.irradiance = irradiance
    return sky


@wp.kernel(enable_backward=False)
def trace_pixels(
    first: wp.int32,
    pixels: wp.array[wp.int32],
    mesh: wp.uint64,
    faces: wp.array2d[wp.int32],
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    turns: wp.array[wp.mat33],
    corner_uv: wp.array2d[wp.vec2],
    albedo: wp.array2d[wp.vec3],
    finish: wp.array2d[wp.vec3],
    slopes: wp.array2d[wp.vec3],
    sky_radiance: wp.array2d[wp.vec3],
    sky_rows: wp.array[wp.float32],
    sky_columns: wp.array2d[wp.float32],
    sky_density: wp.array2d[wp.float32],
    sky_irradiance: wp.array2d[wp.vec3],
    camera_to_world: wp.mat33,
    origin: wp.vec3,
    focal: wp.vec2,
    center: wp.vec2,
    width: wp.int32,
    begin: wp.int32,
    samples: wp.int32,
    lights: wp.int32,
    lobes: wp.int32,
    seed: wp.int32,
    open_sums: wp.array[wp.vec3],
    drawn_sums: wp.array[wp.vec3],
    seen_sums: wp.array[wp.vec3],
    rest_sums: wp.array[wp.vec3],
    specular_sums: wp.array[wp.vec3],
    product_sums: wp.array[wp.vec3],
    albedo_sums: wp.array[wp.vec3],
    finish_sums: wp.array[wp.vec3],
    normal_sums: wp.array[wp.vec3],
    hits: wp.array[wp.int32],
) -> None:
    """Add camera samples ``begin`` to ``begin + samples`` - 1 of one pixel to its sums.

    The products are those of the luminance of what a sample found (``seen`` and ``rest``), and of what it
    drew beyond ``open``.
    """
    pixel = pixels[first + wp.tid()]
    head = _head_of(mesh, faces, points, normals, turns, corner_uv, albedo, finish, slopes)
    sky = _sky_of(sky_radiance, sky_rows, sky_columns, sky_density, sky_irradiance)
    state = wp.rand_init(seed, pixel)
    pixel_seed = wp.randu(state)
    row = pixel // width
    column = pixel - row * width
    for index in range(begin, begin + samples):
        # a place within the pixel, and its ray
        shift = draw_point(index, pixel_seed)
        x = (wp.float32(column) + shift[0] - center[0]) / focal[0]
        y = (wp.float32(row) + shift[1] - center[1]) / focal[1]
        direction = wp.normalize(camera_to_world * wp.vec3(x, y, 1.0))
        hit = wp.mesh_query_ray(mesh, origin, direction, FAR)
        if hit.result:
            surface = _surface_at(head, hit.face, hit.u, hit.v, -direction)
            light = _shade(head, sky, surface, index, lights, lobes, pixel_seed)
            found = wp.dot(LUMINANCE, light.seen + light.rest)
            excess = wp.dot(LUMINANCE, light.drawn - light.open)
            open_sums[pixel] += light.open
            drawn_sums[pixel] += light.drawn
            seen_sums[pixel] += light.seen
            rest_sums[pixel] += light.rest
            specular_sums[pixel] += light.specular
            product_sums[pixel] += wp.vec3(found * found, found * excess, excess * excess)
            albedo_sums[pixel] += surface.albedo
            finish_sums[pixel] += wp.vec3(surface.roughness, surface.specular, surface.scatter)
            normal_sums[pixel] += surface.normal
            hits[pixel] += 1
