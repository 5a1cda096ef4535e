"""Placing a face mesh's landmarks on a head: from pictures of it that a landmark network has seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from samira_warp.geometry.camera import Camera
from samira_warp.geometry.closest import closest_points
from samira_warp.head.landmarks import MESH_LANDMARKS, LandmarkEmbedding
from samira_warp.head.template import HeadTemplate
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.kernels.mesh.topology import MeshTopology

NOT_SKIN = (
    "left_eyeball",
    "right_eyeball",
    "left_ear",
    "right_ear",
    "teeth",
    "teeth_upper",
    "teeth_lower",
    "mouth",
)
"""Masks of what landmarks do not lie on: they are on the skin about eyes and mouth, and before the ears."""

FINER = 2
"""Raster pixels across a picture's: what a landmark lies on is read to a quarter of a picture's pixel."""

GRAZING = 0.4
"""Cosine below which a place says little: a pixel there is several millimetres of skin."""

NEAREST = 0.03
"""Weight of the skin nearest to a landmark that is on none: outlines that the network sees beside a cheek."""

FARTHEST = 0.05
"""Of a picture's width: landmarks farther from any skin are not believed."""

APART = 0.012
"""Metres from the median beyond which a sighting of a landmark does not count."""

ASIDE, FROM_BEFORE = np.radians([32.0, 16.0])
"""Bearings: landmarks of the middle of the face count up to the first, and first of all up to the second.
Farther round the network makes them up."""

MIDDLE, EDGE = 0.6, 0.25
"""Distance from the midline, in half widths of the face: landmarks up to the first belong to its middle;
those beyond the second count from their own side, or from before, alone."""

CLOSEST = 0.4
"""Share of an even division by which landmarks along an edge stay apart."""

IRIS_RADIUS = 0.00585
"""Metres; people's irises are as good as equally large (11.7 mm across, with a deviation of 0.5)."""


class Sighting(NamedTuple):
    """A picture of a head at rest of its neck, and what the network saw in it.

    Attributes:
        camera: Where it was taken from.
        vertices: (V, 3) float32 the head in it, metres.
        landmarks: (468, 2) float64 pixels.
        opened: Whether the mouth is open: only then do pictures tell the lips' edges apart.
    """

    camera: Camera
    vertices: Tensor
    landmarks: np.ndarray
    opened: bool


class Rim(NamedTuple):
    """An edge of a lid or a lip.

    Attributes:
        line: (N,) vertex ids along it, each with an edge of the mesh to the next; from corner to corner.
        landmarks: Ids of those on it, corners included, in the same order.
    """

    line: np.ndarray
    landmarks: tuple[int, ...]


EYE_RIMS = {
    "right_upper": (33, 246, 161, 160, 159, 158, 157, 173, 133),
    "right_lower": (33, 7, 163, 144, 145, 153, 154, 155, 133),
    "left_upper": (263, 466, 388, 387, 386, 385, 384, 398, 362),
    "left_lower": (263, 249, 390, 373, 374, 380, 381, 382, 362),
}
"""The lids' edges, from the outer corner to the inner one."""

LIP_RIMS = {
    "lip_upper": (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308),
    "lip_lower": (78, 95, 88, 178, 87, 14, 317, 402, 318, 324, 308),
}
"""Where the lips meet, from the subject's right to their left."""

RIMS = EYE_RIMS | LIP_RIMS


