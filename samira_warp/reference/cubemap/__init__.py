"""The plain torch twins of samira_warp.kernels.cubemap, file for file."""
