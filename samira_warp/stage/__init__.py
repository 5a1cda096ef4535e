"""What stands round an avatar when it is looked at, whoever looks.

Lights, background, turntable and sheets of pictures, free of any one command.
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
    from samira_warp.stage.turntable import Shot, plan_shots
    from samira_warp.stage.video import VideoWriter

__all__ = [
    "Background",
    "LayerImage",
    "PosedView",
    "Scene",
    "SceneLight",
    "Shot",
    "VideoWriter",
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
        "Shot": "turntable",
        "plan_shots": "turntable",
        "VideoWriter": "video",
    },
)
