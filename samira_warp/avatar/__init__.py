"""The avatar and its parts."""

from samira_warp.avatar.avatar import Avatar, Motion, Rendering, conditions_of
from samira_warp.avatar.canonical import CanonicalHead
from samira_warp.avatar.editing import MaterialEdit
from samira_warp.avatar.gaussians import Gaussians
from samira_warp.avatar.gbuffer import GBuffer
from samira_warp.avatar.settings import AvatarSettings
from samira_warp.avatar.storage import DrivingFrame, read_frames, write_frames
from samira_warp.avatar.uv_sampling import geometry_uv

__all__ = [
    "Avatar",
    "AvatarSettings",
    "CanonicalHead",
    "DrivingFrame",
    "GBuffer",
    "Gaussians",
    "MaterialEdit",
    "Motion",
    "Rendering",
    "conditions_of",
    "geometry_uv",
    "read_frames",
    "write_frames",
]
