"""From FLAME's own files and a tracker's folder to an avatar, with nothing of this project's in between."""

import numpy as np
import pytest
import torch
from data.flame_files import N_EXPRESSION, write_flame
from data.layouts import make_film_for, write_layout
from subjects import train_arguments, train_command

from samira_warp.data import open_sequence
from samira_warp.head import Rig
from samira_warp.head.flame import FLAME_IDENTITY, FLAME_VERTICES
from samira_warp.head.teeth import TEETH_VERTICES


@pytest.fixture(scope="module")
def flame(tmp_path_factory):
    return write_flame(tmp_path_factory.mktemp("flame"), eyelids=True)


def film_of(layout, **sizes):
    film = make_film_for(layout, **({"n_shape": FLAME_IDENTITY, "n_expression": N_EXPRESSION} | sizes))
    film.shape *= 0.1
    return film


@pytest.mark.parametrize("rows", [FLAME_VERTICES, FLAME_VERTICES + TEETH_VERTICES])
def test_a_static_offset_fits_with_and_without_teeth(tmp_path, flame, rows):
    """GaussianAvatars' and VHAP's have rows for the teeth; FLAME alone has none. There are no eyelids in an
    export."""
    film = film_of("VHAP export")
    film.static_offset = 1e-3 * np.random.default_rng(0).normal(size=(rows, 3))
    write_layout("VHAP export", film, tmp_path / "subject")
    sequence = open_sequence(tmp_path / "subject", flame=flame)
    offset = sequence.static_offset
    assert offset.shape == (FLAME_VERTICES + TEETH_VERTICES, 3)
    np.testing.assert_allclose(offset[:rows].numpy(), film.static_offset, atol=1e-8)
    assert not offset[rows:].any()
    for frame, expression in zip(sequence.frames, film.expression, strict=True):
        np.testing.assert_allclose(frame.parameters.expression.numpy(), [*expression, 0, 0], atol=1e-6)


def test_trackers_of_fewer_shapes_and_eyelids(tmp_path, flame):
    """DECA's followers take 100 identity and 50 expression shapes; eyelids come after FLAME's own 100."""
    film = film_of("HRAvatar v1", n_shape=100, n_expression=50)
    write_layout("HRAvatar v1", film, tmp_path / "subject")
    sequence = open_sequence(tmp_path / "subject", flame=flame)
    assert sequence.notes == (
        "the dataset has no division of its own: the first 70 % of its timesteps train",
    )
    np.testing.assert_allclose(sequence.shape.numpy(), np.pad(film.shape, (0, 200)), atol=1e-6)
    for row, frame in enumerate(sequence.frames):
        expected = np.concatenate([film.expression[row], np.zeros(50), film.eyelids[row]])
        np.testing.assert_allclose(frame.parameters.expression.numpy(), expected, atol=1e-6)
    rig = Rig.build(sequence.template)
    lids = sequence.template.shapedirs[:, :, -2:] @ film.eyelids[0]
    closed = rig.rest()
    closed.expression[-2:] = torch.from_numpy(film.eyelids[0])
    moved = (
        rig.pose(closed, sequence.shape).vertices - rig.pose(rig.rest(), sequence.shape).vertices
    ).numpy()
    np.testing.assert_allclose(moved, lids, atol=1e-6)


def test_one_command_trains(tmp_path, flame):
    write_layout("VHAP export", film_of("VHAP export", width=32, height=32), tmp_path / "subject")
    options = train_arguments(tmp_path / "subject", tmp_path / "run", "--flame", flame, "--max-steps", 2)
    assert train_command(*options) == 0
    assert (tmp_path / "run" / "avatar").is_dir()
