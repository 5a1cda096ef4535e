"""The plain torch twins of samira_warp.kernels.shading, file for file."""
