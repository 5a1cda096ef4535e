"""Embree, where embreex is installed, at the rays of `samira_warp.bench.visibility`."""

from __future__ import annotations

import importlib.util

import torch
from torch import Tensor

from samira_warp.bench.timing import least_ms

REPEATS = 5


def embree_ms(vertices: Tensor, faces: Tensor, origins: Tensor, directions: Tensor) -> float | None:
    """Milliseconds of Embree's occlusion query on one thread, ray by ray; None where embreex is absent.

    Args:
        vertices: (V, 3) float32.
        faces: (F, 3) integer vertex ids.
        origins: (R, 3) float32.
        directions: (R, 3) float32.
    """
    if importlib.util.find_spec("embreex") is None:
        return None
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    mesh = TriangleMesh(scene, vertices[faces.long()].numpy())
    rays = origins.numpy(), directions.numpy()
    spent = least_ms(lambda: scene.run(*rays, query="OCCLUDED"), torch.device("cpu"), repeats=REPEATS)
    # the scene reads the mesh's memory
    del mesh
    return spent
