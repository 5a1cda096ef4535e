"""The usual mistakes, each made in a dataset without fault: the check says that one and nothing else."""

import json
import shutil

import numpy as np
import pytest
from data.damage import change_arrays, change_json
from data.layouts import FLIP, make_film, write_layout
from data.tiny import N_SHAPE, make_tiny_dataset, tiny_template
from PIL import Image

from samira_warp.check.report import check_dataset
from samira_warp.io.images import read_image, write_png

LISTS = ("transforms.json", "transforms_train.json", "transforms_test.json")


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    return make_tiny_dataset(
        tmp_path_factory.mktemp("good") / "subject", frames=6, size=64, static_offset=True
    )


@pytest.fixture
def dataset(original, tmp_path):
    return shutil.copytree(original, tmp_path / "subject")


def entries(change):
    """Change every entry of every list; what a list states for all frames goes."""

    def of_document(document):
        for key in ("fl_x", "fl_y", "cx", "cy"):
            document.pop(key, None)
        for entry in document["frames"]:
            change(entry)

    return lambda root: [change_json(root / name, of_document) for name in LISTS]


def poses(change):
    return entries(
        lambda entry: entry.update(transform_matrix=change(np.array(entry["transform_matrix"])).tolist())
    )


def parameters(**changes):
    return lambda root: [
        change_arrays(path, **changes)
        for path in (*root.glob("flame_param/*"), root / "canonical_flame_param.npz")
    ]


def template(**changes):
    return lambda root: change_arrays(root / "template.npz", **changes)


def pictures(folder, change):
    return lambda root: [
        write_png(path, change(read_image(path, channels=3))) for path in (root / folder).iterdir()
    ]


def times(factor):
    return lambda array: array * np.asarray(factor, array.dtype)


def torn(offset):
    return np.random.default_rng(0).normal(scale=0.03, size=offset.shape).astype(np.float32)


def moved(matrix, *, by):
    return matrix + by * (np.arange(4) == 3)[None] * (np.arange(4) < 3)[:, None]


def shorter(entry, *, by):
    entry["camera_angle_x"] = 1.0
    for key in ("fl_x", "fl_y", "cx", "cy"):
        entry[key] /= by


def upside_down(root):
    """Everything but what the tracker wrote."""
    for folder in ("images", "fg_masks", "albedo"):
        pictures(folder, lambda pixels: pixels[::-1, ::-1])(root)


