"""Cubemaps: layout, filters, and lookups, each with its adjoint."""
