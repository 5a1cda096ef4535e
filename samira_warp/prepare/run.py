"""The stages from a video to a dataset, each done once.

    OUT/film/images, OUT/film/alpha_maps   frames and mattes, as VHAP reads them
    OUT/tracking                           what VHAP writes
    OUT/dataset                            VHAP's export, and albedo in it
    OUT/stages                             what is done, from what

What an option does not ask for anew stays as it is: a crop, mattes and albedo that were given once are kept
when the option is left out.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from samira_warp.data import open_listing
from samira_warp.data.pictures import pictures_of
from samira_warp.io.files import replace_folder
from samira_warp.prepare import albedo, matting, tracking
from samira_warp.prepare.config import PrepareConfig
from samira_warp.prepare.crop import Crop, crop_around, find_head, middle, parse_crop
from samira_warp.prepare.frames import sampled, write_frames
from samira_warp.prepare.stages import Stage, check_root, content_of, folder_identity, is_file
from samira_warp.prepare.video import VideoFacts, read_facts
from samira_warp.support.errors import UserError

MIDDLE = "the middle, for want of mattes"
NETWORK, NOTHING = "Robust Video Matting", "nothing"
"""How a square or mattes came about, as the stages' files say it."""

CHANGES = {
    "crop": "the square (--crop)",
    "frames": "frames of the same --size and --fps",
    "mattes": "the mattes",
    "tracking": "the film",
}
"""What has changed where a stage's inputs have, by the stage."""


