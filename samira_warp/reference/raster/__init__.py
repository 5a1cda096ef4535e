"""The plain torch twins of samira_warp.kernels.raster, file for file."""
