"""The plain torch twins of samira_warp.kernels.mesh, file for file."""
