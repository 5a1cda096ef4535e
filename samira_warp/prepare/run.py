"""The stages from a video to a dataset, each done once.

    OUT/film/images, OUT/film/alpha_maps   frames and mattes, as VHAP reads them
    OUT/film/faces.npz                     what networks see of the face in every frame
    OUT/tracking                           the fit, curves of it, and the mesh over the film; or VHAP's
    OUT/dataset                            what train reads
    OUT/refined                            the same with --refine AVATAR, fitted by its renderer
    OUT/stages                             what is done, from what

What an option does not ask for anew stays as it is: a crop, mattes and albedo that were given once are kept
when the option is left out.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

from samira_warp.avatar import Avatar
from samira_warp.check import check_dataset
from samira_warp.data import open_listing
from samira_warp.data.pictures import pictures_of
from samira_warp.data.subjects import made_subject
from samira_warp.data.video import VideoFacts, read_facts
from samira_warp.head import HeadTemplate
from samira_warp.head.models import missing_landmarks, read_head
from samira_warp.head.uv_layout import with_one_atlas
from samira_warp.io.files import replace_folder
from samira_warp.io.images import image_size, write_png
from samira_warp.prepare import albedo, matting, tracking
from samira_warp.prepare.config import USUAL_RATE, PrepareConfig
from samira_warp.prepare.crop import Crop, crop_around, find_head, middle, parse_crop
from samira_warp.prepare.cutting import write_cut_mattes
from samira_warp.prepare.export import export
from samira_warp.prepare.faces import (
    Chosen,
    Found,
    choose_frames,
    find_face,
    read_faces,
    rows_of,
    write_faces,
)
from samira_warp.prepare.frames import sampled, write_frames
from samira_warp.prepare.lenses import known_focal
from samira_warp.prepare.own_tracking import FIT_FILE, Filmed, read_fit, track_film
from samira_warp.prepare.refining import refine_dataset
from samira_warp.prepare.stages import Stage, check_root, content_of, folder_identity, is_file
from samira_warp.support.devices import pick_device
from samira_warp.support.errors import UserError
from samira_warp.tracker.observed import View
from samira_warp.vision.faces import FaceTrack
from samira_warp.vision.mattes import load_segmentation
from samira_warp.vision.networks import FaceNetworks

OPTION, FACES, MATTES = "--crop", "its face", "its mattes"
MIDDLE = "the middle, for want of anything that finds the head"
"""By what a square was chosen, as the stages' files say it."""

NETWORK, CUT, NOTHING = "Robust Video Matting", "selfie segmentation, sharpened", "nothing"
"""How mattes came about, as the stages' files say it."""

CHANGES = {
    "crop": "the square (--crop)",
    "frames": "frames of the same --size and --fps",
    "mattes": "the mattes",
    "tracking": "the film, the head and the tracker",
}
"""What has changed where a stage's inputs have, by the stage."""

CONTACT_SHEET = "tracking.png"
"""The sheet of `check`, in the dataset's folder."""


def prepare(config: PrepareConfig) -> Path:
    """Run every stage whose output is not there.

    What could not be run is said, and what the avatar loses by it.

    Returns:
        The dataset's folder.

    Raises:
        UserError: The video or an option cannot be used, no face is seen, or what tracks is not there: then
            everything before it is done.
    """
    config.check()
    facts = read_facts(config.video)
    if facts.dynamic_range is not None:
        _say(
            f"{config.video} is filmed in {facts.dynamic_range}, of high dynamic range: "
            "its frames are turned into sRGB"
        )
    vhap = None if config.vhap is None else tracking.given_vhap(config.vhap, config.vhap_python)
    wanted = None if config.crop is None else parse_crop(config.crop, width=facts.width, height=facts.height)
    check_root(config.out, ("film", "tracking", "dataset"))
    preparation = _Preparation(config, facts)
    preparation.check_video()
    config.out.mkdir(parents=True, exist_ok=True)
    cropped = preparation.crop(wanted)
    frames = preparation.frames(cropped)
    if vhap is not None or preparation.keeps_vhaps():
        mattes = preparation.mattes(frames, None)
        exported = preparation.export_vhap(preparation.track_vhap(mattes, vhap), vhap)
    else:
        faces = preparation.faces(frames)
        mattes = preparation.mattes(frames, faces)
        exported = preparation.export(preparation.track(mattes, cropped, frames), cropped, frames)
    preparation.add_albedo(exported)
    return config.out / "dataset" if config.refine is None else preparation.refine(exported)


