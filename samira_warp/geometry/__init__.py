"""Cameras, rotations and meshes in plain torch; nothing in here knows what a face is."""
