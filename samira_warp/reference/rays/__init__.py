"""The plain torch twins of samira_warp.kernels.rays, file for file."""
