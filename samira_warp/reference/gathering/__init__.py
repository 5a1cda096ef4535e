"""The plain torch twins of samira_warp.kernels.gathering, file for file."""
