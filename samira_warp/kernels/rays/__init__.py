"""Rays against a mesh."""
