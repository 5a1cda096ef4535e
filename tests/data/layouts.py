"""The layouts in which other projects keep a tracked film, written from any subject: what their own tools
would have written.

Each writer takes a `Film` in metres with OpenCV axes and a folder, and gives the options with which the
folder is opened.
"""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from scipy.spatial.transform import Rotation

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass
class Film:
    """T frames of one head; rotations are axis-angles."""

    shape: np.ndarray
    expression: np.ndarray
    rotation: np.ndarray
    neck: np.ndarray
    jaw: np.ndarray
    eyes: np.ndarray
    translation: np.ndarray
    world_to_camera: np.ndarray
    focal: np.ndarray  # (T, 2) pixels
    center: np.ndarray  # (T, 2) pixels
    width: int
    height: int
    eyelids: np.ndarray | None = None
    static_offset: np.ndarray | None = None
    names: list = field(default_factory=list)
    pictures: np.ndarray | None = (
        None  # (T, height, width, 4) uint8 on white, with coverage; None draws discs
    )
    albedo: np.ndarray | None = None  # (T, height, width, 3) uint8

    def __len__(self):
        return len(self.expression)


def make_film(
    *,
    frames=6,
    n_shape=2,
    n_expression=4,
    width=40,
    height=32,
    seed=0,
    moving_camera=False,
    still_head=False,
    square_pixels=False,
):
    """A head that turns, speaks and looks about before a camera at one metre, which moves as well if asked
    for."""
    rng = np.random.default_rng(seed)
    focal = 2.8 * width * (1 + 0.05 * rng.random((frames, 2)) * (not square_pixels))
    poses = np.tile(FLIP, (frames, 1, 1))
    poses[:, :3, 3] = [0.0, 0.0, 1.0]
    if moving_camera:
        poses[:, :3, :3] = (
            Rotation.from_rotvec(0.3 * rng.normal(size=(frames, 3))) * Rotation.from_matrix(FLIP[:3, :3])
        ).as_matrix()
        poses[:, :3, 3] += 0.03 * rng.normal(size=(frames, 3))
    moves = 0.0 if still_head else 1.0
    return Film(
        shape=rng.normal(size=n_shape),
        expression=0.5 * rng.normal(size=(frames, n_expression)),
        rotation=moves * 0.3 * rng.normal(size=(frames, 3)),
        neck=moves * 0.1 * rng.normal(size=(frames, 3)),
        jaw=np.abs(rng.normal(size=(frames, 3))) * [0.2, 0.02, 0.02],
        eyes=0.1 * rng.normal(size=(frames, 6)),
        translation=moves * 0.02 * rng.normal(size=(frames, 3)),
        world_to_camera=poses,
        focal=focal[:, :1].repeat(2, axis=1) if square_pixels else focal,
        center=np.array([width, height]) * (0.5 + 0.02 * rng.normal(size=(frames, 2)) * (not square_pixels)),
        width=width,
        height=height,
        names=[f"{index:05d}" for index in range(frames)],
    )


def joint_rotations(film, row):
    """(5, 3) rotations of FLAME's joints in its order."""
    return np.stack([film.rotation[row], film.neck[row], film.jaw[row], *np.split(film.eyes[row], 2)])


def fixed_intrinsics(film, *, centred=False):
    """The film with the first frame's intrinsics in all frames, as the formats need that state them once."""
    film.focal[:] = film.focal[0]
    film.center[:] = film.center[0]
    if centred:
        film.focal[:] = film.focal[0, 0]
        film.center[:] = np.array([film.width, film.height]) / 2
    return film


