"""What another rendering left in an output folder."""

import pytest

from samira_warp.render.writing import left_over


@pytest.fixture
def out(tmp_path):
    for name in ("image/a.png", "image/b.png", "depth/a.png", "depth/a.exr", "image.mp4", "depth.mp4"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    for mine in ("image/a.txt", "other/a.png", "film.mp4", "a.png"):
        (tmp_path / mine).parent.mkdir(exist_ok=True)
        (tmp_path / mine).touch()
    return tmp_path


@pytest.mark.parametrize(
    ("names", "layers", "films", "stay"),
    [
        (["a", "b"], ["image", "depth"], True, []),
        (["a", "b"], ["image", "depth"], False, ["depth.mp4", "image.mp4"]),
        (["a"], ["image", "depth"], True, ["image/b.png"]),
        (["b"], ["depth"], True, ["depth/a.exr", "depth/a.png", "image/a.png", "image/b.png", "image.mp4"]),
    ],
)
def test_pictures_and_films_that_stay(out, names, layers, films, stay):
    found = left_over(out, names, layers=layers, films=films)
    assert [path.relative_to(out).as_posix() for path in found] == stay


def test_nothing_is_left_where_nothing_is(tmp_path):
    assert left_over(tmp_path / "new", ["a"], layers=["image"], films=True) == []