class _Preparation:
    """One run of the verb: its stages, in their order, each taking the one before."""

    def __init__(self, config: PrepareConfig, facts: VideoFacts) -> None:
        self.config, self.facts, self.root = config, facts, config.out
        self.images, self.alpha_maps = self.root / "film" / "images", self.root / "film" / "alpha_maps"
        self.faces_file = self.root / "film" / "faces.npz"
        self._matte: matting.Matte | str | None = None

    def keeps_vhaps(self) -> bool:
        """Whether VHAP has tracked here, and nothing asks for another tracking.

        Raises:
            UserError: Another head is asked for, which VHAP does not track.
        """
        if not self._keeps_tracking() or "head" in self._finished("tracking").inputs:
            return False
        if self.config.head is not None:
            expected = f"none where VHAP has made {self.root / 'tracking'}, or --restart"
            raise UserError("--head", expected=expected, found=self.config.head)
        return True

    def check_video(self) -> None:
        """Refuse to put another video's frames in the place of one's that was prepared here."""
        before = self._finished("crop").inputs.get("video")
        if before is None or self.config.restart or is_file(self.config.video, before):
            return
        expected = (
            f"the video that was prepared in {self.root} (or another --out, or --restart to replace it)"
        )
        raise UserError(self.config.video, expected=expected, found="another")

    def crop(self, asked: Crop | None) -> Stage:
        """Choose the square to keep: the option's, the head's, or the middle."""
        before = self._finished("crop")
        same = "video" in before.inputs and is_file(self.config.video, before.inputs["video"])
        video = before.inputs["video"] if same else content_of(self.config.video)
        stage = self._stage("crop", video=video, asked=None if asked is None else list(asked))
        if asked is None and same:
            stage = before
        found = stage.done()
        if found is None or (found["by"].startswith("the middle") and self._may_look_again()):
            self._begin(stage)
            crop, by = (asked, OPTION) if asked is not None else self._head_square()
            stage.finish({"crop": list(crop), "by": by})
            whole = f"{self.facts.width} x {self.facts.height}"
            _say(f"the square of {crop.side} pixels at {crop.x},{crop.y} of {whole} is kept, by {by}")
        return stage

    def frames(self, cropped: Stage) -> Stage:
        """Write the frames."""
        inputs = {"crop": cropped.key(), "size": self.config.size, "fps": self.config.fps}
        stage = self._all_frames_of_an_earlier_version(inputs) or self._stage("frames", **inputs)
        found = stage.done()
        whole = found is not None and found["count"] == len(pictures_of(self.images))
        if found is None or not whole or ("rate" not in found and not self._keeps_tracking()):
            self._begin(stage, self.root / "film")
            written = write_frames(
                self.config.video,
                self.facts,
                self.images,
                crop=Crop(*cropped.result()["crop"]),
                size=self.config.size,
                fps=self.config.fps,
            )
            stage.finish(asdict(written))
        return stage

    def faces(self, frames: Stage) -> Stage:
        """Follow the face through the frames."""
        stage = self._stage("faces", frames=frames.key())
        if stage.done(self.faces_file) is None:
            self._begin(stage, self.faces_file)
            pictures = [path for _, path in sorted(pictures_of(self.images).items())]
            write_faces(pictures, self._faces_networks, self.faces_file)
            stage.finish({})
        return stage

    def mattes(self, frames: Stage, faces: Stage | None) -> Stage:
        """Write the mattes: those given, else a network's, else some that cover everything."""
        method = self._matting_method(frames, faces)
        stage, pictures = self._stage("mattes", frames=frames.key(), method=method), pictures_of(self.images)
        if stage.done() is None or not self._are_whole(frames):
            self._begin(stage, self.alpha_maps)
            network = self._network() if method == NETWORK else None
            if self.config.mattes is not None:
                matting.copy_mattes(self.config.mattes, pictures, self.alpha_maps)
            elif network is not None:
                matting.write_mattes(network, pictures, self.alpha_maps)
            elif method == CUT:
                segmentation = load_segmentation(self.config.models)
                write_cut_mattes(segmentation, pictures, read_faces(self.faces_file), self.alpha_maps)
            else:
                matting.write_opaque(pictures, self.alpha_maps)
            stage.finish({})
        if method == NOTHING:
            _say(
                "no mattes: whatever is behind the head becomes part of the avatar; "
                "--mattes DIR takes another program's"
            )
        return stage

    def track(self, mattes: Stage, cropped: Stage, frames: Stage) -> Stage:
        """Track the film."""
        stage = self._stage("tracking", mattes=mattes.key(), head=self._head.hash)
        folder = self.root / "tracking"
        if stage.done(folder / FIT_FILE) is None:
            self._begin(stage, folder, stage.unfinished)
            filmed, faces, chosen = self._filmed(cropped, frames)
            for note in chosen.notes:
                _say(note)
            if chosen.left_out:
                _say(_left_out(chosen))
            replace_folder(
                folder,
                lambda fresh: track_film(self._head, filmed, faces, fresh, kept=stage.unfinished, say=_say),
            )
            stage.finish({})
            shutil.rmtree(stage.unfinished)
        return stage

    def export(self, tracked: Stage, cropped: Stage, frames: Stage) -> Stage:
        """Write the dataset, and a sheet of it to look at."""
        stage = self._stage("dataset", tracking=tracked.key(), shoulders=self.config.keep_shoulders)
        folder = self.root / "dataset"
        if stage.done(folder) is None:
            self._begin(stage, folder)
            filmed, faces, _ = self._filmed(cropped, frames)
            fit = read_fit(self.root / "tracking" / FIT_FILE)
            keep = self.config.keep_shoulders
            replace_folder(
                folder,
                lambda fresh: export(self._head, fit, filmed, faces, fresh, keep_shoulders=keep),
            )
            report = check_dataset(folder)
            if report.sheet is not None:
                write_png(folder / CONTACT_SHEET, report.sheet)
            for line in report.text().splitlines():
                _say(line)
            stage.finish({})
        return stage

    def track_vhap(self, mattes: Stage, vhap: tracking.Vhap | None) -> Stage:
        """Have VHAP track the film; None where it has, and need not again."""
        stage, folder = self._stage("tracking", mattes=mattes.key()), self.root / "tracking"
        if stage.done(folder) is None:
            log = self.root / "tracking.log"
            self._begin(stage, folder)
            called = _needed(vhap, "tracked")
            replace_folder(folder, lambda fresh: tracking.track(called, self.root / "film", fresh, log=log))
            stage.finish({})
        return stage

    def export_vhap(self, tracked: Stage, vhap: tracking.Vhap | None) -> Stage:
        """Have VHAP export what it tracked; None where it has."""
        stage, folder = self._stage("dataset", tracking=tracked.key()), self.root / "dataset"
        if stage.done(folder) is None:
            log = self.root / "dataset.log"
            called = _needed(vhap, "exported")
            self._begin(stage, folder)
            replace_folder(
                folder, lambda fresh: tracking.export(called, self.root / "tracking", fresh, log=log)
            )
            stage.finish({})
        return stage

    def add_albedo(self, exported: Stage) -> None:
        """Copy the albedo images, or say how to come by some."""
        given, dataset = self.config.albedo, self.root / "dataset"
        target = dataset / "albedo"
        if given is None:
            if not pictures_of(target):
                _say(
                    "no --albedo: how much of the brightness is the skin's stays a guess, "
                    "and so do the colours of a relit avatar. "
                    f"IntrinsicAnything estimates albedo ({albedo.INSTALL}; "
                    f"then {albedo.command(dataset, self.root / 'albedo')}; "
                    f"then this again with --albedo {self.root / 'albedo'}), "
                    "and so do other intrinsic methods"
                )
            return
        stage = self._stage("albedo", dataset=exported.key(), folder=folder_identity(pictures_of(given)))
        if stage.done(target) is None:
            self._begin(stage)
            frames = open_listing(dataset).frames
            images = albedo.match_albedo(given, frames)
            replace_folder(target, lambda fresh: albedo.copy_albedo(images, fresh))
            stage.finish({})
            _say(f"{len(images)} of {len(frames)} frames have an albedo image")

    def refine(self, exported: Stage) -> Path:
        """Refine the tracking by an avatar, in a copy of the dataset."""
        given, folder = self.config.refine, self.root / "refined"
        assert given is not None
        avatar = Avatar.load(given, device=pick_device(self.config.device))
        stage = self._stage("refined", dataset=exported.key(), avatar=str(given.resolve()))
        if stage.done(folder) is None:
            self._begin(stage, folder)
            dataset = self.root / "dataset"
            replace_folder(folder, lambda fresh: refine_dataset(avatar, dataset, fresh, say=_say))
            stage.finish({})
        return folder

    @cached_property
    def _faces_networks(self) -> FaceNetworks:
        return FaceNetworks.load(self.config.models)

    @cached_property
    def _head(self) -> HeadTemplate:
        """The head model that is tracked; its charts are packed anew where they lie over each other.

        Raises:
            UserError: It cannot be read, has no landmarks, or cannot be unwrapped.
        """
        if self.config.head is None:
            return made_subject().head()
        template = read_head(self.config.head)
        missing = missing_landmarks(template, self.config.head)
        if missing is not None:
            raise UserError("--head", expected="a head with landmarks", found=missing)
        return with_one_atlas(template)

    def _filmed(self, cropped: Stage, frames: Stage) -> tuple[Filmed, FaceTrack, Chosen]:
        """The frames that are tracked, what is seen in them, and why others are left out."""
        track, rate = read_faces(self.faces_file), float(frames.result()["rate"])
        chosen = choose_frames(self.config.video, track, rate=rate)
        pictures = [path for _, path in sorted(pictures_of(self.images).items())]
        mattes = pictures_of(self.alpha_maps)
        names = sorted(pictures_of(self.images))
        width, height = image_size(pictures[0])
        crop = Crop(*cropped.result()["crop"])
        scale = width / crop.side
        view = View(
            width,
            height,
            cx=(0.5 * self.facts.width - crop.x) * scale,
            cy=(0.5 * self.facts.height - crop.y) * scale,
        )
        focal, origin = known_focal(self.config.video, self.facts, crop, side=width)
        filmed = Filmed(
            pictures=tuple(pictures[number] for number in chosen.frames),
            mattes=tuple(mattes[names[number]] for number in chosen.frames),
            view=view,
            rate=rate,
            focal=focal,
            numbers=tuple(chosen.frames),
            left_out=chosen.left_out,
            notes=(*chosen.notes, f"the focal length began at {focal:.0f} pixels, by {origin}"),
        )
        return filmed, rows_of(track, chosen.frames), chosen

    def _begin(self, stage: Stage, *outputs: Path) -> None:
        """Begin a stage; one whose inputs changed does not take a tracking with it unasked.

        Raises:
            UserError: It would.
        """
        if stage.changed() and self._keeps_tracking() and stage.name in CHANGES:
            expected = f"{CHANGES[stage.name]} as {self.root / 'tracking'} was made from, or --restart"
            raise UserError(self.root, expected=expected, found="another, which would have it made anew")
        stage.begin(*outputs)

    def _is_tracked(self) -> bool:
        return bool(self._finished("tracking").inputs) and (self.root / "tracking").is_dir()

    def _may_look_again(self) -> bool:
        """Whether the head can be looked for where it could not before, and nothing hangs on the square."""
        if self._keeps_tracking():
            return False
        return self.config.vhap is None or (not self._has_mattes() and self._network() is not None)

    def _all_frames_of_an_earlier_version(self, inputs: dict[str, Any]) -> Stage | None:
        """Frames that were tracked before --fps had a default, where it is left out now as it was then."""
        stage = self._stage("frames", **{**inputs, "fps": None})
        found = stage.done()
        theirs = found is not None and "rate" not in found
        return stage if theirs and self.config.fps == USUAL_RATE and self._keeps_tracking() else None

    def _keeps_tracking(self) -> bool:
        """Whether there is a tracking, and nothing was said of making it anew."""
        return self._is_tracked() and not self.config.restart

    def _stage(self, name: str, **inputs: Any) -> Stage:
        return Stage(self.root, name, inputs)

    def _finished(self, name: str) -> Stage:
        """A stage as it was last finished, whatever its inputs were; without inputs if it never was."""
        return self._stage(name, **self._stage(name).finished())

    def _matting_method(self, frames: Stage, faces: Stage | None) -> str:
        """Where mattes come from.

        The option's folder, else where those of these frames came from, else what network can be had.
        """
        if self.config.mattes is not None:
            return f"folder {folder_identity(pictures_of(self.config.mattes))}"
        before = self._finished("mattes").inputs
        theirs = before.get("frames") == frames.key() and self._are_whole(frames)
        if theirs and (before["method"] != NOTHING or self._keeps_tracking()):
            return before["method"]
        if self._network() is not None:
            return NETWORK
        return CUT if faces is not None else NOTHING

    def _are_whole(self, frames: Stage) -> bool:
        return len(pictures_of(self.alpha_maps)) == frames.result()["count"]

    def _has_mattes(self) -> bool:
        return (
            self.config.mattes is not None
            or self._finished("mattes").inputs.get("method", NOTHING) != NOTHING
        )

    def _network(self) -> matting.Matte | None:
        """Robust Video Matting, fetched when it is first asked for; None, said once, where there is none."""
        if self._matte is None:
            try:
                self._matte = matting.load_matting(self.config.device)
            except matting.MattingMissing as missing:
                self._matte = str(missing)
                _say(f"no Robust Video Matting ({self._matte}); to have it: {matting.INSTALL}")
        return None if isinstance(self._matte, str) else self._matte

    def _head_square(self) -> tuple[Crop, str]:
        """The square round the head, and by what it was found."""
        width, height = self.facts.width, self.facts.height
        find, by = self._finder()
        if find is None:
            _say(
                "the head cannot be looked for, and the video's middle is kept; "
                "--crop X,Y,SIDE keeps another square, the tighter the sharper"
            )
            return middle(width=width, height=height), MIDDLE
        heads = [find(picture) for picture in sampled(self.config.video, self.facts)]
        boxes = (head.box for head in heads if head.box is not None)
        crop = crop_around(boxes, width=width, height=height)
        if crop is None:
            reasons = [head.reason for head in heads]
            found = f"nobody, by {by}: {max(sorted(set(reasons)), key=reasons.count)}"
            raise UserError(self.config.video, expected="a person, or --crop X,Y,SIDE", found=found)
        several = sum(not head.alone for head in heads)
        if several:
            _say(
                f"{several} of {len(heads)} pictures that were looked at show several faces: the largest is "
                "taken; --crop X,Y,SIDE takes another"
            )
        return crop, by

    def _finder(self) -> tuple[Callable[[Any], Found] | None, str]:
        """What finds a head in a picture, and its name: the face's networks where the package tracks."""
        if self.config.vhap is None:
            networks = self._faces_networks
            return (lambda picture: find_face(networks, picture)), FACES
        network = self._network()
        if network is None:
            return None, MIDDLE
        return (lambda picture: _in_matte(matting.matte_still(network, picture))), MATTES


def _left_out(chosen: Chosen) -> str:
    """Which frames are not tracked, and why."""
    reasons: dict[str, list[int]] = {}
    for number, reason in chosen.left_out.items():
        reasons.setdefault(reason, []).append(number)
    parts = [
        f"{len(numbers)} for '{reason}', the first is {numbers[0]}" for reason, numbers in reasons.items()
    ]
    return f"{len(chosen.left_out)} frames are left out: {'; '.join(parts)}"


def _in_matte(matte: Any) -> Found:
    """The head in one matte (H, W)."""
    box = find_head(matte)
    return Found(box, "" if box else "nothing is covered")


def _needed(vhap: tracking.Vhap | None, what: str) -> tracking.Vhap:
    """VHAP.

    Raises:
        UserError: It was not given.
    """
    if vhap is None:
        expected = "VHAP's folder, which tracked this film, or --restart to have it tracked without"
        raise UserError("--vhap", expected=expected, found=f"none, and the film has to be {what} by it")
    return vhap


def _say(text: str) -> None:
    print(f"note: {text}", file=sys.stderr)
