"""The networks that look at faces, each with the values that it wants its pictures to have."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from samira_warp.vision.runtime import Network
from samira_warp.vision.weights import FACE_DETECTOR, FACE_MESH, IRIS, NetworkFile, read_network

VALUE_RANGES = {FACE_DETECTOR: (-1.0, 1.0), FACE_MESH: (0.0, 1.0), IRIS: (0.0, 1.0)}
"""What black and white are to each network. Nothing that comes out tells a wrong range: the detector's and
the mesh's scores stay, and the points of the mesh move by 0.5 to 1.3 of its 192 pixels, an iris by 1 to 3 %
of the eye's width."""


@dataclass(frozen=True)
class FaceNetworks:
    """What `samira_warp.vision.faces.follow_faces` runs.

    Attributes:
        detector: Finds faces.
        mesh: Reads 468 points of one.
        iris: Reads an eye.
    """

    detector: Network
    mesh: Network
    iris: Network

    @staticmethod
    def load(models: Path | None = None, *, threads: int = 1) -> FaceNetworks:
        """Load the three, fetching them on first use.

        Args:
            models: A folder with their files or wheels; None for the cache.
            threads: How many run each.

        Raises:
            UserError: They cannot be had or run; the message says what to install or to copy where.
        """
        return FaceNetworks(*(_load(file, models, threads) for file in (FACE_DETECTOR, FACE_MESH, IRIS)))


def _load(file: NetworkFile, models: Path | None, threads: int) -> Network:
    content = read_network(file, models)
    return Network(content, name=file.name, value_range=VALUE_RANGES[file], threads=threads)
