"""A tracked sequence: its frames, what is known of each, and which of them train."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from torch import Tensor

from samira_warp.data.appearance import TrackedAppearance
from samira_warp.data.lens import Lens
from samira_warp.data.split import Split, divide_timesteps
from samira_warp.geometry.camera import Camera
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.support.faults import each


@dataclass(frozen=True, eq=False)
class FrameFiles:
    """One picture of a sequence and the files that belong to it.

    Attributes:
        name: The image file's stem, which outputs are named by; its recording's name comes before it where
            stems repeat.
        timestep: Index of the moment, shared by all cameras that saw it.
        image_path: The picture, laid on a background of one colour or with an alpha channel.
        mask_path: The head's coverage, None where the dataset has none.
        albedo_path: The estimated albedo as display values, None where the frame has none.
        parameters_path: The file of the tracked parameters, which other frames may share.
        camera: The view at the image file's own size, through a pinhole.
        lens: What bends the files' pictures, None where nothing does; they are made straight as they are
            read.
    """

    name: str
    timestep: int
    image_path: Path
    mask_path: Path | None
    albedo_path: Path | None
    parameters_path: Path
    camera: Camera
    lens: Lens | None


@dataclass(frozen=True, eq=False)
class Frame(FrameFiles):
    """A picture with its tracked parameters, which were read and checked.

    Attributes:
        parameters: What moved the head; frames of one moment may share memory.
    """

    parameters: FrameParameters


@dataclass(frozen=True, eq=False)
class Listing:
    """The pictures of a dataset and how they are divided; no parameters were read.

    Attributes:
        root: The dataset's folder.
        format: What the folder is, in words.
        split: How the frames were divided.
        frames: All frames, by timestep, then by name.
        train: Indices into ``frames``.
        test: Indices into ``frames``; none is in ``train``.
        notes: What a user should know of how the folder was read, a sentence each.
        doubts: Why its pictures and cameras may not belong together; heads can be driven by it all the same.
    """

    root: Path
    format: str
    split: Split
    frames: tuple[FrameFiles, ...]
    train: tuple[int, ...]
    test: tuple[int, ...]
    notes: tuple[str, ...]
    doubts: tuple[UserError, ...] = field(default=(), kw_only=True)

    @property
    def selected(self) -> tuple[int, ...]:
        """The part that the split names: indices into ``frames``."""
        return self.train if self.split.part == "train" else self.test


def listing_of(
    root: Path,
    split: Split,
    frames: list[FrameFiles],
    *,
    format: str,
    trains: list[bool] | None,
    notes: tuple[str, ...] = (),
) -> Listing:
    """Order a dataset's frames and divide them.

    Args:
        root: The dataset's folder.
        split: How to divide the frames; the dataset's own division of one that has none is the first 70 % of
            timesteps, as VHAP's.
        frames: In any order.
        format: What the folder is, in words.
        trains: Whether each frame trains by the dataset's own division, None where it has none.
        notes: What a user should know.

    Raises:
        UserError: Two frames have one name, or a part is empty.
    """
    frames = _named_apart(frames)
    _check_names(root, frames)
    if split.kind != "dataset" or trains is None:
        rule = split
        if split.kind == "dataset":
            rule = Split("0.7", "fraction", 0.7, split.part)
            notes = (*notes, "the dataset has no division of its own: the first 70 % of its timesteps train")
        train_steps, _ = divide_timesteps(rule, [frame.timestep for frame in frames])
        trains = [frame.timestep in train_steps for frame in frames]
    if all(trains) or not any(trains):
        raise UserError(
            root,
            expected="frames that train and frames that test",
            found=f"{sum(trains)} of {len(trains)} that train",
        )
    ordered = sorted(zip(frames, trains, strict=True), key=lambda entry: (entry[0].timestep, entry[0].name))
    return Listing(
        root=root,
        format=format,
        split=split,
        frames=tuple(frame for frame, _ in ordered),
        train=tuple(index for index, (_, train) in enumerate(ordered) if train),
        test=tuple(index for index, (_, train) in enumerate(ordered) if not train),
        notes=notes,
    )


def _named_apart(frames: list[FrameFiles]) -> list[FrameFiles]:
    """Frames of several recordings, whose pictures' names repeat, with their recording's name before theirs.

    A recording is the folder that holds the folder of its pictures, as GaussianAvatars' unions list them.
    """
    names = Counter(frame.name for frame in frames)
    recordings = {frame.image_path.resolve().parent.parent for frame in frames}
    if max(names.values(), default=1) == 1 or len(recordings) == 1:
        return frames
    return [
        replace(frame, name=f"{frame.image_path.resolve().parent.parent.name}_{frame.name}")
        for frame in frames
    ]


def _check_names(root: Path, frames: list[FrameFiles]) -> None:
    """Outputs are named by the image's stem: two frames of one name would overwrite each other."""
    seen: dict[str, Path] = {}

    def check(frame: FrameFiles) -> None:
        if frame.name in seen:
            raise UserError(
                root, expected="image names that differ", found=f"{seen[frame.name]} and {frame.image_path}"
            )
        seen[frame.name] = frame.image_path

    each(check, frames)


@dataclass(frozen=True, eq=False)
class TrackedSequence(Listing):
    """A tracked head: all that training and rendering need but the pixels.

    Attributes:
        frames: As in Listing, with parameters.
        shape: (n_shape,) float32 identity coefficients, the same for every frame.
        template: The head model that was tracked.
        template_path: Where it was read.
        static_offset: (V, 3) float32 metres, the subject's own offset from the linear shapes; None where the
            dataset has none.
        appearance: Albedo and light as the tracker found them; None where the dataset has none.
    """

    frames: tuple[Frame, ...]
    shape: Tensor
    template: HeadTemplate
    template_path: Path
    static_offset: Tensor | None
    appearance: TrackedAppearance | None

    def batch(self, indices: Iterable[int]) -> FrameParameters:
        """Pose and expression of some frames as one batch; dynamic offsets stay with their frames."""
        return FrameParameters.stack(
            [replace(self.frames[index].parameters, dynamic_offset=None) for index in indices]
        )
