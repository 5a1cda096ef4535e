"""What pretrained networks see in pictures: faces, irises, mattes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.vision.cuts import find_cuts, longest_continuous
    from samira_warp.vision.faces import FaceTrack, follow_faces
    from samira_warp.vision.networks import FaceNetworks
    from samira_warp.vision.openness import Openness, read_openness

__all__ = [
    "FaceNetworks",
    "FaceTrack",
    "Openness",
    "find_cuts",
    "follow_faces",
    "longest_continuous",
    "read_openness",
]

__getattr__ = lazily(
    __name__,
    {
        "FaceNetworks": "networks",
        "FaceTrack": "faces",
        "Openness": "openness",
        "find_cuts": "cuts",
        "follow_faces": "faces",
        "longest_continuous": "cuts",
        "read_openness": "openness",
    },
)
