"""FLAME's files in their exact layout with made-up content: none of the real ones can be had without a
licence."""

import pickle
import sys
import types

import numpy as np
import scipy.sparse

from samira_warp.head.flame import FLAME_FACES, FLAME_IDENTITY, FLAME_VERTICES
from samira_warp.head.teeth import LOWER_LIP, UPPER_LIP

N_EXPRESSION = 100
UVS = 5118
MASK_SIZES = {
    "face": 1787, "eye_region": 751, "left_ear": 588, "right_ear": 588, "left_eye_region": 287,
    "right_eye_region": 287, "forehead": 133, "right_eyeball": 546, "left_eyeball": 546, "scalp": 489,
    "nose": 379, "lips": 254, "neck": 253, "boundary": 114,
}  # fmt: skip


def flame_arrays(seed=0):
    """FLAME's keys: points on an ellipsoid as large as a head, with the lips where a mouth is and small
    smooth shapes."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(FLAME_VERTICES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    vertices = directions * [0.075, 0.11, 0.09]
    across = np.linspace(0.025, -0.025, len(UPPER_LIP))
    for ring, height in ((UPPER_LIP, -0.035), (LOWER_LIP, -0.043)):
        vertices[list(ring)] = np.stack([across, np.full(len(ring), height), 0.085 - 10 * across**2], axis=1)
    shapes = (
        0.002
        * rng.normal(size=(3, 3, FLAME_IDENTITY + N_EXPRESSION))
        * 0.98 ** np.arange(FLAME_IDENTITY + N_EXPRESSION)
    )
    weights = rng.random((FLAME_VERTICES, 5)) ** 4
    regressor = np.zeros((5, FLAME_VERTICES))
    for joint, centre in enumerate(
        ((0, -0.1, 0), (0, -0.07, 0), (0, -0.03, 0.03), (0.03, 0.02, 0.06), (-0.03, 0.02, 0.06))
    ):
        near = np.argsort(np.linalg.norm(vertices - centre, axis=1))[:20]
        regressor[joint, near] = 1 / 20
    return {
        "v_template": vertices,
        "shapedirs": np.einsum("vi,ijk->vjk", directions, shapes).astype(np.float32),
        "posedirs": 1e-4 * rng.normal(size=(FLAME_VERTICES, 3, 36)),
        "J_regressor": scipy.sparse.csc_matrix(regressor),
        "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], [0, 1, 2, 3, 4]], np.uint32),
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "f": rng.integers(0, FLAME_VERTICES, (FLAME_FACES, 3)).astype(np.uint32),
        "bs_style": "lbs",
        "bs_type": "lrotmin",
        "J": regressor @ vertices,
    }


def flame_uvs(seed=1):
    rng = np.random.default_rng(seed)
    return rng.random((UVS, 2)) * 0.9, rng.integers(0, UVS, (FLAME_FACES, 3))


def flame_masks(seed=2):
    rng = np.random.default_rng(seed)
    return {name: np.sort(rng.permutation(FLAME_VERTICES)[:size]) for name, size in MASK_SIZES.items()}


class _Chumpy:
    """What chumpy's pickles look like: a Python 2 class named chumpy.ch.Ch with the array under x."""

    def __init__(self, x):
        self.__dict__ = {"x": x, "_dirty_vars": {"x"}, "_itr": None, "_depends_on_deps": {}}


_Chumpy.__module__, _Chumpy.__qualname__ = "chumpy.ch", "Ch"


def pickle_flame(path, arrays, *, protocol=2):
    """Write a FLAME pickle whose shapes and template are chumpy's, as FLAME 2020's are, with names as a numpy
    of that time gave them."""
    content = {
        **arrays,
        "shapedirs": _Chumpy(arrays["shapedirs"]),
        "v_template": _Chumpy(arrays["v_template"]),
    }
    modules = {name: types.ModuleType(name) for name in ("chumpy", "chumpy.ch")}
    modules["chumpy.ch"].Ch = _Chumpy
    before = {name: sys.modules.get(name) for name in modules}
    sys.modules.update(modules)
    try:
        written = pickle.dumps(content, protocol)
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
    old = {
        b"cnumpy._core.multiarray\n": b"cnumpy.core.multiarray\n",
        b"cscipy.sparse._csc\n": b"cscipy.sparse.csc\n",
    }
    for ours, theirs in old.items():
        written = written.replace(ours, theirs)
    path.write_bytes(written)


def write_companions(folder, *, eyelids=False, uvs="flame_uv.npz"):
    """FLAME_masks.pkl and one file of UV coordinates, and the eyelids if asked for."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "FLAME_masks.pkl").write_bytes(pickle.dumps(flame_masks(), 2))
    vt, ft = flame_uvs()
    if uvs.endswith(".npz"):
        np.savez(folder / uvs, vt=vt, ft=ft)
    elif uvs.endswith(".npy"):
        np.save(folder / uvs, {"vt": vt, "ft": ft, "x_coords": np.zeros(4), "valid_pixel_ids": np.arange(4)})
    else:
        faces = flame_arrays()["f"]
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in flame_arrays()["v_template"]]
        lines += [f"vt {u:.9g} {v:.9g}" for u, v in vt]
        lines += [
            " ".join(["f", *(f"{a + 1}/{b + 1}" for a, b in zip(face, uv, strict=True))])
            for face, uv in zip(faces, ft, strict=True)
        ]
        (folder / uvs).write_text("\n".join(["# a comment", *lines]))
    if eyelids:
        for seed, name in ((5, "l_eyelid.npy"), (6, "r_eyelid.npy")):
            shape = np.zeros((FLAME_VERTICES, 3), np.float32)
            shape[np.random.default_rng(seed).integers(0, FLAME_VERTICES, 50)] = [0, -0.005, 0.001]
            np.save(folder / name, shape)


def write_flame(folder, *, name="flame2023.pkl", arrays=None, **companions):
    """FLAME as one downloads it, with what belongs beside it; the path to give as --flame."""
    write_companions(folder, **companions)
    arrays = arrays or flame_arrays()
    if name.endswith(".npz"):
        dense = {key: value.toarray() if key == "J_regressor" else value for key, value in arrays.items()}
        np.savez(folder / name, **dense)
    else:
        pickle_flame(folder / name, arrays)
    return folder / name