LARGE = {"v_template": times(4), "shapedirs": times(4), "posedirs": times(4)}
# how it is broken, severity, what the line names, and what it says
MISTAKES = {
    "OpenCV's axes": (
        poses(lambda m: m @ FLIP), "fault", "transforms_*.json: poses", "behind in 6 of 6",
        "OpenCV's for OpenGL's",
    ),
    "inverted matrices": (
        poses(np.linalg.inv), "fault", "transforms_*.json: poses", "behind in 6 of 6", "write their inverses",
    ),
    "a camera that looks away": (
        poses(lambda m: m @ np.diag([-1.0, 1.0, -1.0, 1.0])), "fault", "transforms_*.json: poses",
        "behind in 6 of 6", "the other way",
    ),
    "a head upside down": (
        poses(lambda m: m @ np.diag([-1.0, -1.0, 1.0, 1.0])), "fault", "transforms_*.json: poses",
        "upside down in 6 of 6", "180 degrees",
    ),
    "a head outside": (
        poses(lambda m: moved(m, by=[[1.0], [0], [0], [0]])), "fault", "transforms_*.json",
        "outside in 6 of 6", "cropped",
    ),
    "a camera four times as far": (
        poses(lambda m: moved(m, by=[[0], [0], [3.0], [0]])), "fault", "flame_param",
        "a quarter as large in 6 of 6", "divide it by four",
    ),
    "a camera four times as near": (
        poses(lambda m: moved(m, by=[[0], [0], [-0.75], [0]])), "fault", "flame_param",
        "four times as large in 6 of 6", "metres",
    ),
    "a template four times as large": (
        template(**LARGE), "fault", "template.npz", "times too large", "divide lengths by",
    ),
    "faces that look inwards": (
        template(f=lambda f: f[:, ::-1].copy(), ft=lambda ft: ft[:, ::-1].copy()), "fault",
        "template.npz", "inside out", "swap two corners",
    ),
    "an identity of another model": (
        parameters(shape=lambda shape: np.array([80.0, 0.0], np.float32)), "fault", "flame_param",
        "times too large", "--flame",
    ),
    "offsets of another model": (
        parameters(static_offset=torn), "fault", "flame_param", "one torn", "--flame",
    ),
    "a focal length as a share": (
        entries(lambda e: shorter(e, by=64)), "fault", "transforms_*.json: intrinsics", "2.8 and", "pixels",
    ),
    "a focal length times the width": (
        entries(lambda e: e.update(fl_x=64 * e["fl_x"], fl_y=64 * e["fl_y"])), "fault", "intrinsics",
        "1.147e+04", "divide it by the width",
    ),
    "a centre as a share": (
        entries(lambda e: e.update(cx=0.5, cy=0.5)), "fault", "intrinsics", "a centre of (0.5, 0.5)",
        "in pixels",
    ),
    "inverted masks": (
        pictures("fg_masks", lambda mask: 1 - mask), "fault", "fg_masks", "black on it in 6 of 6",
        "invert the masks",
    ),
    "masks of elsewhere": (
        pictures("fg_masks", lambda mask: np.roll(mask, 30, axis=1)), "warning", "fg_masks",
        "beside it in 6 of 6", "contact sheet",
    ),
}  # fmt: skip


def said(root, **options):
    return check_dataset(root, **{"quick": True, **options}).findings


def test_a_dataset_without_fault(dataset):
    assert said(dataset, quick=False) == ()


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_said_and_nothing_else(dataset, name):
    damage, severity, subject, found, remedy = MISTAKES[name]
    damage(dataset)
    (finding,) = said(dataset)
    assert finding.severity == severity
    assert subject in finding.subject
    assert found in finding.found
    assert remedy in finding.remedy
    assert "\n" not in str(finding)


def test_pictures_turned_after_tracking(dataset):
    """The head is above the middle: turned pictures have it below."""
    poses(lambda m: moved(m, by=[[0], [-0.09], [0], [0]]))(dataset)
    shift = round(0.09 * 2.8 * 64)
    for folder in ("images", "fg_masks", "albedo"):
        pictures(
            folder, lambda pixels: np.concatenate([pixels[shift:], np.repeat(pixels[-1:], shift, axis=0)])
        )(dataset)
    assert said(dataset) == ()
    upside_down(dataset)
    (finding,) = said(dataset)
    assert (finding.severity, finding.remedy) == (
        "fault",
        "turn the pictures as they were when they were tracked",
    )


def test_without_masks_a_head_far_away_is_a_warning(dataset):
    entries(lambda entry: entry.pop("fg_mask_path"))(dataset)
    shutil.rmtree(dataset / "albedo")  # which nothing would mask either: a warning of its own
    assert said(dataset) == ()
    poses(lambda m: moved(m, by=[[0], [0], [3.5], [0]]))(dataset)
    (finding,) = said(dataset)
    assert finding.severity == "warning"
    assert "times its height" in finding.found


def test_a_person_to_the_waist_is_no_mistake(dataset):
    """Masks hold hair and shoulders as well."""

    def with_shoulders(mask):
        mask[40:] = 1
        return np.maximum(mask, np.roll(mask, -5, axis=0))

    pictures("fg_masks", with_shoulders)(dataset)
    assert said(dataset) == ()


def test_a_minority_of_bad_masks_is_no_mistake_of_the_dataset(dataset):
    path = dataset / "fg_masks" / "00000_00.png"
    write_png(path, 1 - read_image(path, channels=3))
    assert said(dataset) == ()


