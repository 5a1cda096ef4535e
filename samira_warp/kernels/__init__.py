"""Warp kernels and the torch operators over them; nothing in here knows what a face is.

Each operator is differentiable where its docstring says so and has a hand-written adjoint without atomics;
`samira_warp.reference` has the same mathematics in plain torch.
"""

from samira_warp.kernels.cubemap.filter import irradiance, prefilter
from samira_warp.kernels.cubemap.lookup import sample_cubemap, sample_mips
from samira_warp.kernels.gathering.gather import GatherTable, bilinear_table, gather
from samira_warp.kernels.mesh.antialias import antialias
from samira_warp.kernels.mesh.barycentric import closest_barycentrics
from samira_warp.kernels.mesh.binding import BoundGaussians, FaceBinding, bind
from samira_warp.kernels.mesh.interpolate import interpolate
from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.mesh_raster import MeshRaster, rasterize_mesh
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.kernels.mesh.triangle_frames import TriangleFrames, triangle_frames
from samira_warp.kernels.mesh.uv_raster import UvRaster, rasterize_uv
from samira_warp.kernels.raster.blending import Blended, blend
from samira_warp.kernels.raster.projection import Projection, project
from samira_warp.kernels.raster.rasterizer import Rasterized, rasterize
from samira_warp.kernels.raster.tiles import TileBins, bin_tiles
from samira_warp.kernels.rays.occlusion import unblocked
from samira_warp.kernels.rays.ray_mesh import RayMesh
from samira_warp.kernels.rays.visibility import visible
from samira_warp.kernels.shading.deferred import shade_gbuffer

__all__ = [
    "Blended",
    "BoundGaussians",
    "FaceBinding",
    "GatherTable",
    "MeshRaster",
    "MeshTopology",
    "Projection",
    "Rasterized",
    "RayMesh",
    "TileBins",
    "TriangleFrames",
    "UvRaster",
    "antialias",
    "bilinear_table",
    "bin_tiles",
    "bind",
    "blend",
    "closest_barycentrics",
    "gather",
    "interpolate",
    "irradiance",
    "mesh_normals",
    "prefilter",
    "project",
    "rasterize",
    "rasterize_mesh",
    "rasterize_uv",
    "sample_cubemap",
    "sample_mips",
    "shade_gbuffer",
    "triangle_frames",
    "unblocked",
    "visible",
]
