"""A glTF 2.0 file with its numbers and pictures in one buffer, grown piece by piece."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
from PIL import Image

import samira_warp

ALIGNMENT = 4
"""Bytes: every number that is written lies on a multiple of its own size."""

_COMPONENTS = {
    np.dtype(np.float32): pygltflib.FLOAT,
    np.dtype(np.uint32): pygltflib.UNSIGNED_INT,
    np.dtype(np.uint16): pygltflib.UNSIGNED_SHORT,
}
_TYPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


class GltfFile:
    """What is written so far.

    Attributes:
        document: The JSON part; what is added to its lists is known by its place in them.
    """

    def __init__(self) -> None:
        self.document = pygltflib.GLTF2(
            asset=pygltflib.Asset(version="2.0", generator=f"samira_warp {samira_warp.__version__}")
        )
        self._bytes = bytearray()

    def numbers(self, values: np.ndarray, *, bounds: bool = False, target: int | None = None) -> int:
        """Add an accessor.

        Args:
            values: (N, ...) float32, uint32 or uint16; matrices by rows, as numpy has them.
            bounds: Say the least and the greatest of each component, as positions and times have to.
            target: What a GPU does with it, for attributes and indices of a mesh.

        Returns:
            Its index.
        """
        stored = values.swapaxes(1, 2) if values.ndim == 3 else values
        view = self._view(np.ascontiguousarray(stored).tobytes(), target)
        low_high: dict[str, Any] = {}
        if bounds:
            columns = values.reshape(len(values), -1)
            low_high = {"min": columns.min(axis=0).tolist(), "max": columns.max(axis=0).tolist()}
        accessor = pygltflib.Accessor(
            bufferView=view,
            componentType=_COMPONENTS[values.dtype],
            count=len(values),
            type=_TYPES[values.shape[1:]],
            **low_high,
        )
        return _added(self.document.accessors, accessor)

    def texture(self, pixels: np.ndarray, *, name: str) -> int:
        """Add a texture of (H, W, 3) uint8 pixels, as a PNG, held at its borders; its index."""
        if not self.document.samplers:
            edge = pygltflib.CLAMP_TO_EDGE
            filters = {"magFilter": pygltflib.LINEAR, "minFilter": pygltflib.LINEAR_MIPMAP_LINEAR}
            self.document.samplers.append(pygltflib.Sampler(wrapS=edge, wrapT=edge, **filters))
        png = io.BytesIO()
        Image.fromarray(pixels).save(png, "PNG")
        image = pygltflib.Image(name=name, mimeType="image/png", bufferView=self._view(png.getvalue(), None))
        source = _added(self.document.images, image)
        return _added(self.document.textures, pygltflib.Texture(name=name, sampler=0, source=source))

    def write(self, path: Path) -> None:
        """Write it as a .glb, whatever ``path`` is called."""
        self.document.buffers = [pygltflib.Buffer(byteLength=len(self._bytes))]
        self.document.set_binary_blob(bytes(self._bytes))
        path.write_bytes(b"".join(self.document.save_to_bytes()))

    def _view(self, content: bytes, target: int | None) -> int:
        self._bytes.extend(bytes(-len(self._bytes) % ALIGNMENT))
        view = pygltflib.BufferView(
            buffer=0, byteOffset=len(self._bytes), byteLength=len(content), target=target
        )
        self._bytes.extend(content)
        return _added(self.document.bufferViews, view)


def _added(entries: list[Any], entry: Any) -> int:
    entries.append(entry)
    return len(entries) - 1