def picture(film, row, *, alpha=False):
    """The film's own, or pixels that tell the frame by their colour: a disc on a grey scene, whose coverage
    is a soft ramp."""
    if film.pictures is not None:
        rgb, coverage = film.pictures[row, :, :, :3], film.pictures[row, :, :, 3]
        return (np.dstack([_off_white(rgb, coverage), coverage]) if alpha else rgb), coverage
    y, x = np.mgrid[0 : film.height, 0 : film.width] + 0.5
    distance = np.hypot(x - film.width / 2, y - film.height / 2) / (0.3 * film.height)
    mask = np.clip(4 * (1.1 - distance), 0, 1)
    colour = np.full((film.height, film.width, 3), 128.0)
    colour[distance < 1.2] = [40 + 20 * row, 200 - 20 * row, 90]
    rgb = np.rint(colour).astype(np.uint8)
    coverage = np.rint(255 * mask).astype(np.uint8)
    return (np.dstack([rgb, coverage]) if alpha else rgb), coverage


def _off_white(rgb, coverage):
    """The colour that comes to ``rgb`` when it is laid on white."""
    share = coverage[..., None] / 255.0
    return np.rint(255.0 - (255.0 - rgb) / np.maximum(share, 1 / 255)).clip(0, 255).astype(np.uint8)


def write_pictures(film, folder, *, suffix=".png", masks=None, mask_suffix=".png", alpha=False):
    """Pictures named by the frames, and their masks in another folder."""
    folder.mkdir(parents=True)
    if masks is not None:
        masks.mkdir(parents=True)
    for row, name in enumerate(film.names):
        rgb, coverage = picture(film, row, alpha=alpha)
        exact = {"quality": 95, "subsampling": 0} if suffix.lower() in (".jpg", ".jpeg") else {}
        Image.fromarray(rgb).save(folder / f"{name}{suffix}", **exact)
        if masks is not None:
            Image.fromarray(coverage).save(
                masks / f"{name}{mask_suffix}", **({"quality": 95} if mask_suffix == ".jpg" else {})
            )


def write_vhap_tracked(film, root, *, suffix=".jpg", epoch=30, named=True):
    """VHAP's npz beside the raw pictures; its one camera is at (0, 0, 1)."""
    write_pictures(film, root / "images", suffix=suffix, masks=root / "alpha_maps", mask_suffix=".jpg")
    arrays = {
        "rotation": film.rotation, "neck_pose": film.neck, "jaw_pose": film.jaw, "eyes_pose": film.eyes,
        "translation": film.translation,
        "expr": film.expression, "shape": film.shape, "n_processed_frames": 0, "lights": np.zeros((9, 3)),
        "focal_length": film.focal[:1, 0] / max(film.width, film.height),
        "image_size": np.array([film.height, film.width]),
    }  # fmt: skip
    if named:
        arrays["timestep_id"] = np.array(film.names)
    if film.static_offset is not None:
        arrays["static_offset"] = film.static_offset[None]
    floats = {
        key: np.asarray(value, np.float32) if np.asarray(value).dtype.kind == "f" else value
        for key, value in arrays.items()
    }
    np.savez(root / f"tracked_flame_params_{epoch}.npz", **floats)


def write_metrical_tracker(film, root, *, folder="images", suffix=".png", transforms=False):
    """Checkpoints of every frame: the head stands still, and turns are the first two rows of their
    matrices."""
    assert not film.rotation.any()
    assert not film.neck.any()
    assert not film.translation.any()
    write_pictures(film, root / folder, suffix=suffix, alpha=suffix in (".png", ".webp"))
    (root / "checkpoint").mkdir()

    def six(axis_angle):
        return Rotation.from_rotvec(axis_angle).as_matrix()[:2].reshape(1, 6).astype(np.float32)

    for row, name in enumerate(film.names):
        matrix = np.eye(3)
        matrix[[0, 1], [0, 1]], matrix[:2, 2] = film.focal[row], film.center[row]
        flame = {
            "exp": film.expression[row][None].astype(np.float32),
            "shape": film.shape[None].astype(np.float32),
            "tex": np.zeros((1, 140), np.float32),
            "sh": np.zeros((1, 9, 3), np.float32),
            "eyes": np.concatenate([six(film.eyes[row, :3]), six(film.eyes[row, 3:])], axis=1),
            "eyelids": (np.zeros(2) if film.eyelids is None else film.eyelids[row])[None].astype(np.float32),
            "jaw": six(film.jaw[row]),
        }
        pose = film.world_to_camera[row].astype(np.float32)
        opencv = {"R": pose[None, :3, :3], "t": pose[None, :3, 3], "K": matrix[None].astype(np.float32)}
        camera = {
            "R": np.zeros((1, 6), np.float32),
            "t": np.zeros((1, 3), np.float32),
            "fl": np.ones((1, 1)),
            "pp": np.zeros((1, 2)),
        }
        payload = {
            "flame": flame, "camera": camera, "opencv": opencv,
            "img_size": np.array([film.height, film.width]), "frame_id": name,
            "global_step": 100 * row,
        }  # fmt: skip
        torch.save(payload, root / "checkpoint" / f"{name}.frame")
    if transforms:
        entries = [
            {"file_path": f"{folder}/{name}.png", "transform_matrix": np.eye(4).tolist()}
            for name in film.names
        ]
        for part, frames in (
            ("", entries),
            ("_train", entries[:-2]),
            ("_test", entries[-2:]),
            ("_val", entries[-1:]),
        ):
            (root / f"transforms{part}.json").write_text(
                json.dumps({"w": film.width, "h": film.height, "frames": frames})
            )


