"""Rasterising 3D Gaussians: projection, binning, blending, and their adjoints."""
