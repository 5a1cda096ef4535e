"""The prepare verb from a video to a dataset, with stand-ins for the programs that it calls."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from data.damage import file_size_limit
from stand_ins import HEIGHT, LEFT, SIDE, TOP, WIDTH, make_hub, vhap_options
from subjects import train_arguments, train_command
from warm_start import warm_python

from samira_warp.check.report import check_dataset
from samira_warp.data import load_pixels, open_listing, open_sequence
from samira_warp.io.images import read_image, write_png
from samira_warp.prepare import frames, matting, tracking
from samira_warp.prepare.__main__ import main
from samira_warp.prepare.config import PrepareConfig
from samira_warp.prepare.stages import Stage
from samira_warp.support.cli import run

CROP = ("--crop", f"{LEFT},{TOP},{SIDE}")


class Green:
    """The network of the stand-in without its memory: green is behind."""

    def __init__(self):
        self.asked = 0

    def __call__(self, picture, state):
        self.asked += 1
        red, green, blue = np.moveaxis(picture.astype(np.float32) / 255.0, 2, 0)
        return 1.0 - np.clip(4.0 * (green - np.maximum(red, blue)), 0.0, 1.0), state


@pytest.fixture
def network(monkeypatch):
    """Robust Video Matting as this process has it."""
    network = Green()
    monkeypatch.setattr(matting, "load_matting", lambda device: network)
    return network


@pytest.fixture
def no_network(monkeypatch):
    def load(device):
        raise matting.MattingMissing("torchvision is not installed")

    monkeypatch.setattr(matting, "load_matting", load)


def prepare(*arguments):
    """The verb in this process; its exit status."""
    return run(
        main,
        PrepareConfig,
        program="python -m samira_warp.prepare",
        arguments=[*map(str, arguments), "--device", "cpu"],
    )


def command(*arguments, environment=None, python=None):
    """The verb in a process of its own, begun."""
    words = [*(python or warm_python()), "-m", "samira_warp.prepare", *map(str, arguments), "--device", "cpu"]
    return subprocess.Popen(
        words,
        env={**os.environ, **(environment or {})},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def refusal(capsys, *arguments, status=2):
    """The last line of what is said when the verb refuses; the lines before it are notes and progress."""
    capsys.readouterr()
    assert prepare(*arguments) == status
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    *before, last = captured.err.splitlines()
    assert last.startswith("error: ")
    assert not any(line.startswith("error: ") for line in before)
    return last


def tree(folder):
    """Every file's bytes by path, without what says when and where it was made."""
    paths = [
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix in (".jpg", ".png", ".json", ".npz")
    ]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def times(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


@pytest.fixture
def albedo(tmp_path):
    """Every third frame's, by the names of the film."""
    folder = tmp_path / "albedo of it"
    folder.mkdir()
    for number in range(0, 12, 3):
        write_png(folder / f"{number:06d}.png", np.full((16, 16, 3), number / 12))
    return folder


def test_from_a_video_to_an_avatar(video, vhap, albedo, tmp_path):
    """The whole way in processes of their own, torch.hub and VHAP's scripts included."""
    out = tmp_path / "out"
    ended = command(
        video, "--out", out, *vhap_options(vhap), "--albedo", albedo, environment=make_hub(tmp_path / "hub")
    )
    said = ended.communicate(timeout=300)[1]
    assert ended.returncode == 0, said
    assert "Traceback" not in said
    assert f"train --data {out / 'dataset'}" in said.splitlines()[-1]
    sequence = open_sequence(out / "dataset")
    assert len(sequence.frames) == 12
    assert [frame.albedo_path is not None for frame in sequence.frames] == [
        number % 3 == 0 for number in range(12)
    ]
    side = sequence.frames[0].camera.width
    x, y, cropped = json.loads((out / "stages" / "crop.json").read_text())["result"]["crop"]
    assert side == cropped
    # the head is 0.23 m from crown to chin, at 1 m 41 pixels, and moves; the square is half again as large as
    # where it goes with some neck
    assert 1.5 * 41 <= side <= 1.5 * SIDE
    assert x < LEFT + 8
    assert y < TOP + 8
    assert min(x, y) >= 0
    pixels = load_pixels(sequence.frames[3], width=side, height=side)
    head = (pixels.mask > 0.5).nonzero().float().mean(dim=0)
    assert (head - side / 2).abs().max() < 0.2 * side
    assert pixels.image[-1, 0].min() > 0.97, "green is gone"
    assert train_command(*train_arguments(out / "dataset", tmp_path / "run")) == 0


def test_what_was_filmed_comes_out(video, vhap, filmed_dataset, network, tmp_path):
    """Where the crop is where the subject was tracked, the dataset is the subject's own, and check has
    nothing to say about it."""
    assert prepare(video, "--out", tmp_path / "out", *vhap_options(vhap), *CROP) == 0
    made, filmed = open_sequence(tmp_path / "out" / "dataset"), open_sequence(filmed_dataset)
    assert check_dataset(made.root).findings == ()
    for number, frame in enumerate(made.frames):
        original = filmed.frames[number % len(filmed.frames)]
        assert torch.equal(frame.parameters.expression, original.parameters.expression)
        assert torch.equal(frame.camera.world_to_camera, original.camera.world_to_camera)
        ours, theirs = (load_pixels(each, width=SIDE, height=SIDE) for each in (frame, original))
        # the matte is that of a stand-in: it errs where the subject's outline is mixed with green; two codecs
        # take the rest
        assert (ours.mask - theirs.mask).abs().mean() < 0.02
        assert (ours.image - theirs.image)[theirs.mask > 0.99].abs().mean() < 0.02


def test_what_is_done_is_skipped(video, vhap, network, tmp_path):
    arguments = (video, "--out", tmp_path / "out", *vhap_options(vhap))
    assert prepare(*arguments) == 0
    before, asked = times(tmp_path / "out"), network.asked
    assert prepare(*arguments) == 0
    assert times(tmp_path / "out") == before
    assert network.asked == asked


def test_what_vhap_has_tracked_stays_without_it(video, vhap, network, tmp_path, capsys):
    """A folder in which VHAP tracked is not tracked anew because the option is left out."""
    out = tmp_path / "out"
    assert prepare(video, "--out", out, *vhap_options(vhap), *CROP) == 0
    before = times(out)
    assert prepare(video, "--out", out) == 0
    assert times(out) == before
    message = refusal(capsys, video, "--out", out, "--head", tmp_path / "head.npz")
    assert "--head: expected none where VHAP has made" in message
    assert times(out) == before
    tracked = times(out / "tracking")
    shutil.rmtree(out / "dataset")
    message = refusal(capsys, video, "--out", out)
    assert "--vhap: expected VHAP's folder" in message
    assert "exported" in message
    assert prepare(video, "--out", out, *vhap_options(vhap)) == 0
    assert times(out / "tracking") == tracked


def test_without_matting_the_middle_is_kept_and_it_is_named(
    video, vhap, no_network, tmp_path, capsys, monkeypatch
):
    arguments = (video, "--out", tmp_path / "out", *vhap_options(vhap))
    assert prepare(*arguments) == 0
    said = capsys.readouterr().err
    assert said.count("no Robust Video Matting (torchvision is not installed)") == 1
    assert "pip install torchvision" in said
    assert "becomes part of the avatar" in said
    assert "--crop X,Y,SIDE" in said
    listing = open_listing(tmp_path / "out" / "dataset")
    assert listing.frames[0].camera.width == HEIGHT
    assert load_pixels(listing.frames[0], width=HEIGHT, height=HEIGHT).mask.min() == 1.0
    # with it at last, a tracking is not thrown away unasked; else the head is found and the rest made anew
    network = Green()
    monkeypatch.setattr(matting, "load_matting", lambda device: network)
    before = times(tmp_path / "out")
    assert prepare(*arguments) == 0
    assert times(tmp_path / "out") == before
    assert prepare(*arguments, "--restart") == 0
    frame = open_listing(tmp_path / "out" / "dataset").frames[0]
    assert frame.camera.width < HEIGHT
    assert load_pixels(frame, width=HEIGHT, height=HEIGHT).mask.min() < 0.1


def test_mattes_of_another_program_are_kept_once_given(video, vhap, no_network, tmp_path, capsys):
    out = tmp_path / "out"
    assert prepare(video, "--out", out, *vhap_options(vhap)) == 0
    given = tmp_path / "given"
    given.mkdir()
    for path in (out / "film" / "images").iterdir():
        write_png(given / f"{path.stem}.png", np.tri(HEIGHT))
    capsys.readouterr()
    assert prepare(video, "--out", out, *vhap_options(vhap), "--mattes", given, "--restart") == 0
    mask = load_pixels(open_listing(out / "dataset").frames[5], width=HEIGHT, height=HEIGHT).mask
    assert np.abs(mask.numpy() - np.tri(HEIGHT)).mean() < 0.02
    assert "part of the avatar" not in capsys.readouterr().err
    before = times(out)
    assert prepare(video, "--out", out, *vhap_options(vhap)) == 0
    assert times(out) == before


def test_without_albedo_it_is_named_and_can_be_added(video, vhap, network, albedo, tmp_path, capsys):
    out = tmp_path / "out"
    assert prepare(video, "--out", out, *vhap_options(vhap), *CROP) == 0
    said = capsys.readouterr().err
    assert "git clone https://github.com/zju3dv/IntrinsicAnything" in said
    assert f"--input_dir {out / 'dataset' / 'images'}" in said
    before = times(out)
    assert prepare(video, "--out", out, "--albedo", albedo) == 0
    said = capsys.readouterr().err
    assert "4 of 12 frames have an albedo image" in said
    assert "IntrinsicAnything" not in said
    assert {path: stamp for path, stamp in times(out).items() if path in before} == before
    added = read_image(out / "dataset" / "albedo" / "00003_00.png", channels=3)
    assert added.shape == (SIDE, SIDE, 3)
    assert np.abs(added - 3 / 12).max() < 1 / 255
    # by the dataset's own names as well, and others of the folder are left alone
    (albedo / "000003.png").rename(albedo / "00003_00.png")
    write_png(albedo / "somebody else.png", np.zeros((16, 16, 3)))
    assert prepare(video, "--out", out, "--albedo", albedo) == 0
    assert "4 of 12" in capsys.readouterr().err


def test_other_options_make_anew_what_follows_from_them(video, vhap, network, tmp_path):
    out = tmp_path / "out"
    assert prepare(video, "--out", out, *vhap_options(vhap), *CROP) == 0
    assert prepare(video, "--out", out, *vhap_options(vhap), "--size", 24, "--fps", 12.5, "--restart") == 0
    frame, *rest = open_listing(out / "dataset").frames
    assert (frame.camera.width, len(rest)) == (24, 5)
    assert json.loads((out / "stages" / "crop.json").read_text())["result"]["crop"] == [LEFT, TOP, SIDE], (
        "what was given stays"
    )


@pytest.mark.parametrize(
    "options", [("--size", 24), ("--fps", 12.5), ("--crop", "1,1,40"), ("--mattes", "FILM")]
)
def test_a_tracking_is_not_lost_unasked(video, vhap, network, tmp_path, capsys, options):
    out = tmp_path / "out"
    assert prepare(video, "--out", out, *vhap_options(vhap), *CROP) == 0
    before = times(out)
    given = shutil.copytree(out / "film" / "alpha_maps", tmp_path / "mattes")
    write_png(given / "000003.png", np.ones((32, 32, 1)))
    (given / "000003.jpg").unlink()
    options = [given if option == "FILM" else option for option in options]
    message = refusal(capsys, video, "--out", out, *vhap_options(vhap), *options)
    assert "--restart" in message
    assert str(out / "tracking") in message
    assert times(out) == before
    assert prepare(video, "--out", out, *vhap_options(vhap)) == 0, "the refused option left nothing behind"
    assert times(out) == before
    assert prepare(video, "--out", out, *vhap_options(vhap), *options, "--restart") == 0
    assert times(out) != before


def test_another_video_is_told_by_its_content(video, vhap, network, tmp_path, capsys):
    out, arguments = tmp_path / "out", (*vhap_options(vhap), *CROP)
    kept = shutil.copy(video, tmp_path / "film.mp4")
    assert prepare(kept, "--out", out, *arguments) == 0
    before = times(out)
    os.utime(kept, (1, 1))
    renamed = Path(kept).rename(tmp_path / "renamed.mp4")
    assert prepare(renamed, "--out", out, *arguments) == 0
    assert times(out) == before, "a touched or renamed file is the same video"
    content = bytearray(renamed.read_bytes())
    content[-1] ^= 1  # of the index's last entry, which is not needed: it decodes as before
    status = renamed.stat()
    renamed.write_bytes(content)
    os.utime(renamed, ns=(status.st_atime_ns, status.st_mtime_ns))
    message = refusal(capsys, renamed, "--out", out, *arguments)
    assert "--restart" in message
    assert times(out) == before
    assert prepare(renamed, "--out", out, *arguments, "--restart") == 0


def test_a_folder_of_an_earlier_version_goes_on(video, vhap, network, tmp_path):
    """Markers told a video by name, size and time; all frames were taken, and nobody asked for their rate."""
    out, arguments = tmp_path / "out", (*vhap_options(vhap), *CROP)
    assert prepare(video, "--out", out, *arguments) == 0
    marker = json.loads((out / "stages" / "crop.json").read_text())
    assert isinstance(marker["inputs"]["video"], str)
    marker["inputs"]["video"] = [video.name, video.stat().st_size, 12345]
    (out / "stages" / "crop.json").write_text(json.dumps(marker))
    (out / "tracking" / "kept").touch()
    frames_marker = json.loads((out / "stages" / "frames.json").read_text())
    assert frames_marker["inputs"]["fps"] == 25.0
    assert frames_marker["result"] == {"count": 12, "rate": pytest.approx(25.0, rel=1e-3)}
    frames_marker["inputs"]["fps"] = None
    del frames_marker["result"]["rate"]
    (out / "stages" / "frames.json").write_text(json.dumps(frames_marker))
    assert not (out / "stages" / "faces.json").exists()
    # what followed was keyed by the old marker, as it was then
    for later, before in (
        ("frames", "crop"),
        ("mattes", "frames"),
        ("tracking", "mattes"),
        ("dataset", "tracking"),
    ):
        record = json.loads((out / "stages" / f"{later}.json").read_text())
        parent = json.loads((out / "stages" / f"{before}.json").read_text())
        record["inputs"][before] = Stage(out, before, parent["inputs"]).key()
        (out / "stages" / f"{later}.json").write_text(json.dumps(record))
    before = times(out)
    assert prepare(video, "--out", out, *arguments) == 0
    assert prepare(video, "--out", out) == 0
    assert times(out) == before
    assert (out / "tracking" / "kept").is_file()


def test_an_interrupted_stage_goes_on(video, vhap, network, tmp_path, monkeypatch):
    arguments = (video, *vhap_options(vhap), *CROP)
    assert prepare(*arguments, "--out", tmp_path / "whole") == 0
    out, write, written = tmp_path / "parts", frames.write_whole, []

    def ended_write(path, picture):
        written.append(path)
        if len(written) in (5, 20):  # among the frames, then among the mattes
            raise KeyboardInterrupt
        write(path, picture)

    for module in (frames, matting):
        monkeypatch.setattr(module, "write_whole", ended_write)
    assert prepare(*arguments, "--out", out) == 130
    assert len(list((out / "film" / "images").iterdir())) == 4
    assert prepare(*arguments, "--out", out) == 130
    assert len(list((out / "film" / "images").iterdir())) == 12
    assert not (out / "tracking").exists()
    assert prepare(*arguments, "--out", out) == 0
    assert len(written) == 24 + 2, "nothing is made twice but what was interrupted"
    assert tree(tmp_path / "whole" / "film") == tree(out / "film")
    assert tree(tmp_path / "whole" / "dataset") == tree(out / "dataset")


def interrupt(process):
    """Send Ctrl-C to the process alone (a terminal would send it to VHAP as well), and what it then says.

    Python drops an interrupt that arrives while it frees an object, so a second one follows, as a person's
    would.
    """
    for _ in range(5):
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.communicate(timeout=20)[1]
    raise AssertionError("still running after five interrupts")


def test_ctrl_c_ends_vhap_and_exits_130(video, vhap, tmp_path):
    (vhap / "slow").touch()
    out = tmp_path / "out"
    begun = command(video, "--out", out, *vhap_options(vhap), *CROP)
    deadline = time.monotonic() + 200
    while not (vhap / "started").exists():
        assert time.monotonic() < deadline
        assert begun.poll() is None, begun.communicate()[1]
        time.sleep(0.05)
    said = interrupt(begun)
    assert begun.returncode == 130
    assert "Traceback" not in said
    assert said.splitlines()[-1] == "stopped; the same command goes on"
    with pytest.raises(ProcessLookupError):
        os.kill(int((vhap / "started").read_text()), 0)
    assert not [path.name for path in out.iterdir() if "tracking" in path.name and path.is_dir()]


def test_a_lost_frame_is_made_again(video, network, tmp_path, capsys):
    out = tmp_path / "out"
    refusal(capsys, video, "--out", out, *CROP)
    before = tree(out)
    (out / "film" / "images" / "000007.jpg").unlink()
    refusal(capsys, video, "--out", out, *CROP)
    assert tree(out) == before


def test_a_lost_dataset_is_exported_again(video, vhap, network, albedo, tmp_path):
    out = tmp_path / "out"
    arguments = (video, "--out", out, *vhap_options(vhap), *CROP, "--albedo", albedo)
    assert prepare(*arguments) == 0
    before, tracked = tree(out / "dataset"), times(out / "tracking")
    shutil.rmtree(out / "dataset")
    assert prepare(*arguments) == 0
    assert tree(out / "dataset") == before
    assert times(out / "tracking") == tracked


def test_a_full_disk_is_one_line_and_leaves_nothing_half(video, network, tmp_path, capsys):
    out = tmp_path / "out"
    with file_size_limit(600):  # enough for the stages' files, too little for a frame
        message = refusal(capsys, video, "--out", out, *CROP)
    assert "000000.jpg: cannot be written" in message
    assert list((out / "film" / "images").iterdir()) == []
    refusal(capsys, video, "--out", out, *CROP)
    assert len(list((out / "film" / "images").iterdir())) == 12


def test_vhap_that_fails_is_named_by_its_last_line(video, vhap, network, tmp_path, capsys):
    arguments = (video, "--out", tmp_path / "out", *vhap_options(vhap), *CROP)
    (vhap / "broken").touch()
    message = refusal(capsys, *arguments)
    log = tmp_path / "out" / "tracking.log"
    expected = f"{log}: expected VHAP's vhap/track.py to end well, found status 1: ImportError: nvdiffrast"
    assert expected in message
    assert "step 2" in (tmp_path / "out" / "tracking.log").read_text()
    (vhap / "broken").unlink()
    (vhap / "empty").touch()
    assert "to leave tracked_flame_params" in refusal(capsys, *arguments)
    assert not (tmp_path / "out" / "tracking").exists()
    (vhap / "empty").unlink()
    assert prepare(*arguments) == 0


def test_wrong_options_are_one_line_before_anything_is_written(video, vhap, network, tmp_path, capsys):
    out = tmp_path / "out"

    def refused(*options):
        message = refusal(capsys, video, "--out", out, *options)
        assert not out.exists()
        return message

    assert "--size: expected at least 16 pixels, found 0" in refused("--size", 0)
    assert "--fps" in refused("--fps", "nan")
    assert "--fps" in refused("--fps", 0)
    assert f"{WIDTH} x {HEIGHT}" in refused("--crop", f"0,0,{HEIGHT + 1}")
    assert "X,Y,SIDE" in refused("--crop", "all")
    assert "--mattes" in refused("--mattes", tmp_path / "none")
    assert "--albedo" in refused("--albedo", video)
    assert "no vhap/track.py in it" in refused("--vhap", tmp_path)
    assert "no command" in refused("--vhap", vhap, "--vhap-python", "no-such-python -u")
    assert "--vhap-python" in refused("--vhap", vhap, "--vhap-python", "")
    assert "--vhap-python" in refused("--vhap", vhap, "--vhap-python", "'unended")
    (tmp_path / "broken.mp4").write_bytes(video.read_bytes()[:2000])
    assert "broken.mp4: expected a video" in refusal(capsys, tmp_path / "broken.mp4", "--out", out)
    assert "none.mp4: expected a video file, found no such file" in refusal(
        capsys, tmp_path / "none.mp4", "--out", out
    )
    assert not out.exists()


def test_a_folder_of_other_things_is_left_alone(video, network, tmp_path, capsys):
    (tmp_path / "out" / "dataset").mkdir(parents=True)
    (tmp_path / "out" / "dataset" / "precious").write_text("mine")
    assert "dataset of another origin" in refusal(capsys, video, "--out", tmp_path / "out")
    assert (tmp_path / "out" / "dataset" / "precious").read_text() == "mine"
    assert "found a file" in refusal(capsys, video, "--out", video)


def test_a_video_without_anybody_in_its_mattes_is_refused(
    video, vhap, network, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(
        matting,
        "load_matting",
        lambda device: lambda picture, state: (np.zeros(picture.shape[:2], np.float32), state),
    )
    out, options = tmp_path / "out", vhap_options(vhap)
    assert "found nobody, by its mattes" in refusal(capsys, video, "--out", out, *options)


def test_albedo_of_other_frames_is_refused(video, vhap, network, albedo, tmp_path, capsys):
    out = tmp_path / "out"
    assert prepare(video, "--out", out, *vhap_options(vhap), *CROP, "--albedo", albedo) == 0
    others = shutil.copytree(albedo, tmp_path / "others")
    for path in others.iterdir():
        path.rename(others / f"another {path.name}")
    message = refusal(capsys, video, "--out", out, "--albedo", others)
    assert "00000_00.png or 000000.png, found 4 pictures of other names" in message
    assert len(list((out / "dataset" / "albedo").iterdir())) == 4, "what was there stays"
    wide = tmp_path / "wide"
    wide.mkdir()
    write_png(wide / "000000.png", np.zeros((8, 16, 3)))
    assert "found 16 x 8" in refusal(capsys, video, "--out", out, "--albedo", wide)


def test_the_last_line_of_a_log_is_what_a_progress_bar_left(tmp_path):
    log = tmp_path / "log"
    for text, last in (
        ("", ""),
        ("a\nb\n", "b"),
        ("a\n 10%\r 20%\r", "20%"),
        ("x" * 9000 + "\nend \n\n", "end"),
    ):
        log.write_text(text)
        assert tracking._last_line(log) == last