def write_hravatar(film, root, *, version=1, folder="image", suffix=".png", keys="name"):
    """tracked_params.json of a head four times as large, or tracked_params_v2.json of one in metres."""
    write_pictures(film, root / folder, suffix=suffix, masks=root / "mask")
    scale = {1: 4.0, 2: 1.0}[version]
    document = {
        "shapecode": [film.shape.tolist()],
        "intrinsics": [
            *(film.focal[0] / [film.width, film.height]).tolist(),
            *(film.center[0] / [film.width, film.height]).tolist(),
        ],
    }
    for row, name in enumerate(film.names):
        pose = FLIP @ film.world_to_camera[row]
        pose[:3, 3] *= scale
        full = np.concatenate([film.rotation[row], film.neck[row], film.jaw[row], film.eyes[row]])
        entry = {
            "expcode": [film.expression[row].tolist()], "fullposecode": [full.tolist()],
            "cam": [9.0, 0.0, 0.0], "world_mat": pose.tolist(),
            "translation": [film.translation[row].tolist()],
        }  # fmt: skip
        if film.eyelids is not None:
            entry["eyelids"] = [film.eyelids[row].tolist()]
        document[name if keys == "name" else f"{name}{suffix}"] = entry
    (root / {1: "tracked_params.json", 2: "tracked_params_v2.json"}[version]).write_text(
        json.dumps(document, ensure_ascii=False)
    )


def write_imavatar(film, root, *, suffix=".png", old=False):
    """flame_params.json: four times as large, looking along -z, fx negative; early ones in pixels of a
    picture of 512."""
    assert not film.translation.any()
    write_pictures(film, root / "image", suffix=suffix, masks=root / "mask")
    size = np.array([film.width, film.height]) / (512.0 if old else 1.0)
    frames = []
    for row, name in enumerate(film.names):
        pose = (FLIP @ film.world_to_camera[row])[:3]
        pose[:, 3] *= 4.0
        full = np.concatenate([film.rotation[row], film.neck[row], film.jaw[row], film.eyes[row]])
        frames.append(
            {"file_path": f"./image/{name}", "world_mat": pose.tolist(),
             "expression": film.expression[row].tolist(), "pose": full.tolist(),
             "bbox": [-0.5, -0.5, 0.5, 0.5], "flame_keypoints": [[0.0, 0.0]] * 70}
        )  # fmt: skip
    focal, center = film.focal[0] / size, film.center[0] / size
    document = {
        "intrinsics": [-focal[0], focal[1], *center],
        "shape_params": film.shape.tolist(),
        "frames": frames,
    }
    (root / "flame_params.json").write_text(json.dumps(document, ensure_ascii=False))