def prepare(config: PrepareConfig) -> Path:
    """Run every stage whose output is not there.

    What could not be run is said, and what the avatar loses by it.

    Returns:
        The dataset's folder.

    Raises:
        UserError: The video or an option cannot be used, or there is no tracker: then everything before it is
            done.
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
    mattes = preparation.mattes(frames)
    tracked = preparation.track(mattes, vhap)
    exported = preparation.export(tracked, vhap)
    preparation.add_albedo(exported)
    return config.out / "dataset"


class _Preparation:
    """One run of the verb: its stages, in their order, each taking the one before."""

    def __init__(self, config: PrepareConfig, facts: VideoFacts) -> None:
        self.config, self.facts, self.root = config, facts, config.out
        self.images, self.alpha_maps = self.root / "film" / "images", self.root / "film" / "alpha_maps"
        self._matte: matting.Matte | str | None = None

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
        """Choose the square to keep: the option's, the head's by its mattes, or the middle."""
        before = self._finished("crop")
        same = "video" in before.inputs and is_file(self.config.video, before.inputs["video"])
        video = before.inputs["video"] if same else content_of(self.config.video)
        stage = self._stage("crop", video=video, asked=None if asked is None else list(asked))
        if asked is None and same:
            stage = before
        found = stage.done()
        if found is None or (found["by"] == MIDDLE and self._may_look_again()):
            self._begin(stage)
            crop, by = (asked, "--crop") if asked is not None else self._head()
            stage.finish({"crop": list(crop), "by": by})
            whole = f"{self.facts.width} x {self.facts.height}"
            _say(f"the square of {crop.side} pixels at {crop.x},{crop.y} of {whole} is kept, by {by}")
        return stage

    def frames(self, cropped: Stage) -> Stage:
        """Write the frames."""
        stage = self._stage("frames", crop=cropped.key(), size=self.config.size, fps=self.config.fps)
        found = stage.done()
        if found is None or found["count"] != len(pictures_of(self.images)):
            self._begin(stage, self.root / "film")
            count = write_frames(
                self.config.video,
                self.facts,
                self.images,
                crop=Crop(*cropped.result()["crop"]),
                size=self.config.size,
                fps=self.config.fps,
            )
            stage.finish({"count": count})
        return stage

    def mattes(self, frames: Stage) -> Stage:
        """Write the mattes: those given, else the network's, else some that cover everything."""
        method = self._matting_method(frames)
        stage, pictures = self._stage("mattes", frames=frames.key(), method=method), pictures_of(self.images)
        if stage.done() is None or not self._are_whole(frames):
            self._begin(stage, self.alpha_maps)
            network = self._network() if method == NETWORK else None
            if self.config.mattes is not None:
                matting.copy_mattes(self.config.mattes, pictures, self.alpha_maps)
            elif network is not None:
                matting.write_mattes(network, pictures, self.alpha_maps)
            else:
                matting.write_opaque(pictures, self.alpha_maps)
            stage.finish({})
        if method == NOTHING:
            _say(
                "no mattes: whatever is behind the head becomes part of the avatar; "
                "--mattes DIR takes another program's"
            )
        return stage

    def track(self, mattes: Stage, vhap: tracking.Vhap | None) -> Stage:
        """Have VHAP track the film."""
        stage, folder = self._stage("tracking", mattes=mattes.key()), self.root / "tracking"
        if stage.done(folder) is None:
            tracker, log = self._tracker(vhap), self.root / "tracking.log"
            self._begin(stage, folder)
            replace_folder(folder, lambda fresh: tracking.track(tracker, self.root / "film", fresh, log=log))
            stage.finish({})
        return stage

    def export(self, tracked: Stage, vhap: tracking.Vhap | None) -> Stage:
        """Have VHAP export what it tracked."""
        stage, folder = self._stage("dataset", tracking=tracked.key()), self.root / "dataset"
        if stage.done(folder) is None:
            tracker, log = self._tracker(vhap), self.root / "dataset.log"
            self._begin(stage, folder)
            replace_folder(
                folder, lambda fresh: tracking.export(tracker, self.root / "tracking", fresh, log=log)
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
        return not self._has_mattes() and not self._keeps_tracking() and self._network() is not None

    def _keeps_tracking(self) -> bool:
        """Whether there is a tracking, and nothing was said of making it anew."""
        return self._is_tracked() and not self.config.restart

    def _stage(self, name: str, **inputs: Any) -> Stage:
        return Stage(self.root, name, inputs)

    def _finished(self, name: str) -> Stage:
        """A stage as it was last finished, whatever its inputs were; without inputs if it never was."""
        return self._stage(name, **self._stage(name).finished())

    def _matting_method(self, frames: Stage) -> str:
        """Where mattes come from.

        The option's folder, else where those of these frames came from, else the network if it can be had.
        """
        if self.config.mattes is not None:
            return f"folder {folder_identity(pictures_of(self.config.mattes))}"
        before = self._finished("mattes").inputs
        theirs = before.get("frames") == frames.key() and self._are_whole(frames)
        if theirs and (before["method"] != NOTHING or self._keeps_tracking()):
            return before["method"]
        return NOTHING if self._network() is None else NETWORK

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

    def _head(self) -> tuple[Crop, str]:
        """The square round the head, and by what it was found."""
        width, height = self.facts.width, self.facts.height
        network = self._network()
        if network is None:
            _say(
                "the head cannot be looked for, and the video's middle is kept; "
                "--crop X,Y,SIDE keeps another square, the tighter the sharper"
            )
            return middle(width=width, height=height), MIDDLE
        heads = (
            find_head(matting.matte_still(network, picture))
            for picture in sampled(self.config.video, self.facts)
        )
        crop = crop_around((head for head in heads if head is not None), width=width, height=height)
        if crop is None:
            raise UserError(
                self.config.video, expected="a person, or --crop X,Y,SIDE", found="nobody in its mattes"
            )
        return crop, "its mattes"

    def _tracker(self, given: tracking.Vhap | None) -> tracking.Vhap:
        vhap = given or tracking.installed_vhap(self.config.vhap_python)
        if vhap is None:
            advice = f"{tracking.INSTALL}; FLAME's files in VHAP/asset/flame; then this again"
            expected = f"VHAP for tracking, without which there is no avatar: {advice}"
            raise UserError(
                "--vhap", expected=expected, found=f"none; frames and mattes are in {self.root / 'film'}"
            )
        return vhap


def _say(text: str) -> None:
    print(f"note: {text}", file=sys.stderr)
