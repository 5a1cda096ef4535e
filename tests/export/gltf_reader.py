"""A .glb as another program understands it: pygltflib's reading, and glTF 2.0's own formulas in float64."""

import io

import numpy as np
import pygltflib
from PIL import Image

COMPONENTS = {5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Glb:
    def __init__(self, path):
        self.document = pygltflib.GLTF2().load_binary(str(path))
        self.blob = self.document.binary_blob()

    def view(self, number):
        view = self.document.bufferViews[number]
        start = view.byteOffset or 0
        return self.blob[start : start + view.byteLength]

    def numbers(self, number):
        """(N, width) of an accessor; matrices (N, 4, 4) by rows."""
        accessor = self.document.accessors[number]
        values = np.frombuffer(self.view(accessor.bufferView), COMPONENTS[accessor.componentType])
        values = values.reshape(accessor.count, WIDTHS[accessor.type])
        if accessor.min:
            np.testing.assert_array_equal(values.min(axis=0), np.float32(accessor.min))
            np.testing.assert_array_equal(values.max(axis=0), np.float32(accessor.max))
        # glTF's matrices go by columns
        return values.reshape(-1, 4, 4).swapaxes(1, 2) if accessor.type == "MAT4" else values

    @property
    def primitive(self):
        return self.document.meshes[0].primitives[0]

    def attribute(self, name):
        return self.numbers(getattr(self.primitive.attributes, name))

    def targets(self, name="POSITION"):
        """(K, M, 3) float32 morph targets."""
        return np.stack([self.numbers(target[name]) for target in self.primitive.targets])

    def texture(self, number):
        """(H, W, 3) uint8."""
        image = self.document.images[self.document.textures[number].source]
        return np.asarray(Image.open(io.BytesIO(self.view(image.bufferView))))

    def posed(self, key):
        """(M, 3) float64 vertices at a key of the animation: morph targets, then skinning (3.7.3)."""
        nodes = self.document.nodes
        moved = {(node, path): np.asarray(value) for node, path, value in self._channels(key)}
        parents = {child: above for above, node in enumerate(nodes) for child in node.children or ()}
        mesh_node = next(i for i, node in enumerate(nodes) if node.mesh is not None)
        weights = moved.get((mesh_node, "weights"), np.zeros(0)).astype(np.float64)
        points = self.attribute("POSITION").astype(np.float64)
        points = points + np.einsum("k,kmc->mc", weights, self.targets().astype(np.float64))
        skin = self.document.skins[0]
        inverse = self.numbers(skin.inverseBindMatrices).astype(np.float64)
        worlds = [self._world(joint, moved, parents) for joint in skin.joints]
        matrices = np.stack([world @ back for world, back in zip(worlds, inverse, strict=True)])
        ids, shares = self.attribute("JOINTS_0"), self.attribute("WEIGHTS_0").astype(np.float64)
        blended = np.einsum("mk,mkrc->mrc", shares, matrices[ids])
        return np.einsum("mrc,mc->mr", blended[:, :3, :3], points) + blended[:, :3, 3]

    def _channels(self, key):
        (animation,) = self.document.animations
        for channel in animation.channels:
            sampler = animation.samplers[channel.sampler]
            keys = self.document.accessors[sampler.input].count
            values = self.numbers(sampler.output).reshape(keys, -1)
            yield channel.target.node, channel.target.path, values[key]

    def _world(self, node, moved, parents):
        local = np.eye(4)
        x, y, z, w = moved[node, "rotation"].astype(np.float64)
        local[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        local[:3, 3] = moved[node, "translation"]
        above = parents.get(node)
        return local if above is None else self._world(above, moved, parents) @ local