def write_vhap_export(film, root, *, suffix=".png"):
    """What VHAP's export and GaussianAvatars take, one file of parameters a frame."""
    write_pictures(film, root / "images", suffix=suffix, masks=root / "fg_masks")
    (root / "flame_param").mkdir()
    shared = {"shape": film.shape.astype(np.float32)}
    if film.static_offset is not None:
        shared["static_offset"] = film.static_offset[None].astype(np.float32)
    names = {
        "translation": "translation",
        "rotation": "rotation",
        "neck_pose": "neck",
        "jaw_pose": "jaw",
        "eyes_pose": "eyes",
        "expr": "expression",
    }
    zero = {key: np.zeros_like(getattr(film, name)[:1], dtype=np.float32) for key, name in names.items()}
    np.savez(root / "canonical_flame_param.npz", **zero, **shared)
    entries = []
    for row, name in enumerate(film.names):
        values = {
            key: getattr(film, of_film)[row : row + 1].astype(np.float32) for key, of_film in names.items()
        }
        np.savez(root / "flame_param" / f"{name}.npz", **values, **shared)
        pose = np.linalg.inv(film.world_to_camera[row]) @ FLIP
        entries.append(
            {"timestep_index": row, "camera_index": 0,
             "file_path": f"images/{name}{suffix}", "fg_mask_path": f"fg_masks/{name}.png",
             "flame_param_path": f"flame_param/{name}.npz",
             "transform_matrix": pose.tolist(), "w": film.width, "h": film.height,
             "fl_x": film.focal[row, 0], "fl_y": film.focal[row, 1],
             "cx": film.center[row, 0], "cy": film.center[row, 1],
             "camera_angle_x": 2 * math.atan(film.width / (2 * film.focal[row, 0]))}
        )  # fmt: skip
    first_test = math.floor(0.7 * len(film))
    for part, frames in (
        ("", entries),
        ("_train", entries[:first_test]),
        ("_test", entries[first_test:]),
        ("_val", []),
    ):
        (root / f"transforms{part}.json").write_text(json.dumps({"frames": frames}, ensure_ascii=False))


def take(film, rows):
    """The film's frames in another order, with their names."""
    arrays = {
        name: getattr(film, name)[rows]
        for name in (
            "expression",
            "rotation",
            "neck",
            "jaw",
            "eyes",
            "translation",
            "world_to_camera",
            "focal",
            "center",
        )
    }
    some = {name: getattr(film, name) for name in ("eyelids", "pictures", "albedo")}
    arrays |= {name: None if values is None else values[rows] for name, values in some.items()}
    kept = {name: getattr(film, name) for name in ("shape", "width", "height", "static_offset")}
    return Film(**arrays, **kept, names=[film.names[row] for row in rows])


WRITERS = {
    "VHAP export": write_vhap_export,
    "VHAP tracked": write_vhap_tracked,
    "metrical-tracker": write_metrical_tracker,
    "HRAvatar v1": lambda film, root, **options: write_hravatar(film, root, version=1, **options),
    "HRAvatar v2": lambda film, root, **options: write_hravatar(film, root, version=2, **options),
    "IMavatar": write_imavatar,
}


def make_film_for(layout, **options):
    """A film that a layout can hold: with what the layout keeps per frame, and without what it has no place
    for."""
    if layout == "VHAP export":
        return make_film(moving_camera=True, **options)
    if layout == "VHAP tracked":
        film = fixed_intrinsics(make_film(square_pixels=True, **options), centred=True)
    elif layout == "metrical-tracker":
        film = make_film(moving_camera=True, still_head=True, **options)
        film.eyelids = np.random.default_rng(3).random((len(film), 2))
    elif layout == "IMavatar":
        film = fixed_intrinsics(make_film(moving_camera=True, **options))
        film.translation[:] = 0.0
    else:
        film = fixed_intrinsics(make_film(moving_camera=True, **options))
        film.eyelids = np.random.default_rng(3).random((len(film), 2))
    return film


def write_layout(layout, film, root: Path, **options):
    root.mkdir(parents=True, exist_ok=True)
    WRITERS[layout](film, root, **options)
    return root
