"""Tracked poses on a template's joints: the one place where trackers' names meet a template's.

Trackers pose FLAME's five joints: the whole head about its root, neck, jaw and two eyes. A template's joints
take what has their name, its first one what turns the whole head. Joints of other names have theirs in the
npz formats under ``pose_<joint>``.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from samira_warp.head.joints import FLAME_JOINTS, ROOT, known_names
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of

FLAME_KEYS: Mapping[str, tuple[str, ...]] = {
    "rotation": (ROOT,),
    "neck_pose": ("neck",),
    "jaw_pose": ("jaw",),
    "eyes_pose": ("left_eye", "right_eye"),
}
"""The arrays of the npz formats by which VHAP poses FLAME's joints, three numbers a joint."""

OTHER_KEY = "pose_"
"""What precedes the name of any other joint in the npz formats."""


def pose_keys(arrays: Mapping[str, np.ndarray], template: HeadTemplate) -> dict[str, tuple[str, ...]]:
    """The arrays that hold poses, and the joints in each: what a template needs, and what is there."""
    joints = known_names(template.joint_names)
    keys = {
        key: names
        for key, names in FLAME_KEYS.items()
        if key in arrays or any(name in joints for name in names)
    }
    others = [name for name in joints if name not in FLAME_JOINTS]
    given = [key.removeprefix(OTHER_KEY) for key in arrays if key.startswith(OTHER_KEY)]
    others += [name for name in given if name not in (*others, *FLAME_JOINTS)]
    return keys | {f"{OTHER_KEY}{name}": (name,) for name in others}


def rotations_on(template: HeadTemplate, poses: Mapping[str, np.ndarray], *, place: object) -> np.ndarray:
    """(T, J, 3) axis-angle of a template's joints.

    Args:
        template: The head.
        poses: (T, 3) axis-angle of tracked joints by name; the one of the whole head is `ROOT`'s.
        place: Where they were read, for what is said about them.

    Raises:
        UserError: A joint of the template has no pose, or a joint turns that the template does not have:
            without it the head would be another one than was tracked.
    """
    joints = known_names(template.joint_names)
    all_of(*(partial(_check_used, place, name, pose) for name, pose in poses.items() if name not in joints))
    all_of(*(partial(_check_posed, place, name, poses) for name in joints))
    return np.stack([poses[name] for name in joints], axis=1)


def _check_used(place: object, name: str, pose: np.ndarray) -> None:
    if pose.any():
        most = float(np.linalg.norm(pose, axis=1).max())
        raise UserError(
            f"{place}: {name}",
            expected="no rotation of it, for the head template has no such joint",
            found=f"up to {most:.3g} radians",
        )


def _check_posed(place: object, name: str, poses: Mapping[str, np.ndarray]) -> None:
    if name not in poses:
        raise UserError(
            f"{place}: {name}",
            expected="a pose of each joint of the head template",
            found=f"only {', '.join(poses)}",
        )
