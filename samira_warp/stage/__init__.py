"""What stands round an avatar when it is looked at, whoever looks.

Lights, cameras, background, turntable and sheets of pictures, free of any one command.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from samira_warp.support.lazy import lazily

if TYPE_CHECKING:
    from samira_warp.stage.background import Background
    from samira_warp.stage.layers import LayerImage, layer_image
    from samira_warp.stage.lights import read_light
    from samira_warp.stage.scene import PosedView, Scene, SceneLight
    from samira_warp.stage.sheet import contact_sheet
    from samira_warp.stage.turntable import Picture, Shot, plan_shots
    from samira_warp.stage.video import VideoWriter
    from samira_warp.stage.viewpoint import HeadPlace, Orbit, Viewpoint

__all__ = [
    "Background",
    "HeadPlace",
    "LayerImage",
    "Orbit",
    "Picture",
    "PosedView",
    "Scene",
    "SceneLight",
    "Shot",
    "VideoWriter",
    "Viewpoint",
    "contact_sheet",
    "layer_image",
    "plan_shots",
    "read_light",
]

__getattr__ = lazily(
    __name__,
    {
        "Background": "background",
        "LayerImage": "layers",
        "layer_image": "layers",
        "read_light": "lights",
        "PosedView": "scene",
        "Scene": "scene",
        "SceneLight": "scene",
        "contact_sheet": "sheet",
        "Picture": "turntable",
        "Shot": "turntable",
        "plan_shots": "turntable",
        "VideoWriter": "video",
        "HeadPlace": "viewpoint",
        "Orbit": "viewpoint",
        "Viewpoint": "viewpoint",
    },
)
