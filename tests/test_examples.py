"""Every program of examples/, run as a user runs it, and what it wrote."""

import subprocess

import numpy as np
import pytest
from data.built_in import built_in_film, for_layout
from data.layouts import write_layout
from subjects import TESTS
from warm_start import warm_python

from samira_subject.head import build_head
from samira_warp.head import save_template
from samira_warp.io.images import read_image

EXAMPLES = TESTS.parent / "examples"


def run_example(name, *options, folder):
    """The program in a process of its own, whose working directory is not the repository."""
    command = [*warm_python(), str(EXAMPLES / name), *map(str, options)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr


def pictures_in(folder):
    return {path.stem: read_image(path, channels=3) for path in sorted(folder.glob("*.png"))}


def linear(display):
    """IEC 61966-2-1, written out: what the package encodes with is not used to check it."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def test_every_example_is_run_here():
    run_here = {"train_and_relight.py", "light_rig.py", "drive_by_another.py"}
    assert {path.name for path in EXAMPLES.glob("*.py")} == run_here


def test_train_and_relight(built_in_datasets, tmp_path):
    run_example(
        "train_and_relight.py",
        *("--data", built_in_datasets["VHAP export"], "--out", "run"),
        *("--max-steps", 6, "--resolution", 64, "--gaussians", 3000),
        folder=tmp_path,
    )
    assert (tmp_path / "run" / "avatar" / "avatar.safetensors").is_file()
    sheet = read_image(tmp_path / "run" / "relit.png", channels=3)
    # three pictures of the frame itself, and one under each of the three lights: two rows of three
    rows, columns = (size // 64 for size in sheet.shape[:2])
    assert (rows, columns) == (2, 3)
    cells = [np.array_split(row, 3, axis=1) for row in np.array_split(sheet, 2, axis=0)]
    flat = [cell for row in cells for cell in row]
    for index, one in enumerate(flat):
        assert one.std() > 0.02
        for other in flat[index + 1 :]:
            height, width = (min(one.shape[axis], other.shape[axis]) for axis in (0, 1))
            assert np.abs(one[:height, :width] - other[:height, :width]).max() > 0.1


@pytest.fixture(scope="module")
def rig(built_in_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    run_example("light_rig.py", "--avatar", built_in_run, "--out", "rig", folder=folder)
    return pictures_in(folder / "rig")


def test_a_light_rig_is_shown_under_every_light(rig):
    turned, exposed = ("turned_90", "turned_180", "turned_270"), ("stops_-1", "stops_1")
    assert set(rig) == {"key", "fill", "rim", "all", *turned, *exposed, "sheet"}
    for name in ("key", "fill", "all", *turned):
        assert rig[name].max() > 0.2, name
        assert rig[name][0, 0].max() == 0.0, name


def test_the_lamps_of_a_rig_add_up(rig):
    together = linear(rig["all"])
    lamps = sum(linear(rig[name]) for name in ("key", "fill", "rim"))
    shown = (together > 0.01) & (together < 0.95)
    # Three pictures of 8 bits: half a level each, which is 0.2 % of a display's white in linear light at its
    # steepest (d linear / d display is 2.3 at white); the head's edge, where the black behind it is mixed in
    # after encoding, is a small share of the pixels.
    assert np.median(np.abs(together - lamps)[shown]) < 4 * 0.5 / 255 * 2.3


def test_a_stop_doubles_the_light(rig):
    once, half = linear(rig["all"]), linear(rig["stops_-1"])
    shown = (once > 0.05) & (once < 0.95)
    assert np.median(once[shown] / half[shown]) == pytest.approx(2.0, rel=0.03)


def test_the_rig_lights_the_side_that_it_is_turned_to(rig):
    """The key stands to the subject's left, which is the picture's right; half a turn takes it behind."""
    _, width, _ = rig["key"].shape
    left, right = rig["key"][:, : width // 2].mean(), rig["key"][:, width // 2 :].mean()
    assert right > 1.2 * left
    assert psnr_of(rig["turned_180"], rig["all"]) < 30


def psnr_of(one, other):
    return -10 * np.log10(np.mean((one - other) ** 2))


@pytest.fixture
def another_person(tmp_path):
    folder = tmp_path / "somebody else"
    write_layout("VHAP export", for_layout("VHAP export", built_in_film(1)), folder)
    save_template(build_head().template, folder / "template.npz")
    return folder


def test_drive_by_another(built_in_run, another_person, tmp_path):
    run_example(
        "drive_by_another.py",
        *("--avatar", built_in_run, "--data", another_person, "--out", "driven", "--resolution", 64),
        *("--every", 4),
        folder=tmp_path,
    )
    pictures = pictures_in(tmp_path / "driven")
    assert sorted(pictures) == ["00000", "00004"]
    for picture in pictures.values():
        assert picture.shape == (64, 128, 3)
        # heads of two people at one place before one camera, each on white
        filmed, driven = ((half < 0.98).any(axis=-1) for half in (picture[:, :64], picture[:, 64:]))
        assert (filmed & driven).sum() > 0.7 * filmed.sum()
    assert psnr_of(*(picture[:, 64:] for picture in pictures.values())) < 40
