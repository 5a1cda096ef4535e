"""Following a face through films of the built-in subject's head, whose eyes are known, and of none."""

import numpy as np
import pytest
from portraits import CLOSED, OPEN, SIZE, pasted
from skimage.data import astronaut

from samira_warp.vision import find_cuts, follow_faces, longest_continuous, read_openness
from samira_warp.vision.crops import Square, cut
from samira_warp.vision.detector import detect_faces
from samira_warp.vision.face_shape import confidence, face_shape, facing, roll_of, yaw_of
from samira_warp.vision.mesh import POINTS, read_mesh, settle, square_about
from samira_warp.vision.openness import eye_openness, mouth_openness
from samira_warp.vision.runtime import Network
from samira_warp.vision.weights import FACE_MESH, read_network

MESH_UPPER_LID, MESH_LOWER_LID = ([386, 159], [374, 145])
MESH_EYE_CORNERS = ([263, 133], [362, 33])


@pytest.fixture(scope="module")
def heads(networks, portraits):
    """The track of all portraits as if they were a film of one shot."""
    return follow_faces([portraits[frame].picture for frame in OPEN + CLOSED], networks)


def seen_alone(picture, networks):
    return follow_faces([picture], networks)


def test_a_head_is_seen_and_its_numbers_have_the_shapes_that_are_said(heads):
    count = len(OPEN + CLOSED)
    assert heads.seen.all()
    assert heads.reasons == ("",) * count
    assert heads.landmarks.shape == (count, POINTS, 3)
    assert heads.irises.shape == (count, 2, 5, 2)
    assert heads.lids.shape == (count, 2, 16, 2)
    assert heads.landmarks.dtype == heads.irises.dtype == heads.lids.dtype == np.float32
    assert np.isfinite(heads.landmarks).all()
    assert (heads.presence > 0.99).all()
    assert set(heads.person) == {0}
    assert heads.notes == ()


def test_irises_are_where_the_eyes_are(heads, portraits):
    """The front of each eyeball is known; the network's own error is 0.9 pixels of these pictures."""
    found = heads.irises[: len(OPEN), :, 0]
    truth = np.stack([portraits[frame].corneas for frame in OPEN])
    apart = np.linalg.norm(found - truth, axis=-1)
    assert apart.mean() < 2.0
    assert apart.max() < 4.0
    assert (found[:, 0, 0] > found[:, 1, 0]).all()  # the subject's left eye comes first


def test_rims_go_round_outwards_first(heads):
    """Outer, upper, inner, lower: of the left eye outwards is to the right."""
    rim = heads.irises[0, :, 1:] - heads.irises[0, :, :1]
    assert rim[0, 0, 0] > 1 > -1 > rim[0, 2, 0]
    assert rim[1, 0, 0] < -1 < 1 < rim[1, 2, 0]
    assert (rim[:, 1, 1] < -1).all()
    assert (rim[:, 3, 1] > 1).all()


def test_lids_begin_at_the_inner_corner_and_the_lower_lid(heads):
    lids = heads.lids[0]
    middle = lids[:, 1:8].mean(axis=1), lids[:, 9:16].mean(axis=1)
    assert (middle[0][:, 1] > middle[1][:, 1] + 3).all()
    assert lids[0, 0, 0] < lids[0, 8, 0]  # the left eye's inner corner is on its left
    assert lids[1, 0, 0] > lids[1, 8, 0]
    assert (np.abs(lids[:, 1] - lids[:, 9])[:, 0] < 4).all()  # both lids go the same way


def test_pictures_that_are_their_own_mirror_image_are_read_about_their_middle(networks):
    """Halves of a photograph, each with its mirror image, cut in several places.

    They are, to a quarter of the network's 192 pixels; counted from corners, to three quarters.
    """
    photograph, whole, off = astronaut(), Square(96.0, 96.0, 192.0), []
    for x in np.arange(220.0, 228.0):
        seen = cut(photograph, Square(x, 121.0, 160.0), 192)
        for half in (seen[:, :96], seen[:, :95:-1]):
            symmetric = np.concatenate([half, half[:, ::-1]], axis=1)
            read = read_mesh(networks.mesh, symmetric, whole).landmarks[:, 0]
            off.append((read + read[face_shape().mirror]).mean() / 2 - 96.0)
    assert abs(np.mean(off)) < 0.5


def test_a_wrong_range_passes_the_score_and_moves_the_points(networks, portraits):
    wrong = Network(read_network(FACE_MESH), name="face_landmark", value_range=(-1.0, 1.0))
    for frame in OPEN:
        picture = portraits[frame].picture
        square = square_about(seen_alone(picture, networks).landmarks[0].astype(float))
        right, other = (read_mesh(network, picture, square) for network in (networks.mesh, wrong))
        assert other.presence > 0.999
        moved = np.linalg.norm((right.landmarks - other.landmarks)[:, :2], axis=1).mean()
        assert 0.3 < moved / square.side * 192 < 5.0


