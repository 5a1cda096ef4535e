"""Motion that the template has no shapes for: what it is a function of, and that the film has it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from samira_subject.cast import build_cast
from samira_subject.hidden_motion import hidden_motion
from samira_subject.lights import built_in_light
from samira_subject.make import make_subject
from samira_subject.performance import perform
from samira_subject.plan import SubjectPlan
from samira_subject.raycaster import Effort
from samira_subject.studio import Cast
from samira_warp.head import Rig
from samira_warp.io.images import read_image

PLAN = SubjectPlan(train=8, test=2, relit=0, size=48, texels=128, effort=Effort(2, 1, 1, 1, 1), orbit=())


@pytest.fixture(scope="module")
def cast():
    return build_cast(0, texels=128, hidden=True)


@pytest.fixture(scope="module")
def played(cast):
    return perform(cast.template.expression_names, train=160, test=40, seed=0, quick_tilts=True)


def test_a_head_at_rest_stays_where_it_is(cast):
    rig = Rig.build(cast.template)
    assert (cast.hidden.displacement(rig.rest()) == 0).all()


def test_shapes_of_the_template_do_not_make_it(cast, played):
    """Nor turns of its joints, nor all together as they fit each frame best."""
    rig, hidden = Rig.build(cast.template), cast.hidden
    rest = rig.rest()
    at_rest = rig.pose(rest, cast.identity).vertices
    columns = []
    for index in range(rest.expression.numel()):
        moved = replace(rest, expression=torch.eye(rest.expression.numel())[index])
        columns.append((rig.pose(moved, cast.identity).vertices - at_rest).flatten())
    for joint in range(len(rest.rotations)):
        for axis in range(3):
            rotations = rest.rotations.clone()
            rotations[joint, axis] = 0.01
            moved = rig.pose(replace(rest, rotations=rotations), cast.identity).vertices
            columns.append((moved - at_rest).flatten() / 0.01)
    for axis in range(3):
        columns.append(torch.eye(3)[axis].expand_as(at_rest).flatten())
    basis, _ = torch.linalg.qr(torch.stack(columns, dim=1).double())
    frames = [played.frame(index) for index in range(0, 200, 10)]
    motions = torch.stack([hidden.displacement(frame).flatten() for frame in frames]).double()
    explained = (motions @ basis).square().sum() / motions.square().sum()
    # hair that lags is a little like a neck that turns less, and collars like one that turns more
    assert explained < 0.45


def test_the_sway_does_not_tell_the_tilt(cast, played):
    """As it does by chance in the usual film, where the tilt is slow."""

    def told(film):
        frames = [film.frame(index) for index in range(160)]
        tilt = torch.stack([f.rotations[0, 2] + f.rotations[1, 2] for f in frames])
        sway = torch.stack([f.translation for f in frames]).T
        return torch.corrcoef(torch.cat([tilt[None], sway]))[0, 1:].abs().max()

    usual = perform(cast.template.expression_names, train=160, test=40, seed=0)
    assert told(played) < 0.2 < 0.5 < told(usual)


def test_it_turns_with_the_head(cast, played):
    rig, frame = Rig.build(cast.template), played.frame(100)
    turn = Rotation.from_rotvec([0.0, 0.3, 0.1])
    root = torch.from_numpy((turn * Rotation.from_rotvec(frame.rotations[0].double().numpy())).as_rotvec())
    turned = replace(frame, rotations=torch.cat([root.float()[None], frame.rotations[1:]]))
    still = replace(cast.hidden, turn=torch.zeros_like(cast.hidden.turn))
    before = still.in_world(frame, rig.pose(frame, cast.identity))
    after = still.in_world(turned, rig.pose(turned, cast.identity))
    assert before.abs().max() > 1e-4
    # float32 rotations of millimetres
    torch.testing.assert_close(
        after, before @ torch.from_numpy(turn.as_matrix()).float().T, rtol=0, atol=1e-8
    )


def test_cheeks_bulge_by_the_square_of_a_smile(cast):
    names, hidden = cast.template.expression_names, cast.hidden
    rest = Rig.build(cast.template).rest()
    expression = torch.zeros_like(rest.expression)
    expression[names.index("mouthSmile_L")] = 0.5
    moved = hidden.displacement(replace(rest, expression=expression))
    whole = hidden.directions[hidden.parts.index("cheek_L")]
    torch.testing.assert_close(moved, 0.25 * whole)
    assert cast.template.v_template[int(whole.norm(dim=1).argmax()), 0] > 0.02


@pytest.fixture(scope="module")
def films(cast, tmp_path_factory):
    """The same film with hidden motion and without."""
    folder, lights = tmp_path_factory.mktemp("films"), [built_in_light(name) for name in PLAN.lights]
    still = Cast(cast.template, cast.identity, cast.materials)
    plan = replace(PLAN, hidden=True)
    make_subject(folder / "still", plan, lambda: still, lights)
    make_subject(folder / "moving", plan, lambda: cast, lights)
    return folder


def test_pictures_move_as_the_truth_says_and_tracks_do_not(films, cast):
    truth = np.load(films / "moving" / "gt" / "hidden_motion.npz")["displacement"]
    assert truth.shape == (10, len(cast.template.v_template), 3)
    assert not (films / "still" / "gt" / "hidden_motion.npz").exists()
    # the first frame is at rest
    assert np.abs(truth[0]).max() < 1e-9 < 1e-3 < np.linalg.norm(truth[7], axis=1).max()
    for index, moved in ((0, False), (7, True)):
        tracks = [np.load(films / film / "flame_param" / f"{index:05d}.npz") for film in ("still", "moving")]
        assert all(np.array_equal(tracks[0][name], tracks[1][name]) for name in tracks[0].files)
        pictures = [
            read_image(films / film / "images" / f"{index:05d}_00.png", channels=3)
            for film in ("still", "moving")
        ]
        assert np.array_equal(*pictures) is not moved


def test_the_truth_is_the_displacement_of_the_posed_vertices(films, cast):
    played = perform(
        cast.template.expression_names, train=PLAN.train, test=PLAN.test, seed=PLAN.seed, quick_tilts=True
    )
    truth = np.load(films / "moving" / "gt" / "hidden_motion.npz")["displacement"]
    rig, frame = Rig.build(cast.template), played.frame(7)
    hidden = hidden_motion(cast.template)
    expected = hidden.in_world(frame, rig.pose(frame, cast.identity))
    assert np.array_equal(truth[7], expected.numpy())
