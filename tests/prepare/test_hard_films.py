"""Films that have no face, more than one, cuts, gaps, or nothing that moves."""

import json
import time

import films
import numpy as np
import pytest
from PIL import Image
from test_own_tracker import POINTS, tracked_pixels
from test_prepare import command, prepare, refusal, tree

from samira_warp.prepare import run as module
from samira_warp.prepare.faces import LONGEST_GAP
from samira_warp.support.errors import UserError
from samira_warp.tracker import render_fit


@pytest.fixture
def not_tracked(monkeypatch):
    """Ends a preparation where tracking begins; what would have been tracked."""
    asked = []

    def end(template, filmed, faces, folder, *, kept, say):
        asked.append((filmed, faces))
        raise UserError("tracking", expected="to be asked for", found="this test")

    monkeypatch.setattr(module, "track_film", end)
    return asked


def noise(count=6, size=(160, 240)):
    generator = np.random.default_rng(0)
    room = generator.integers(80, 160, (*size, 3), dtype=np.uint8)
    return [np.roll(room, 3 * number, axis=1) for number in range(count)]


def shrunk(picture, side, *, width=films.WIDTH, height=films.HEIGHT):
    """The subject's picture, so many pixels wide, before the backdrop."""
    canvas = np.tile(np.rint(255.0 * films.BACKDROP).astype(np.uint8), (height, width, 1))
    canvas[height - side :, 40 : 40 + side] = np.asarray(Image.fromarray(picture).resize((side, side)))
    return canvas


def elsewhere(picture):
    """The subject in another room, where it stands on the other side."""
    canvas = films.placed(picture)[:, ::-1].astype(int)
    backdrop = np.abs(canvas - 255.0 * films.BACKDROP).max(axis=2, keepdims=True) < 3
    return np.where(backdrop, (150, 40, 30), canvas).astype(np.uint8)


def black():
    return np.zeros((films.HEIGHT, films.WIDTH, 3), np.uint8)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "webp"])
def test_a_photograph_is_no_video(tmp_path, capsys, suffix):
    path = tmp_path / f"me.{suffix}"
    Image.fromarray(noise(1)[0]).save(path)
    message = refusal(capsys, path, "--out", tmp_path / "out")
    assert message == f"error: {path}: expected a video, found a picture, in which nothing moves"
    assert not (tmp_path / "out").exists()


def test_a_film_of_nobody(track_networks, tmp_path, capsys):
    """As a user types it."""
    path = films.write_film(tmp_path / "room.mp4", noise())
    begun = command(path, "--out", tmp_path / "out")
    said = begun.communicate(timeout=200)[1]
    assert begun.returncode == 2
    assert "Traceback" not in said
    last = said.splitlines()[-1]
    assert last.startswith(f"error: {path}: expected a person, or --crop X,Y,SIDE, found nobody, by its face")
    assert "no face is found" in last
    assert {entry.name for entry in (tmp_path / "out").iterdir()} == {"stages"}
    last = refusal(capsys, path, "--out", tmp_path / "out", "--crop", "0,0,160")
    assert "expected a face in at least 2 frames, found 0 of 6: no face is found" in last
    assert not (tmp_path / "out" / "tracking").exists()
    assert not (tmp_path / "out" / "dataset").exists()


def test_a_face_of_forty_pixels(taken, tmp_path, capsys):
    pictures = [shrunk(picture, 96) for picture in taken.pictures[:4]]
    path = films.write_film(tmp_path / "far.mp4", pictures)
    message = refusal(capsys, path, "--out", tmp_path / "out")
    assert "pixels wide, which is less than 56" in message
    assert {entry.name for entry in (tmp_path / "out").iterdir()} == {"stages"}


