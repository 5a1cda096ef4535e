"""Deferred shading of a G-buffer, with its adjoint."""
