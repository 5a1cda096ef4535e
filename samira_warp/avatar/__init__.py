"""The avatar and its parts."""

from samira_warp.avatar.avatar import Avatar as Avatar  # public as samira_warp.Avatar
from samira_warp.avatar.avatar import Motion, Rendering, conditions_of
from samira_warp.avatar.canonical import CanonicalHead
from samira_warp.avatar.driving import Driver, NameMap, PoseRange, match_expressions, match_joints
from samira_warp.avatar.editing import MaterialEdit as MaterialEdit  # public as samira_warp.MaterialEdit
from samira_warp.avatar.gaussians import Gaussians
from samira_warp.avatar.gbuffer import GBuffer
from samira_warp.avatar.occlusion import Occluder, Occlusion
from samira_warp.avatar.settings import AvatarSettings
from samira_warp.avatar.storage import DrivingFrame, write_frames
from samira_warp.avatar.storage import read_frames as read_frames  # public as samira_warp.read_frames
from samira_warp.avatar.uv_sampling import geometry_uv

__all__ = [
    "AvatarSettings",
    "CanonicalHead",
    "Driver",
    "DrivingFrame",
    "GBuffer",
    "Gaussians",
    "Motion",
    "NameMap",
    "Occluder",
    "Occlusion",
    "PoseRange",
    "Rendering",
    "conditions_of",
    "geometry_uv",
    "match_expressions",
    "match_joints",
    "write_frames",
]
