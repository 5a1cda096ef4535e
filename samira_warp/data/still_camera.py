"""A still head before a moving camera becomes a moving head before a still camera.

Otherwise light would be glued to the head.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from samira_warp.head.template import HeadTemplate


def hold_camera(
    rotation: np.ndarray,
    translation: np.ndarray,
    world_to_camera: np.ndarray,
    camera: np.ndarray,
    *,
    template: HeadTemplate,
    shape: np.ndarray,
    expression: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Move the camera's motion into the head's.

    Each head is then seen by one camera that stands still as it was by its own. With world-to-camera
    transforms E_t, and E_0 of the one that stands still, the head moves by H_t = E_0^-1 E_t. Its root turns
    by R about the joint j and is then moved by T, so that x' = H (R (x - j) + j + T) is the turn H_R R about
    j, moved by H_R (j + T) + H_T - j.

    Args:
        rotation: (T, 3) axis-angle of the root joint.
        translation: (T, 3) metres.
        world_to_camera: (T, 4, 4) as tracked, metres.
        camera: (4, 4) world to camera, where it is held.
        template: The head, which places the root joint.
        shape: (n_shape,) identity coefficients.
        expression: (T, n_expression) coefficients: the root joint is regressed from the expression as well.

    Returns:
        rotation and translation, (T, 3) each, unchanged where the camera never moved.
    """
    if (world_to_camera == camera).all():
        return rotation, translation
    regressor = template.joint_regressor[0].astype(np.float64)
    members = np.flatnonzero(regressor)
    by_shape = np.einsum("v,vcs->cs", regressor[members], template.shapedirs[members])
    rest = regressor[members] @ template.v_template[members] + by_shape[:, : template.n_shape] @ shape
    joint = rest + expression @ by_shape[:, template.n_shape :].T
    motion = np.linalg.inv(camera) @ world_to_camera
    turn = Rotation.from_matrix(motion[:, :3, :3])
    return (turn * Rotation.from_rotvec(rotation)).as_rotvec(), turn.apply(joint + translation) + motion[
        :, :3, 3
    ] - joint
