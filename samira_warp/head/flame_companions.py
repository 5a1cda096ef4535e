"""What FLAME's own file lacks, found beside it: UV coordinates, regions, landmarks, eyelid shapes.

UV coordinates   head_template_mesh.obj, head_template.obj, flame_uv.npz, FLAME_texture.npz,
                 texture_data_{256,512,1024,2048}.npy: the first that is there and has them
regions          FLAME_masks.pkl
landmarks        mediapipe_landmark_embedding.npz; it may be absent
eyelids          l_eyelid.npy and r_eyelid.npy, also in a folder blendshapes; they may be absent
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from samira_warp.head.landmarks import EMBEDDING_FILE, LandmarkEmbedding, read_landmark_embedding
from samira_warp.head.template import load_arrays
from samira_warp.io.pickles import arrays_of, read_pickle, read_pickled_npy
from samira_warp.io.wavefront import read_mesh
from samira_warp.support.errors import UserError

UV_FILES = (
    "head_template_mesh.obj",
    "head_template.obj",
    "flame_uv.npz",
    "FLAME_texture.npz",
    *(f"texture_data_{size}.npy" for size in (256, 512, 1024, 2048)),
)
MASKS_FILE = "FLAME_masks.pkl"
EYELID_FILES = ("l_eyelid.npy", "r_eyelid.npy")


def read_uvs(folder: Path, *, vertices: int, faces: int) -> dict[str, np.ndarray]:
    """FLAME's UV coordinates: vt and ft, and f where the file orders the faces itself.

    Raises:
        UserError: No file of `UV_FILES` is in the folder with UV coordinates in it, or the one that is there
            is broken.
    """
    for name in UV_FILES:
        path = folder / name
        if not path.is_file():
            continue
        if path.suffix == ".obj":
            mesh = read_mesh(path)
            uvs = {"vt": mesh.uvs, "f": mesh.faces, "ft": mesh.uv_faces}
            return checked_uvs(path, uvs, vertices=vertices, faces=faces)
        if path.suffix == ".npy":
            return checked_uvs(
                path, arrays_of(path, read_pickled_npy(path), ("vt", "ft")), vertices=vertices, faces=faces
            )
        arrays = load_arrays(path)
        if "vt" in arrays and "ft" in arrays:
            return checked_uvs(path, {"vt": arrays["vt"], "ft": arrays["ft"]}, vertices=vertices, faces=faces)
    raise UserError(
        folder, expected=f"FLAME's UV coordinates in one of {', '.join(UV_FILES)}", found="none of them"
    )


def checked_uvs(
    path: Path, arrays: dict[str, np.ndarray], *, vertices: int, faces: int
) -> dict[str, np.ndarray]:
    """The arrays as they are, of the right shapes and within range.

    Raises:
        UserError: They are not.
    """
    vt = arrays["vt"]
    if vt.ndim != 2 or vt.shape[1] != 2 or vt.dtype.kind != "f" or not np.isfinite(vt).all():
        raise UserError(
            f"{path}: vt",
            expected="finite numbers of shape (any, 2)",
            found=f"{vt.dtype} of shape {vt.shape}",
        )
    if not len(vt):
        raise UserError(f"{path}: vt", expected="at least one pair of UV coordinates", found="none")
    for key in ("f", "ft"):
        if key in arrays and arrays[key].shape != (faces, 3):
            raise UserError(
                f"{path}: {key}",
                expected=f"the {faces} triangles of FLAME",
                found=f"shape {arrays[key].shape}",
            )
    check_ids(f"{path}: ft", arrays["ft"], len(vt))
    if "f" in arrays:
        check_ids(f"{path}: f", arrays["f"], vertices)
    return arrays


def check_ids(place: str, ids: np.ndarray, count: int) -> None:
    """Raise UserError unless ``ids`` are integers from 0 to ``count`` - 1."""
    fits = ids.dtype.kind in "iu" and (ids.size == 0 or (ids.min() >= 0 and ids.max() < count))
    if not fits:
        raise UserError(
            place,
            expected=f"integers from 0 to {count - 1}",
            found=f"{ids.dtype}" if ids.dtype.kind not in "iu" else "others",
        )


def read_masks(folder: Path, *, vertices: int) -> dict[str, np.ndarray]:
    """Vertex ids of FLAME's named regions, keyed mask_<region>.

    Raises:
        UserError: FLAME_masks.pkl is not in the folder, or holds something else.
    """
    path = folder / MASKS_FILE
    if not path.is_file():
        raise UserError(
            path, expected="FLAME's vertex masks (FLAME_masks.zip on its site)", found="no such file"
        )
    values = read_pickle(path)
    if not isinstance(values, dict) or not all(isinstance(name, str) for name in values):
        raise UserError(path, expected="a dictionary of vertex ids by region", found=type(values).__name__)
    masks = arrays_of(path, values, tuple(values))
    for name, ids in masks.items():
        check_ids(f"{path}: {ascii(name)[1:-1]}", ids, vertices)
    return {f"mask_{name}": ids.ravel() for name, ids in masks.items()}


def read_landmarks(folder: Path, own_faces: np.ndarray, faces: np.ndarray) -> LandmarkEmbedding | None:
    """The face mesh's points on FLAME; None where the file is not there.

    Args:
        folder: Where it may be.
        own_faces: (F, 3) FLAME's own faces, whose order the file means.
        faces: (at least F, 3) the same ones, in the order that the head has them.

    Raises:
        UserError: The file is broken.
    """
    path = folder / EMBEDDING_FILE
    if not path.is_file():
        return None
    own = read_landmark_embedding(path, faces=len(own_faces))
    if np.array_equal(own_faces, faces[: len(own_faces)]):
        return own
    of_corners = {tuple(sorted(face)): number for number, face in enumerate(faces.tolist())}
    found = np.array([of_corners[tuple(sorted(own_faces[face].tolist()))] for face in own.faces], np.int32)
    at = np.argmax(faces[found][:, :, None] == own_faces[own.faces][:, None, :], axis=2)
    return LandmarkEmbedding(own.ids, found, np.take_along_axis(own.barycentrics, at, axis=1))


def read_eyelids(folder: Path, *, vertices: int) -> np.ndarray | None:
    """(V, 3, 2) metres that a weight of 1 moves the left and the right lids.

    None where the files are not there.

    Raises:
        UserError: Only one of the two is there, or one has another shape.
    """
    for place in (folder, folder / "blendshapes"):
        paths = [place / name for name in EYELID_FILES]
        present = [path for path in paths if path.is_file()]
        if len(present) == 1:
            absent = next(path for path in paths if path not in present)
            raise UserError(
                absent, expected=f"the other eyelid beside {present[0].name}", found="no such file"
            )
        if present:
            return np.stack([_read_eyelid(path, vertices) for path in paths], axis=-1)
    return None


def _read_eyelid(path: Path, vertices: int) -> np.ndarray:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as fault:
        raise UserError(path, expected="an .npy file of numbers", found=fault) from fault
    if (
        not isinstance(array, np.ndarray)
        or array.shape != (vertices, 3)
        or array.dtype.kind != "f"
        or not np.isfinite(array).all()
    ):
        found = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else "an archive"
        raise UserError(path, expected=f"finite numbers of shape ({vertices}, 3)", found=found)
    return array
