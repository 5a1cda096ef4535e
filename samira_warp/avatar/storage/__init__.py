"""An avatar on disk: a folder without pickles that states its version, and readers for the older ones."""

from samira_warp.avatar.storage.description import find_avatar, read_record
from samira_warp.avatar.storage.folder import (
    TEMPLATE_FILE,
    StoredAvatar,
    naming_misfits,
    read_avatar,
    write_avatar,
)
from samira_warp.avatar.storage.frames import DrivingFrame, read_frames, write_frames
from samira_warp.avatar.storage.older import POSE_PARTS, joined_poses

__all__ = [
    "POSE_PARTS",
    "TEMPLATE_FILE",
    "DrivingFrame",
    "StoredAvatar",
    "find_avatar",
    "joined_poses",
    "naming_misfits",
    "read_avatar",
    "read_frames",
    "read_record",
    "write_avatar",
    "write_frames",
]