def place_landmarks(
    template: HeadTemplate,
    sightings: list[Sighting],
    *,
    across: np.ndarray,
    mirror: np.ndarray,
    rims: dict[str, np.ndarray],
) -> LandmarkEmbedding:
    """Place the 468 points of the face mesh on a head symmetric in x, and the irises where it has eyes.

    Each landmark is carried from the pictures to the mean head's skin, the geometric median of that is
    mirrored and averaged, and the nearest skin taken. Landmarks of lids and lips are on the edges that are
    given, where along them the pictures show them.

    Args:
        template: The head; its masks say what is no skin.
        sightings: Pictures from all round the face, some with the mouth open.
        across: (468,) how far each landmark is from the midline, -1 to 1, positive to the subject's left.
        mirror: (468,) its mirror image's id.
        rims: Vertex ids along edges of lids and lips, by the names of `RIMS`; those that are missing are left
            to the network.
    """
    skin = _skin_faces(template)
    mean = template.v_template.astype(np.float64)
    cast = [_cast(template, skin, sighting) for sighting in sightings]
    places, weights = (np.stack(part) for part in zip(*cast, strict=True))
    bearings = np.array([_bearing(sighting.camera) for sighting in sightings])
    weights = weights * _trust(bearings, across)
    opened = np.array([sighting.opened for sighting in sightings])
    if opened.any():
        weights[np.ix_(~opened, sorted({*sum(LIP_RIMS.values(), ())}))] = 0.0
    points = _medians(places, weights, bearings, across)
    points = 0.5 * (points + points[mirror] * (-1.0, 1.0, 1.0))
    on_midline = mirror == np.arange(len(mirror))
    nearest = closest_points(points, mean, template.faces[skin])
    faces, barycentrics = skin[nearest.faces], nearest.barycentrics
    for _ in range(20):  # the nearest skin of a point in a furrow of the midline lies beside it
        beside = _at(mean, template.faces, faces, barycentrics)
        points[on_midline] = beside[on_midline] * (0.0, 1.0, 1.0)
        nearest = closest_points(points[on_midline], mean, template.faces[skin])
        faces[on_midline], barycentrics[on_midline] = skin[nearest.faces], nearest.barycentrics
    edges = {name: Rim(line, RIMS[name]) for name, line in rims.items()}
    for landmark, (face, weight) in _on_rims(template, skin, sightings, bearings, edges, mirror).items():
        faces[landmark], barycentrics[landmark] = face, weight
    irises = _irises(template)
    ids = np.concatenate([np.arange(MESH_LANDMARKS), irises.ids])
    return LandmarkEmbedding(
        ids.astype(np.int32),
        np.concatenate([faces, irises.faces]).astype(np.int32),
        np.concatenate([barycentrics, irises.barycentrics]).astype(np.float32),
    )


def _skin_faces(template: HeadTemplate) -> np.ndarray:
    """(S,) faces that landmarks may lie on."""
    other = np.zeros(len(template.v_template), bool)
    for name in NOT_SKIN:
        other[template.masks.get(name, [])] = True
    return np.flatnonzero(~other[template.faces].any(axis=1))


def _at(vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray, barycentrics: np.ndarray) -> np.ndarray:
    """(N, 3) points of faces."""
    return (barycentrics[:, :, None] * vertices[faces[chosen]]).sum(axis=1)


def _project(camera: Camera, vertices: Tensor) -> np.ndarray:
    """(V, 3) pixels, and depths in metres, float64."""
    transform = camera.world_to_camera.double()
    seen = vertices.double() @ transform[:3, :3].T + transform[:3, 3]
    pixels = seen[:, :2] / seen[:, 2:] * seen.new_tensor([camera.fx, camera.fy])
    return torch.cat([pixels + seen.new_tensor([camera.cx, camera.cy]), seen[:, 2:]], dim=1).numpy()


def _bearing(camera: Camera) -> float:
    """Radians from straight before the head to a camera, positive to the subject's left."""
    center = camera.center
    return float(torch.atan2(center[0], center[2]))


