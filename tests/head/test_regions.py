import numpy as np
import pytest
from data.tiny import tiny_template

from samira_warp.head.regions import REGIONS, response_coverage, route_faces, route_vertices
from samira_warp.head.template import read_template

# Design's order: what comes first takes a vertex that several masks hold.
PRIORITY = ("left_eye", "right_eye", "lips", "mouth", "nose", "forehead", "ears", "neck", "scalp", "cheeks")
MASK_OF = {
    "left_eye": "left_eye_region",
    "right_eye": "right_eyeball",
    "lips": "lips",
    "mouth": "teeth",
    "nose": "nose",
    "forehead": "forehead",
    "ears": "right_ear",
    "neck": "boundary",
    "scalp": "scalp",
    "cheeks": "face",
}


@pytest.fixture
def make_template(tmp_path):
    """A head with these masks and, if given, these faces."""

    def make(masks, faces=None):
        arrays = {key: value for key, value in tiny_template().items() if not key.startswith("mask_")}
        if faces is not None:
            arrays |= {"f": np.array(faces), "ft": np.array(faces)}
        np.savez(
            tmp_path / "head.npz",
            **arrays,
            **{f"mask_{name}": np.array(ids, np.int32) for name, ids in masks.items()},
        )
        return read_template(tmp_path / "head.npz")

    return make


def test_ten_regions():
    assert len(REGIONS) == 10
    assert set(REGIONS) == set(PRIORITY)


@pytest.mark.parametrize("first", range(9))
def test_priority_where_masks_overlap(make_template, first):
    """Vertex 0 is in a region's mask and in those of all that come later; vertex 1 only in the last one's."""
    template = make_template(
        {MASK_OF[name]: [0] for name in PRIORITY[first:-1]} | {"face": [0, 1]}, [[0, 0, 0], [1, 1, 1]]
    )
    assert [REGIONS[region] for region in route_vertices(template)[:2]] == [PRIORITY[first], "cheeks"]
    assert [REGIONS[region] for region in route_faces(template)] == [PRIORITY[first], "cheeks"]


@pytest.mark.parametrize(
    ("mask", "region"),
    [
        ("left_eyeball", "left_eye"),
        ("right_eye_region", "right_eye"),
        ("mouth", "mouth"),
        ("teeth_upper", "mouth"),
        ("teeth_lower", "mouth"),
        ("left_ear", "ears"),
        ("neck", "neck"),
    ],
)
def test_the_other_masks(make_template, mask, region):
    template = make_template({mask: [0], "face": [0, 1]})
    assert REGIONS[route_vertices(template)[0]] == region


def test_vertices_in_no_mask_are_cheeks_and_respond_neutrally(make_template):
    template = make_template({"nose": [0, 1], "unknown": [2]}, [[0, 1, 2], [0, 2, 3], [2, 3, 4]])
    assert [REGIONS[region] for region in route_vertices(template)[:4]] == [
        "nose",
        "nose",
        "cheeks",
        "cheeks",
    ]
    assert [REGIONS[region] for region in route_faces(template)] == ["nose", "cheeks", "cheeks"]
    assert response_coverage(template).tolist() == [True, False, False]


def test_majority_of_a_faces_vertices(make_template):
    masks = {"scalp": [0, 1], "nose": [2, 3], "left_eyeball": [4]}
    faces = [[0, 1, 2], [2, 0, 1], [2, 3, 0], [0, 3, 2], [0, 2, 4], [4, 0, 3], [4, 4, 0]]
    expected = ["scalp", "scalp", "nose", "nose", "left_eye", "left_eye", "left_eye"]
    assert [REGIONS[region] for region in route_faces(make_template(masks, faces))] == expected


def test_brute_force_on_random_masks(make_template):
    """The rule said face by face, in Python."""
    random = np.random.default_rng(0)
    masks = {mask: np.flatnonzero(random.random(300) < 0.15) for mask in MASK_OF.values()}
    template = make_template(masks)
    rank_of = [
        next(
            (rank for rank, name in enumerate(PRIORITY) if vertex in masks[MASK_OF[name]]),
            PRIORITY.index("cheeks"),
        )
        for vertex in range(400)
    ]
    for face, region in zip(template.faces, route_faces(template), strict=True):
        ranks = [rank_of[vertex] for vertex in face]
        assert REGIONS[region] == PRIORITY[min(ranks, key=lambda rank: (-ranks.count(rank), rank))]


def test_no_masks_at_all(make_template):
    template = make_template({})
    assert {REGIONS[region] for region in route_faces(template)} == {"cheeks"}
    assert not response_coverage(template).any()


def test_the_real_head_has_every_region(subject):
    template = read_template(subject / "template.npz")
    regions = route_faces(template)
    assert sorted(set(regions)) == list(range(10))
    centres = template.v_template[template.faces].mean(axis=1)
    height = {name: centres[regions == index, 1].mean() for index, name in enumerate(REGIONS)}
    assert height["neck"] < height["lips"] < height["nose"] < height["left_eye"] < height["forehead"]
    assert (
        centres[regions == REGIONS.index("left_eye"), 0].mean()
        > 0
        > centres[regions == REGIONS.index("right_eye"), 0].mean()
    )