@pytest.mark.parametrize(("scale", "shift", "roll"), [(1.5, 0.0, 0.0), (0.6, 0.1, 0.0), (1.0, 0.3, 0.3)])
def test_a_square_that_is_off_settles_where_the_right_one_does(networks, portraits, scale, shift, roll):
    picture = portraits[0].picture
    landmarks = seen_alone(picture, networks).landmarks[0].astype(float)
    right = square_about(landmarks)
    off = Square(right.x + shift * right.side, right.y, scale * right.side, right.roll + roll)
    reading = settle(networks.mesh, picture, off)
    assert reading.settled
    apart = np.linalg.norm((reading.landmarks - landmarks)[:, :2], axis=1).mean()
    assert apart / right.side * 192 < 2.5


def test_nobody_is_nobody(networks):
    noise = np.random.default_rng(0).integers(0, 256, (120, 160, 3)).astype(np.uint8)
    track = follow_faces([noise, np.zeros_like(noise)], networks)
    assert not track.seen.any()
    assert set(track.reasons) == {"no face is found"}
    assert np.isnan(track.landmarks).all()
    assert np.isnan(track.irises).all()
    assert set(track.person) == {-1}
    assert longest_continuous(track.person, []) == slice(0, 0)


def test_an_empty_film_has_no_pictures(networks):
    track = follow_faces([], networks)
    assert track.landmarks.shape == (0, POINTS, 3)
    assert track.reasons == ()
    assert read_openness(track).eyes.shape == (0, 2)


def test_a_face_of_forty_pixels_is_too_small(networks, portraits):
    """Half of a portrait's width is its face."""
    track = seen_alone(pasted((portraits[0].picture, 100, 60, 80), width=320, height=240), networks)
    assert not track.seen[0]
    assert "pixels wide" in track.reasons[0]


@pytest.mark.parametrize("turns", [1, 2, 3])
@pytest.mark.parametrize("frame", OPEN)
def test_a_film_that_is_not_upright_is_refused_and_said_to_be(networks, portraits, turns, frame):
    turned = np.ascontiguousarray(np.rot90(portraits[frame].picture, turns))
    track = seen_alone(turned, networks)
    assert not track.seen[0]
    assert "rolled by" in track.reasons[0]
    assert np.isnan(track.landmarks).all()


def test_the_largest_of_several_is_followed_and_it_is_said(networks, portraits):
    crowd = pasted(
        (portraits[0].picture, 20, 10, 256), (portraits[47].picture, 300, 100, 140), width=460, height=280
    )
    track = follow_faces([crowd] * 3, networks)
    assert track.seen.all()
    assert (track.landmarks[..., 0] < 290).all()
    (note,) = track.notes
    assert "2 faces" in note


def test_who_is_followed_stays_so_until_a_much_larger_one_comes(networks, portraits):
    first, second = portraits[0].picture, portraits[47].picture
    alone = pasted((first, 20, 60, 180), width=520, height=280)
    hardly_larger = pasted((first, 20, 60, 180), (second, 240, 20, 220), width=520, height=280)
    much_larger = pasted((first, 20, 60, 130), (second, 220, 0, 280), width=520, height=280)
    track = follow_faces([alone] * 2 + [hardly_larger] * 12 + [much_larger] * 13, networks)
    assert (track.person[:14] == 0).all()
    assert track.person[-1] == 1
    assert track.landmarks[-1, :, 0].min() > 220
    assert longest_continuous(track.person, []).start == 0


def test_a_gap_is_named_and_the_same_person_goes_on(networks, portraits):
    picture = portraits[0].picture
    track = follow_faces([picture, np.full_like(picture, 255), np.full_like(picture, 255), picture], networks)
    assert track.seen.tolist() == [True, False, False, True]
    assert track.person.tolist() == [0, -1, -1, 0]
    assert np.isnan(track.landmarks[1:3]).all()
    assert longest_continuous(track.person, []) == slice(0, 4)


def test_a_still_photograph_stays_where_it_is(networks, portraits):
    """The first reading comes from the detector's square, the others from squares of readings."""
    track = follow_faces([portraits[17].picture] * 15, networks)
    assert track.seen.all()
    apart = np.linalg.norm((track.landmarks - track.landmarks[-1])[..., :2], axis=-1).mean(axis=1)
    apart *= 192 / square_about(track.landmarks[0].astype(float)).side
    assert apart[0] < 1.5
    assert apart[1:].max() < 0.5


