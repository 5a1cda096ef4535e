"""The parametric head: template, motion, regions and UV atlas."""

from samira_warp.head.atlas import UvAtlas
from samira_warp.head.flame import read_flame, read_head
from samira_warp.head.model import FrameParameters, HeadModel, PosedHead
from samira_warp.head.regions import REGIONS
from samira_warp.head.template import HeadTemplate, read_template, save_template

__all__ = [
    "REGIONS",
    "FrameParameters",
    "HeadModel",
    "HeadTemplate",
    "PosedHead",
    "UvAtlas",
    "read_flame",
    "read_head",
    "read_template",
    "save_template",
]
