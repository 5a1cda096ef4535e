"""Where torch meets Warp: launches, threads and streams."""

from samira_warp.kernels.runtime.launch import launch, launch_range, stream_of, warp_array

__all__ = ["launch", "launch_range", "stream_of", "warp_array"]