def _cast(template: HeadTemplate, skin: np.ndarray, sighting: Sighting) -> tuple[np.ndarray, np.ndarray]:
    """Where on the mean head's skin each landmark is seen, (468, 3) metres, and weights (468,)."""
    camera = sighting.camera
    width, height = FINER * camera.width, FINER * camera.height
    scale = np.array([FINER, FINER, 1.0])
    points = torch.from_numpy((_project(camera, sighting.vertices) * scale).astype(np.float32))
    topology = MeshTopology.build(torch.from_numpy(template.faces), vertex_count=len(points))
    raster = rasterize_mesh(points[None], topology, width=width, height=height)
    face, barycentrics = raster.face[0].numpy(), raster.barycentrics[0].numpy()
    is_skin = np.zeros(len(template.faces) + 1, bool)
    is_skin[skin] = True  # the last one, -1, stands for nothing
    away, nearest = distance_transform_edt(~is_skin[face], return_indices=True)
    pixels = np.clip((FINER * sighting.landmarks).astype(np.int64), 0, np.array([width, height]) - 1)
    away = away[pixels[:, 1], pixels[:, 0]] / FINER
    row, column = nearest[:, pixels[:, 1], pixels[:, 0]]
    chosen, weights = face[row, column], barycentrics[row, column].astype(np.float64)
    posed = sighting.vertices.double().numpy()
    corners = posed[template.faces[chosen]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = camera.center.double().numpy() - (weights[:, :, None] * corners).sum(axis=1)
    cosine = (normal * towards).sum(axis=1) / np.maximum(
        np.linalg.norm(normal, axis=1) * np.linalg.norm(towards, axis=1), 1e-12
    )
    trust = np.where(cosine > GRAZING, cosine**2, NEAREST)
    trust = np.where(away > 0.0, np.where(away < FARTHEST * camera.width, NEAREST, 0.0), trust)
    return _at(template.v_template.astype(np.float64), template.faces, chosen, weights), trust


def _trust(bearings: np.ndarray, across: np.ndarray) -> np.ndarray:
    """(N, 468) share of a picture in a landmark by where it was taken from: 0, 1, or 0.1 far aside."""
    hidden = np.sign(bearings)[:, None] * across[None] < -EDGE
    hidden &= np.abs(bearings)[:, None] > 1e-6
    aside = (np.abs(bearings)[:, None] > ASIDE) & (np.abs(across)[None] < MIDDLE)
    return np.where(hidden, 0.0, np.where(aside, 0.1, 1.0))


def _medians(places: np.ndarray, weights: np.ndarray, bearings: np.ndarray, across: np.ndarray) -> np.ndarray:
    """(468, 3) geometric medians of (N, 468, 3) places: first of the best pictures, then of all near that."""
    first = (np.abs(bearings)[:, None] < FROM_BEFORE) | (np.abs(across)[None] >= MIDDLE)
    medians = np.zeros(places.shape[1:])
    for landmark in range(len(medians)):
        place, weight = places[:, landmark], weights[:, landmark]
        medians[landmark] = _median(place, weight * first[:, landmark] + 1e-9)
        near = np.linalg.norm(place - medians[landmark], axis=1) < APART
        if (weight * near).any():
            medians[landmark] = _median(place, weight * near)
    return medians


def _median(places: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weiszfeld's iteration, rounded off below a millimetre."""
    median = np.average(places, axis=0, weights=weights)
    for _ in range(30):
        distance = np.maximum(np.linalg.norm(places - median, axis=1), 1e-3)
        median = np.average(places, axis=0, weights=weights / distance)
    return median


def _on_rims(
    template: HeadTemplate,
    skin: np.ndarray,
    sightings: list[Sighting],
    bearings: np.ndarray,
    rims: dict[str, Rim],
    mirror: np.ndarray,
) -> dict[int, tuple[int, np.ndarray]]:
    """Faces and barycentric coordinates of the landmarks on edges, by id."""
    mean = template.v_template.astype(np.float64)
    line_of = {landmark: rim.line for rim in rims.values() for landmark in rim.landmarks}
    points: dict[int, np.ndarray] = {}
    for rim in rims.values():
        ids = list(rim.landmarks)
        seen = [
            _along(_project(sighting.camera, sighting.vertices[rim.line])[:, :2], sighting.landmarks[ids])
            for sighting, bearing in zip(sightings, bearings, strict=True)
            if abs(bearing) < ASIDE
        ]
        at = _spread(np.median(seen, axis=0), len(rim.line) - 1.0)
        points |= dict(zip(ids, _on_line(mean[rim.line], at), strict=True))
    placed = {}
    for landmark, point in points.items():
        other = points.get(int(mirror[landmark]), point * (-1.0, 1.0, 1.0))
        line = line_of[landmark]
        middle = 0.5 * (point + other * (-1.0, 1.0, 1.0))
        placed[landmark] = _edge_point(template, skin, line, float(_along(mean[line], middle[None])[0]))
    return placed


def _spread(at: np.ndarray, end: float) -> np.ndarray:
    """Rising places on a line from 0 to ``end``, none closer to the next than `CLOSEST` of an even division.

    Near corners the network hardly tells one from the other.
    """
    least = CLOSEST * end / (len(at) - 1)
    room = np.arange(len(at)) * least
    at = np.append(0.0, np.append(at[1:-1], end))
    at = np.maximum.accumulate(np.maximum(at - room, 0.0)) + room
    back = room[::-1]
    return np.minimum.accumulate((np.minimum(at + back, end))[::-1])[::-1] - back


def _along(line: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(M,) where on a line (N, D) of segments its points nearest to (M, D) points are: segment and share."""
    start, step = line[:-1], np.diff(line, axis=0)
    length = np.maximum((step**2).sum(axis=1), 1e-18)
    share = np.clip(((points[:, None] - start) * step).sum(axis=2) / length, 0.0, 1.0)
    distance = np.linalg.norm(start + share[..., None] * step - points[:, None], axis=2)
    nearest = distance.argmin(axis=1)
    return nearest + share[np.arange(len(points)), nearest]


def _on_line(line: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(M, D) points of a line at segments and shares."""
    segment = np.minimum(at.astype(np.int64), len(line) - 2)
    share = (at - segment)[:, None]
    return (1.0 - share) * line[segment] + share * line[segment + 1]


def _edge_point(
    template: HeadTemplate, skin: np.ndarray, line: np.ndarray, at: float
) -> tuple[int, np.ndarray]:
    """A face with an edge of a line, and the weights of its corners there."""
    segment = min(int(at), len(line) - 2)
    start, end = line[segment], line[segment + 1]
    faces = template.faces[skin]
    with_edge = (faces == start).any(axis=1) & (faces == end).any(axis=1)
    face = int(skin[np.flatnonzero(with_edge)[0]])
    weights = np.zeros(3)
    weights[template.faces[face] == start] = 1.0 - (at - segment)
    weights[template.faces[face] == end] = at - segment
    return face, weights


def _irises(template: HeadTemplate) -> LandmarkEmbedding:
    """Pupils and irises' edges on the eyeballs, which look ahead; none where the head has no eyeballs.

    The edge is on the picture's right, above, on its left and below: 469 to 472, and 474 to 477.
    """
    mean = template.v_template.astype(np.float64)
    turns = 0.5 * np.pi * np.arange(4)
    flat = np.concatenate([np.zeros((1, 2)), IRIS_RADIUS * np.column_stack([np.cos(turns), np.sin(turns)])])
    ids, faces, barycentrics = [np.zeros(0, int)], [np.zeros(0, int)], [np.zeros((0, 3))]
    for first, name in ((468, "right_eyeball"), (473, "left_eyeball")):
        members = np.zeros(len(mean), bool)
        members[template.masks.get(name, [])] = True
        ball = np.flatnonzero(members[template.faces].all(axis=1))
        if len(ball):
            middle = 0.5 * (mean[members].min(axis=0) + mean[members].max(axis=0))
            ball = ball[(mean[template.faces[ball], 2] > middle[2]).all(axis=1)]
            # seen from before: the nearest of the front half, its depth left out
            from_before = np.pad(middle[:2] + flat, ((0, 0), (0, 1)))
            nearest = closest_points(from_before, mean * (1.0, 1.0, 0.0), template.faces[ball])
            ids.append(first + np.arange(5))
            faces.append(ball[nearest.faces])
            barycentrics.append(nearest.barycentrics)
    return LandmarkEmbedding(np.concatenate(ids), np.concatenate(faces), np.concatenate(barycentrics))
