"""The parametric head: template, motion, regions and UV atlas."""

from samira_warp.head.atlas import UvAtlas
from samira_warp.head.flame import read_flame
from samira_warp.head.joints import FLAME_JOINTS
from samira_warp.head.landmarks import LandmarkEmbedding
from samira_warp.head.models import read_head
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.regions import REGIONS
from samira_warp.head.rig import HeadModel, PosedHead, Rig
from samira_warp.head.template import HeadTemplate, read_template, save_template

__all__ = [
    "FLAME_JOINTS",
    "REGIONS",
    "FrameParameters",
    "HeadModel",
    "HeadTemplate",
    "LandmarkEmbedding",
    "PosedHead",
    "Rig",
    "UvAtlas",
    "read_flame",
    "read_head",
    "read_template",
    "save_template",
]
