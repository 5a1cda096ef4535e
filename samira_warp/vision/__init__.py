"""What pretrained networks see in pictures: faces, irises, mattes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.vision.cuts import find_cuts, longest_continuous
    from samira_warp.vision.faces import FaceTrack, follow_faces
    from samira_warp.vision.networks import FaceNetworks

__all__ = [
    "FaceNetworks",
    "FaceTrack",
    "find_cuts",
    "follow_faces",
    "longest_continuous",
]

__getattr__ = lazily(
    __name__,
    {
        "FaceNetworks": "networks",
        "FaceTrack": "faces",
        "find_cuts": "cuts",
        "follow_faces": "faces",
        "longest_continuous": "cuts",
    },
)
