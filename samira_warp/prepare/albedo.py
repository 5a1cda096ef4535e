"""Albedo images of any intrinsic method, put beside the frames that they belong to."""

from __future__ import annotations

from pathlib import Path

from tqdm import tqdm

from samira_warp.data import FrameFiles
from samira_warp.data.pictures import key_of, pictures_of
from samira_warp.io.images import read_on_white, write_png
from samira_warp.prepare.frames import frame_name
from samira_warp.prepare.matting import fitted
from samira_warp.support.errors import UserError

CHECKPOINT = "weights/albedo/checkpoints/last.ckpt"

INSTALL = (
    "git clone https://github.com/zju3dv/IntrinsicAnything && cd IntrinsicAnything "
    "&& pip install -r requirements.txt && huggingface-cli download "
    f"--repo-type space --local-dir . LittleFrog/IntrinsicAnything {CHECKPOINT}"
)


def command(dataset: Path, folder: Path) -> str:
    """How IntrinsicAnything is run, in its own folder, on a dataset's images."""
    images, masks = ((dataset / name).resolve() for name in ("images", "fg_masks"))
    options = (
        f"--input_dir {images} --mask_dir {masks} --output_dir {folder.resolve()} --ddim 100 --batch_size 4"
    )
    return f"python inference.py --model_dir weights/albedo {options}"


def match_albedo(source: Path, frames: tuple[FrameFiles, ...]) -> dict[FrameFiles, Path]:
    """Find the albedo images that belong to a dataset's frames.

    Args:
        source: Folder of images named as the dataset's, or as the film's that it was tracked in.
        frames: The dataset's frames.

    Returns:
        The image of each frame that has one.

    Raises:
        UserError: No frame has one.
    """
    given, found = pictures_of(source), {}
    for frame in frames:
        path = given.get(key_of(frame.name)) or given.get(Path(frame_name(frame.timestep)).stem)
        if path is not None:
            found[frame] = path
    if not found:
        names = f"{frames[0].name}.png or {Path(frame_name(frames[0].timestep)).stem}.png"
        raise UserError(
            source,
            expected=f"albedo images named as the frames, {names}",
            found=f"{len(given)} pictures of other names",
        )
    return found


def copy_albedo(images: dict[FrameFiles, Path], folder: Path) -> None:
    """Copy albedo images into an existing folder, by the dataset's names, at the frames' size.

    Raises:
        UserError: One cannot be read, or is of another shape than its frame.
        OSError: One cannot be written.
    """
    for frame, path in tqdm(images.items(), desc="albedo", unit="frame", dynamic_ncols=True):
        write_png(folder / f"{frame.name}.png", fitted(read_on_white(path), path, frame.image_path))
