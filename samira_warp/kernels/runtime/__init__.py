"""Where torch meets Warp: launches, threads and streams."""

from samira_warp.kernels.runtime.launch import launch, launch_range, warp_array
from samira_warp.kernels.runtime.streams import stream_of

__all__ = ["launch", "launch_range", "stream_of", "warp_array"]
