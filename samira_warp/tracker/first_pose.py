"""A first pose of every frame: the mean head moved onto the landmarks as a rigid body."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from samira_warp.tracker.observed import DISTANCE, Landmarks, View
from samira_warp.tracker.unknowns import Layout, Unknowns


def first_pose(
    layout: Layout, rest: Tensor, root: Tensor, landmarks: Landmarks, view: View, *, focal: float
) -> tuple[Unknowns, Tensor]:
    """Place the head in each frame by a similarity of landmarks and rest points (Umeyama 1991).

    A landmark's depth is as rough as it is, but the same way in all frames; frames without landmarks are
    interpolated between those that have some.

    Args:
        layout: What the fit solves for.
        rest: (L, 3) the landmarks' points on the head at rest, metres.
        root: (3,) the root joint at rest.
        landmarks: Where they are seen.
        view: The camera.
        focal: Focal length, pixels.

    Returns:
        The state, and (N,) how many pixels a metre of the head has in each frame.
    """
    unknowns = Unknowns.at_rest(layout, frames=len(landmarks.points), focal=focal)
    flip = np.array([1.0, -1.0, -1.0])
    seen = np.flatnonzero((landmarks.seen.sum(dim=1) > 0).numpy())
    points = np.concatenate([landmarks.points.numpy(), landmarks.depths.numpy()[..., None]], axis=-1)
    turns = np.zeros((len(points), 3))
    shifts, scales = np.zeros((len(points), 3)), np.zeros(len(points))
    source = rest.double().numpy() - root.double().numpy()
    for frame in seen:
        turn, scale, at = _similarity(
            source, points[frame].astype(np.float64) * flip, landmarks.seen[frame].numpy()
        )
        turns[frame], scales[frame] = turn.as_rotvec(), scale
        depth = focal / scale
        x, y = (at[0] - view.cx) * depth / focal, (at[1] + view.cy) * depth / focal
        shifts[frame] = np.array([x, y, DISTANCE - depth]) - root.double().numpy()
    every = np.arange(len(points))
    columns = np.concatenate([shifts, turns, scales[:, None]], axis=1)[seen]
    filled = np.stack([np.interp(every, seen, column) for column in columns.T], axis=1)
    unknowns.frames[:, layout.translation] = torch.from_numpy(filled[:, :3])
    unknowns.frames[:, layout.turn(0)] = torch.from_numpy(filled[:, 3:6])
    return unknowns, torch.from_numpy(filled[:, 6]).float()


def _similarity(
    source: np.ndarray, target: np.ndarray, weights: np.ndarray
) -> tuple[Rotation, float, np.ndarray]:
    """Turn, scale and place of the source's origin that take (L, 3) points onto others."""
    weights = weights / weights.sum()
    source_mean, target_mean = weights @ source, weights @ target
    centred, aimed = source - source_mean, target - target_mean
    turn, _ = Rotation.align_vectors(aimed, centred, weights=weights)
    turned = turn.apply(centred)
    scale = float((weights @ (turned * aimed).sum(axis=1)) / (weights @ (turned**2).sum(axis=1)))
    return turn, scale, target_mean - scale * turn.apply(source_mean)
