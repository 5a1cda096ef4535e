"""A glTF 2.0 file with its numbers and pictures in one buffer, grown piece by piece."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from samira_warp import __version__

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
"""What a GPU does with numbers: attributes of vertices, or indices of them. From the specification, as are
the numbers below."""

_LINEAR, _LINEAR_MIPMAP_LINEAR, _CLAMP_TO_EDGE = 9729, 9987, 33071

_COMPONENTS = {np.dtype(np.float32): 5126, np.dtype(np.uint32): 5125, np.dtype(np.uint16): 5123}

_TYPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}


class GltfFile:
    """What is written so far.

    Attributes:
        document: The JSON part; what is added to its lists is known by its place in them.
    """

    def __init__(self) -> None:
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": f"samira-warp {__version__}"}
        }
        self._bytes = bytearray()

    def add(self, kind: str, **entry: Any) -> int:
        """Add an entry to one of the document's lists, such as "nodes"; its place there."""
        entries = self.document.setdefault(kind, [])
        entries.append({name: value for name, value in entry.items() if value is not None})
        return len(entries) - 1

    def numbers(self, values: np.ndarray, *, bounds: bool = False, target: int | None = None) -> int:
        """Add an accessor.

        Args:
            values: (N, ...) float32, uint32 or uint16; matrices by rows, as numpy has them.
            bounds: Say the least and the greatest of each component, as positions and times have to.
            target: What a GPU does with it, for attributes and indices of a mesh.

        Returns:
            Its place among the accessors.
        """
        stored = values.swapaxes(1, 2) if values.ndim == 3 else values
        low_high = {}
        if bounds:
            columns = values.reshape(len(values), -1)
            low_high = {"min": columns.min(axis=0).tolist(), "max": columns.max(axis=0).tolist()}
        return self.add(
            "accessors",
            bufferView=self._view(np.ascontiguousarray(stored).tobytes(), target),
            componentType=_COMPONENTS[values.dtype],
            count=len(values),
            type=_TYPES[values.shape[1:]],
            **low_high,
        )

    def texture(self, pixels: np.ndarray, *, name: str) -> int:
        """Add a texture of (H, W, 3) uint8 pixels, as a PNG, held at its borders; its place among them."""
        if "samplers" not in self.document:
            filters = {"magFilter": _LINEAR, "minFilter": _LINEAR_MIPMAP_LINEAR}
            self.add("samplers", wrapS=_CLAMP_TO_EDGE, wrapT=_CLAMP_TO_EDGE, **filters)
        png = io.BytesIO()
        Image.fromarray(pixels).save(png, "PNG")
        view = self._view(png.getvalue(), None)
        source = self.add("images", name=name, mimeType="image/png", bufferView=view)
        return self.add("textures", name=name, sampler=0, source=source)

    def write(self, path: Path) -> None:
        """Write it as a .glb, whatever ``path`` is called."""
        buffers = [{"byteLength": len(self._bytes)}]
        path.write_bytes(container(self.document | {"buffers": buffers}, bytes(self._bytes)))

    def _view(self, content: bytes, target: int | None) -> int:
        # every number lies on a multiple of its own size
        self._bytes.extend(bytes(-len(self._bytes) % 4))
        offset = len(self._bytes)
        self._bytes.extend(content)
        return self.add("bufferViews", buffer=0, byteOffset=offset, byteLength=len(content), target=target)


def container(document: dict[str, Any], binary: bytes) -> bytes:
    """A .glb of a document and its buffer: a header of 12 bytes and two chunks of a multiple of 4."""
    text = json.dumps(document, separators=(",", ":")).encode("utf-8")
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = [
        struct.pack("<I4s", len(text), b"JSON") + text,
        struct.pack("<I4s", len(binary), b"BIN\0") + binary,
    ]
    return struct.pack("<4sII", b"glTF", 2, 12 + sum(map(len, chunks))) + b"".join(chunks)
