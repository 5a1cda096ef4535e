"""Paint: what a surface is made of, texel by texel, and how one layer covers another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Paint:
    """A surface.

    Attributes:
        albedo: (N, 3) linear diffuse reflectance.
        roughness: (N,) perceptual.
        specular: (N,) reflectance at normal incidence.
        scatter: (N,) 0 for opaque, 1 for skin.
    """

    albedo: np.ndarray
    roughness: np.ndarray
    specular: np.ndarray
    scatter: np.ndarray

    @classmethod
    def plain(cls, albedo: np.ndarray, *, roughness: float, specular: float, scatter: float) -> Paint:
        """One finish under (N, 3) colours."""
        count = len(albedo)
        return cls(albedo, np.full(count, roughness), np.full(count, specular), np.full(count, scatter))

    def under(self, other: Paint, share: np.ndarray) -> Paint:
        """This surface with another over (N,) shares of it."""
        return Paint(
            albedo=mix(self.albedo, other.albedo, share[:, None]),
            roughness=mix(self.roughness, other.roughness, share),
            specular=mix(self.specular, other.specular, share),
            scatter=mix(self.scatter, other.scatter, share),
        )

    def tinted(self, factors: np.ndarray) -> Paint:
        """This surface with its colour multiplied by (N, 3) factors."""
        return Paint(self.albedo * factors, self.roughness, self.specular, self.scatter)


def mix(below: np.ndarray, above: np.ndarray, share: np.ndarray) -> np.ndarray:
    """``share`` of one value over the rest of another."""
    return below + share * (above - below)