@pytest.mark.parametrize("count", [N_SHAPE - 1, N_SHAPE + 1])
def test_a_head_model_other_than_the_trackers(dataset, count):
    template(
        shapedirs=lambda a: np.concatenate([a[..., :1]] * count + [a[..., N_SHAPE:]], axis=2),
        n_shape=np.int64(count),
    )(dataset)
    (finding,) = said(dataset)
    assert finding.subject.endswith("canonical_flame_param.npz: shape")
    assert "--flame" in finding.remedy


def film_of(layout, root, **options):
    """A film without motion of camera or head beyond what the layout's masks, discs in the middle, allow
    for."""
    film = make_film(square_pixels=True, **options)
    film.rotation[:] = film.neck[:] = film.translation[:] = 0
    film.center[:] = np.array([film.width, film.height]) / 2
    film.focal[:] = film.focal[0, 0]
    root = write_layout(layout, film, root)
    np.savez(root / "template.npz", **tiny_template())
    return root


LAYOUTS = ["VHAP export", "VHAP tracked", "metrical-tracker", "HRAvatar v1", "HRAvatar v2", "IMavatar"]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_films_of_every_layout_have_no_fault(tmp_path, layout):
    assert said(film_of(layout, tmp_path / "subject"), quick=False) == ()


def test_hravatars_versions_taken_for_each_other(tmp_path):
    old = film_of("HRAvatar v1", tmp_path / "old")
    (old / "tracked_params.json").rename(old / "tracked_params_v2.json")
    (finding,) = said(old)
    assert finding.subject == str(old / "tracked_params_v2.json")
    assert "a quarter as large" in finding.found
    new = film_of("HRAvatar v2", tmp_path / "new")
    (new / "tracked_params_v2.json").rename(new / "tracked_params.json")
    (finding,) = said(new)
    assert "four times as large" in finding.found


def test_a_focal_length_as_a_share_beside_a_centre_in_pixels(tmp_path):
    root = film_of("HRAvatar v2", tmp_path / "subject")
    change_json(root / "tracked_params_v2.json", lambda d: d.update(intrinsics=[2.8, 2.8, 20.0, 16.0]))
    (finding,) = said(root)
    assert finding.subject == f"{root / 'tracked_params_v2.json'}: intrinsics"


def test_pixels_where_a_share_belongs(tmp_path):
    root = film_of("VHAP tracked", tmp_path / "subject")
    change_arrays(root / "tracked_flame_params_30.npz", focal_length=np.array([112.0], np.float32))
    (finding,) = said(root)
    assert "divide it by the width" in finding.remedy


def test_pictures_without_frames_and_frames_without_parameters(dataset, tmp_path):
    Image.new("RGB", (64, 64)).save(dataset / "images" / "00009_00.png")
    (finding,) = said(dataset)
    assert (finding.severity, finding.subject) == ("warning", str(dataset / "images"))
    assert finding.found == "1 pictures that no list names, the first is 00009_00"
    (dataset / "flame_param" / "00001.npz").unlink()
    fault, _ = said(dataset)
    assert fault.subject == str(dataset / "flame_param" / "00001.npz")
    assert "take what names it out of the lists" in fault.remedy
    root = film_of("IMavatar", tmp_path / "film")
    change_json(root / "flame_params.json", lambda d: d["frames"].pop())
    report = check_dataset(root, quick=True)
    assert report.findings == ()
    assert any("1 pictures of image have no tracked parameters" in note for note in report.notes)


def test_an_empty_mask(dataset):
    write_png(dataset / "fg_masks" / "00002_00.png", np.zeros((64, 64)))
    (finding,) = said(dataset, quick=False)
    assert (finding.severity, finding.subject) == ("warning", str(dataset / "fg_masks" / "00002_00.png"))


def test_the_real_subject_has_no_fault(subject):
    report = check_dataset(subject, quick=True)
    assert report.findings == ()
    assert json.loads(report.json())["trainable"]