def test_of_a_film_with_a_cut_the_longest_part_is_taken(taken, tmp_path, capsys, not_tracked):
    first = [elsewhere(picture) for picture in taken.pictures[:5]]
    then = [films.placed(picture) for picture in taken.pictures[5:15]]
    path = films.write_film(tmp_path / "cut.mp4", first + then)
    capsys.readouterr()
    assert prepare(path, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert "a cut, at 0.2 s: the longest part is taken, frames 5 to 14" in said
    assert "5 frames are left out: 5 for 'another part of the film', the first is 0" in said
    ((filmed, faces),) = not_tracked
    assert filmed.numbers == tuple(range(5, 15))
    assert len(filmed.pictures) == len(filmed.mattes) == len(faces.landmarks) == 10
    assert faces.seen.all()
    assert not (tmp_path / "out" / "tracking").exists()


def test_of_two_people_the_larger_is_followed(taken, tmp_path, capsys, not_tracked):
    cut = 80  # pixels at the left: the smaller face must fill a tenth of what the detector looks at

    def both(picture):
        canvas = np.tile(np.rint(255.0 * films.BACKDROP).astype(np.uint8), (films.HEIGHT, 560, 1))
        canvas[:, :400] = films.placed(picture)[:, cut : cut + 400]
        small = np.asarray(Image.fromarray(taken.pictures[0]).resize((150, 150)))
        canvas[films.HEIGHT - 150 :, 400:550] = small
        return canvas

    path = films.write_film(tmp_path / "two.mp4", [both(picture) for picture in taken.pictures[:4]])
    capsys.readouterr()
    assert prepare(path, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert "4 of 4 pictures that were looked at show several faces: the largest is taken" in said
    ((filmed, faces),) = not_tracked
    x, _, side = json.loads((tmp_path / "out" / "stages" / "crop.json").read_text())["result"]["crop"]
    middle = faces.landmarks[..., 0].mean() * side / filmed.view.width + x
    assert films.LEFT - cut < middle < films.LEFT - cut + films.SIZE


def test_a_long_gap_is_left_out_by_name(taken, tmp_path, capsys, not_tracked):
    """At ten frames a second half a second is five of them."""
    rate = 10
    longest = round(LONGEST_GAP * rate)
    shown = [films.placed(picture) for picture in taken.pictures[:12]]
    pictures = [*shown[:4], *[black()] * longest, *shown[4:8], *[black()] * (longest + 1), *shown[8:]]
    path = films.write_film(tmp_path / "gaps.mp4", pictures, rate=rate)
    capsys.readouterr()
    assert prepare(path, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    ((filmed, faces),) = not_tracked
    gone = range(4 + longest + 4, 4 + longest + 4 + longest + 1)
    assert filmed.numbers == tuple(number for number in range(len(pictures)) if number not in gone)
    assert set(filmed.left_out) == set(gone)
    assert f"{longest + 1} frames are left out: {longest + 1} for 'no face is found'" in said
    assert f"the first is {gone.start}" in said
    assert (~faces.seen).sum() == longest


@pytest.fixture(scope="module")
def few_steps():
    """The subject rendered for fewer steps than it is: how well it is found is tests/tracker's matter."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render_fit, "LEVELS", films.FEW_STEPS)
        yield


@pytest.fixture(scope="module")
def covered(taken, few_steps, tmp_path_factory):
    """A film whose lens is covered for two pictures, tracked; and which they are."""
    gap = (6, 7)
    pictures = [films.placed(picture) for picture in taken.pictures[:12]]
    for number in gap:
        pictures[number] = black()
    folder = tmp_path_factory.mktemp("covered")
    path = films.write_film(folder / "covered.mp4", pictures)
    assert prepare(path, "--out", folder / "out") == 0
    return folder / "out", gap


def test_a_short_gap_is_interpolated(covered, taken):
    """Between frames in which the head turns by a few pixels it is where they are, halfway."""
    out, gap = covered
    facts = json.loads((out / "tracking" / "tracking.json").read_text())
    assert facts["frames"] == 12
    assert facts["left_out"] == {}
    for stage in ("landmarks", "pixels"):
        missing = [
            number for number, error in enumerate(facts["error_pixels"][stage]["by_frame"]) if error is None
        ]
        assert missing == list(gap)
    face = taken.template.masks["face"][:: len(taken.template.masks["face"]) // POINTS]
    apart = np.linalg.norm(tracked_pixels(out)[:, face] - taken.pixels[:12][:, face], axis=-1)
    others = [number for number in range(12) if number not in gap]
    assert np.median(apart[others]) < films.BIAS
    assert np.median(apart[list(gap)], axis=1).max() < 6.0


def test_a_killed_run_goes_on_to_the_same_bytes(covered, tmp_path):
    """Killed in the middle of the mattes, when the faces are known; another process goes on."""
    whole, _ = covered
    film, out = whole.parent / "covered.mp4", tmp_path / "out"
    begun = command(film, "--out", out)
    deadline = time.monotonic() + 300
    while len(list((out / "film" / "alpha_maps").glob("*.jpg"))) < 3:
        assert time.monotonic() < deadline
        assert begun.poll() is None, begun.communicate()[1]
        time.sleep(0.02)
    begun.kill()
    begun.communicate()
    faces = (out / "film" / "faces.npz").stat().st_mtime_ns
    assert not (out / "tracking").exists()
    assert prepare(film, "--out", out) == 0
    assert (out / "film" / "faces.npz").stat().st_mtime_ns == faces
    for folder in ("film", "tracking", "dataset"):
        assert tree(out / folder) == tree(whole / folder)


def test_a_film_in_which_nothing_moves_is_tracked(taken, few_steps, tmp_path, capsys):
    path = films.write_film(tmp_path / "still.mp4", [films.placed(taken.pictures[0])] * 6)
    capsys.readouterr()
    assert prepare(path, "--out", tmp_path / "out") == 0
    said = capsys.readouterr().err
    assert "Warning" not in said
    face = taken.template.masks["face"][:: len(taken.template.masks["face"]) // POINTS]
    pixels = tracked_pixels(tmp_path / "out")[:, face]
    assert np.median(np.linalg.norm(pixels - taken.pixels[0][face], axis=-1)) < 2.0
    assert np.abs(pixels - pixels[0]).max() < 0.5
