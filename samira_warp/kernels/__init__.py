"""Warp kernels and the torch operators over them; nothing in here knows what a face is.

Each operator is differentiable where its docstring says so and has a hand-written adjoint without atomics; `samira_warp.reference` has the
same mathematics in plain torch.
"""

from samira_warp.kernels.barycentric import closest_barycentrics
from samira_warp.kernels.binding import BoundGaussians, FaceBinding, bind
from samira_warp.kernels.blending import Blended, blend
from samira_warp.kernels.cubemap_filter import irradiance, prefilter
from samira_warp.kernels.cubemap_lookup import sample_cubemap, sample_mips
from samira_warp.kernels.deferred_shading import shade_gbuffer
from samira_warp.kernels.gather import GatherTable, bilinear_table, gather
from samira_warp.kernels.projection import Projection, project
from samira_warp.kernels.rasterizer import Rasterized, rasterize
from samira_warp.kernels.tiles import TileBins, bin_tiles
from samira_warp.kernels.triangle_frames import MeshTopology, TriangleFrames, triangle_frames
from samira_warp.kernels.uv_raster import UvRaster, rasterize_uv
from samira_warp.kernels.visibility import visible

__all__ = [
    "Blended",
    "BoundGaussians",
    "FaceBinding",
    "GatherTable",
    "MeshTopology",
    "Projection",
    "Rasterized",
    "TileBins",
    "TriangleFrames",
    "UvRaster",
    "bilinear_table",
    "bin_tiles",
    "bind",
    "blend",
    "closest_barycentrics",
    "gather",
    "irradiance",
    "prefilter",
    "project",
    "rasterize",
    "rasterize_uv",
    "sample_cubemap",
    "sample_mips",
    "shade_gbuffer",
    "triangle_frames",
    "visible",
]