def test_points_move_with_the_picture(networks, portraits):
    """Bytes moved by whole pixels are the same bytes: what is left is the squares' own rounding."""
    picture = portraits[17].picture
    places = [(30, 20), (34, 20), (38, 23), (42, 26)]
    film = [pasted((picture, x, y, SIZE), width=330, height=300) for x, y in places]
    track = follow_faces(film, networks)
    moved = (track.landmarks[..., :2] - np.array(places)[:, None]) - (track.landmarks[:1, :, :2] - places[0])
    assert np.linalg.norm(moved, axis=-1).mean(axis=1).max() < 0.8


def test_a_cut_is_found_and_the_longest_part_taken(networks, portraits):
    one = pasted((portraits[0].picture, 0, 0, 256), width=300, height=256)
    other = pasted((portraits[47].picture, 120, 60, 180), width=300, height=256, background=60)
    track = follow_faces([one] * 3 + [other] * 5, networks)
    cuts = find_cuts(track.colours, track.landmarks)
    assert cuts == [3]
    assert longest_continuous(track.person, cuts) == slice(3, 8)


def test_small_faces_of_large_pictures_are_found(networks, portraits):
    """A face of 90 in 1,200 pixels is 10 of the detector's 128."""
    far = pasted((portraits[0].picture, 900, 300, 190), width=1200, height=700)
    (face,) = detect_faces(networks.detector, far)
    assert 900 < face.box[0] < face.box[2] < 1090
    assert seen_alone(far, networks).seen[0]


def test_turned_heads_are_said_to_be(heads):
    """Frames 47 and 70 are turned by 23 degrees to one side and 30 to the other, frame 0 not at all."""
    front, _, right, left = (yaw_of(points.astype(float)) for points in heads.landmarks[: len(OPEN)])
    assert abs(np.degrees(front)) < 6
    assert 12 < np.degrees(right) < 35
    assert -42 < np.degrees(left) < -18
    assert abs(np.degrees(roll_of(heads.landmarks[0]))) < 3


def test_the_far_side_is_believed_less(heads):
    """Cheeks: 234 on the right side of the head, 454 on the left one. Frame 47 turns the left one away."""
    front, right = heads.landmarks[0].astype(float), heads.landmarks[2].astype(float)
    assert abs(facing(front)[234] - facing(front)[454]) < 0.15
    assert confidence(right)[454] < confidence(right)[234]
    assert ((confidence(right) >= 0) & (confidence(right) <= 1)).all()
    assert confidence(front)[1] == 1.0  # the nose's tip


def test_closed_eyes_are_told_by_the_iris_networks_lids(heads):
    state = read_openness(heads)
    assert not state.closed[: len(OPEN)].any()
    assert state.closed[len(OPEN) :].all()
    assert state.eyes[: len(OPEN)].min() > 0.21
    assert state.eyes[len(OPEN) :].max() < 0.18


def test_the_meshs_lids_stay_apart_over_closed_eyes(heads):
    """Why they are not asked: not one of six closed eyes has lids nearer than half of an open eye's."""
    gap = np.linalg.norm(
        heads.landmarks[:, MESH_UPPER_LID, :2] - heads.landmarks[:, MESH_LOWER_LID, :2], axis=-1
    )
    width = np.linalg.norm(
        heads.landmarks[:, MESH_EYE_CORNERS[0], :2] - heads.landmarks[:, MESH_EYE_CORNERS[1], :2], axis=-1
    )
    ratio = gap / width
    assert ratio[len(OPEN) :].min() > 0.5 * ratio[: len(OPEN)].mean()


def test_openness_is_a_ratio_of_lengths():
    angles = np.linspace(np.pi, 2 * np.pi, 9)
    lower = np.stack([np.cos(angles), -0.2 * np.sin(angles)], axis=1)
    upper = lower * [1, -1]
    lids = np.concatenate([lower[:1], lower[1:8], lower[8:], upper[1:8]])
    middle = np.sin(angles[2:7] - np.pi).mean()
    assert np.isclose(eye_openness(lids), 0.4 * middle / 2)
    assert np.isclose(eye_openness(7 * lids + [30, 40]), eye_openness(lids))
    assert np.isnan(eye_openness(np.full((3, 16, 2), np.nan))).all()
    mouth = np.zeros((POINTS, 3))
    mouth[[78, 308]] = [[-10, 0, 0], [10, 0, 0]]
    mouth[[82, 13, 312], 1], mouth[[87, 14, 317], 1] = -2, [1, 2, 3]
    assert np.isclose(mouth_openness(mouth), 4.0 / 20.0)


def test_the_mouth_is_closed_at_rest_and_open_in_speech(heads):
    """Frame 17 has its jaw down furthest."""
    mouth = read_openness(heads).mouth
    assert mouth[0] < 0.1
    assert mouth[1] > 0.15
