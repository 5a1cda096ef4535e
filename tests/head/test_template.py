import pickle
import zipfile

import numpy as np
import pytest
from data.rigs import SEVEN, SEVEN_PARENTS, with_seven_joints
from data.tiny import N_EXPRESSION, N_SHAPE, tiny_template

from samira_warp.head import FLAME_JOINTS, HeadTemplate
from samira_warp.head.template import read_template, save_template
from samira_warp.support.errors import UserError


class Trap:
    """Unpickled, it would say so."""

    def __reduce__(self):
        return pytest.fail, ("a pickle was loaded",)


@pytest.fixture
def arrays():
    return tiny_template()


@pytest.fixture
def read(tmp_path):
    """Write arrays as a template and read it back."""

    def write_and_read(arrays):
        np.savez(tmp_path / "head.npz", **arrays)
        return read_template(tmp_path / "head.npz")

    return write_and_read


def test_reads_what_is_there(arrays, read):
    template = read(arrays)
    for name in ("v_template", "shapedirs", "posedirs", "weights", "vt", "ft"):
        assert np.array_equal(getattr(template, name), arrays[name])
    assert np.array_equal(template.joint_regressor, arrays["J_regressor"])
    assert np.array_equal(template.faces, arrays["f"])
    assert template.faces.dtype == template.ft.dtype == np.int32
    assert template.v_template.dtype == np.float32
    assert (template.n_shape, template.n_expression) == (N_SHAPE, N_EXPRESSION)
    assert template.parents.tolist() == [-1, 0, 1, 1, 1]
    assert template.expression_names == tuple(arrays["expression_names"])
    assert {f"mask_{name}" for name in template.masks} == {key for key in arrays if key.startswith("mask_")}
    assert np.array_equal(template.masks["nose"], arrays["mask_nose"])


def test_other_dtypes_and_flames_root(arrays, read):
    """Doubles, unsigned indices, and FLAME's mark of the root: the largest uint32."""
    same = read(arrays)
    for key in ("v_template", "shapedirs", "weights"):
        arrays[key] = arrays[key].astype(np.float64)
    for key in ("f", "ft"):
        arrays[key] = arrays[key].astype(np.uint32)
    arrays["kintree_table"] = np.array([[2**32 - 1, 0, 1, 1, 1], [0, 1, 2, 3, 4]], np.uint32)
    assert read(arrays).hash == same.hash


def test_names_and_masks_are_optional(arrays, read):
    template = read(
        {
            key: value
            for key, value in arrays.items()
            if key != "expression_names" and not key.startswith("mask_")
        }
    )
    assert len(set(template.expression_names)) == N_EXPRESSION
    assert template.masks == {}


def test_saved_and_read_again(arrays, read, tmp_path):
    template = read(arrays)
    save_template(template, tmp_path / "copy.bin")
    copy = read_template(str(tmp_path / "copy.bin"))
    assert copy.hash == template.hash
    assert copy.expression_names == template.expression_names
    assert np.array_equal(copy.masks["lips"], template.masks["lips"])


@pytest.mark.parametrize("key", ["v_template", "weights", "f", "mask_nose", "expression_names", "n_shape"])
def test_hash_depends_on_every_value(arrays, read, key):
    before = read(arrays).hash
    assert len(before) == 64
    changed = np.copy(arrays[key])
    if key == "n_shape":
        arrays["expression_names"] = np.append(arrays["expression_names"], "more")
        changed = changed - 1
    elif key == "weights":
        changed[0] = np.roll(changed[0], 1)
    else:
        changed[0], changed[1] = np.copy(changed[1]), np.copy(changed[0])
    assert not np.array_equal(changed, arrays[key])
    assert read(arrays | {key: changed}).hash != before


REQUIRED = (
    "v_template",
    "shapedirs",
    "n_shape",
    "posedirs",
    "J_regressor",
    "kintree_table",
    "weights",
    "f",
    "vt",
    "ft",
)


@pytest.mark.parametrize("key", REQUIRED)
def test_a_missing_key(arrays, read, key):
    del arrays[key]
    with pytest.raises(UserError, match=rf"head\.npz: {key}: expected an array.*no such key"):
        read(arrays)


@pytest.mark.parametrize("key", [*REQUIRED, "expression_names", "mask_nose"])
def test_a_wrong_shape(arrays, read, key):
    arrays[key] = arrays[key][..., None]
    with pytest.raises(UserError, match=rf"head\.npz: {key}: expected shape .* found shape"):
        read(arrays)


@pytest.mark.parametrize("key", ["shapedirs", "posedirs", "J_regressor", "weights"])
def test_a_vertex_too_few(arrays, read, key):
    arrays[key] = arrays[key][:, :-1] if key == "J_regressor" else arrays[key][:-1]
    with pytest.raises(UserError, match=rf"{key}: expected shape .*{len(arrays['v_template'])}"):
        read(arrays)


@pytest.mark.parametrize("key", ["ft", "expression_names"])
def test_an_entry_too_few(arrays, read, key):
    arrays[key] = arrays[key][:-1]
    with pytest.raises(UserError, match=rf"{key}: expected shape"):
        read(arrays)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("key", ["v_template", "shapedirs", "posedirs", "J_regressor", "weights", "vt"])
def test_numbers_that_are_not_finite(arrays, read, key, value):
    arrays[key].flat[7] = value
    with pytest.raises(UserError, match=rf"{key}: expected finite numbers"):
        read(arrays)


@pytest.mark.parametrize(("key", "beyond"), [("f", "v_template"), ("ft", "vt"), ("mask_scalp", "v_template")])
@pytest.mark.parametrize("low", [True, False])
def test_an_index_out_of_range(arrays, read, key, beyond, low):
    arrays[key].flat[3] = -1 if low else len(arrays[beyond])
    with pytest.raises(
        UserError, match=rf"{key}: expected integers from 0 to {len(arrays[beyond]) - 1}, found"
    ):
        read(arrays)


@pytest.mark.parametrize("n_shape", [-1, N_SHAPE + N_EXPRESSION + 1])
def test_n_shape_out_of_range(arrays, read, n_shape):
    arrays["n_shape"] = np.int64(n_shape)
    with pytest.raises(
        UserError, match=rf"n_shape: expected integers from 0 to {N_SHAPE + N_EXPRESSION}, found {n_shape}"
    ):
        read(arrays)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("f", np.float32, "integers"),
        ("mask_nose", np.float64, "integers"),
        ("vt", np.str_, "numbers"),
        ("v_template", np.complex64, "numbers"),
        ("kintree_table", np.float32, "integers"),
    ],
)
def test_a_wrong_dtype(arrays, read, key, value, expected):
    arrays[key] = arrays[key].astype(value)
    with pytest.raises(UserError, match=rf"{key}: expected {expected}"):
        read(arrays)


def test_names_that_are_numbers(arrays, read):
    arrays["expression_names"] = np.arange(N_EXPRESSION)
    with pytest.raises(UserError, match="expression_names: expected text"):
        read(arrays)


def test_weights_that_do_not_sum_to_one(arrays, read):
    arrays["weights"] = arrays["weights"] * 0.9
    with pytest.raises(UserError, match="weights: expected rows that sum to 1"):
        read(arrays)


@pytest.mark.parametrize("parents", [[-1, 2, 1, 1, 1], [-1, 0, 1, 1, 5], [-1, 0, 1, -1, 1]])
def test_a_kinematic_tree_that_is_none(arrays, read, parents):
    arrays["kintree_table"] = np.array([parents, range(5)])
    with pytest.raises(UserError, match="kintree_table: expected parents that precede"):
        read(arrays)


def test_flames_joints_where_none_are_named(arrays, read):
    template = read(arrays)
    assert template.joint_names == FLAME_JOINTS == ("root", "neck", "jaw", "left_eye", "right_eye")
    assert template.head_joint == "neck"


def test_joints_of_any_number_and_name(arrays, read, tmp_path):
    template = read(with_seven_joints(arrays))
    assert template.joint_names == SEVEN
    assert template.parents.tolist() == list(SEVEN_PARENTS)
    assert template.posedirs.shape == (len(template.v_template), 3, 54)
    save_template(template, tmp_path / "copy.npz")
    copy = read_template(tmp_path / "copy.npz")
    assert (copy.joint_names, copy.head_joint, copy.hash) == (SEVEN, "head", template.hash)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "head"),  # of those that usually carry it the first
        ({"head_joint": "neck"}, "neck"),
        ({"head_joint": "base"}, "base"),
        ({"joint_names": ("base", "neck", "skull", "jaw", "left_eye", "right_eye", "tongue")}, "neck"),
        ({"joint_names": tuple("abcdefg")}, "a"),
        ({"joint_names": tuple("abcdefg"), "head_joint": "c"}, "c"),
    ],
)
def test_the_joint_that_carries_the_head(arrays, read, tmp_path, given, expected):
    template = read(with_seven_joints(arrays) | {key: np.array(value) for key, value in given.items()})
    assert template.head_joint == expected
    save_template(template, tmp_path / "copy.npz")
    assert read_template(tmp_path / "copy.npz").head_joint == expected


def test_a_root_alone(arrays, read):
    count = len(arrays["v_template"])
    alone = {
        "joint_names": np.array(["all"]),
        "weights": np.ones((count, 1), np.float32),
        "J_regressor": np.full((1, count), 1 / count, np.float32),
        "posedirs": np.zeros((count, 3, 0), np.float32),
        "kintree_table": np.array([[-1], [0]]),
    }
    template = read(arrays | alone)
    assert (template.joint_names, template.head_joint) == (("all",), "all")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joint_names": None}, "joint_names: expected names of the 7 joints of J_regressor, found no such"),
        ({"joint_names": SEVEN[:-1]}, "weights: expected shape"),
        ({"joint_names": (*SEVEN[:-1], "jaw")}, "joint_names: expected names that differ"),
        ({"joint_names": (*SEVEN[:-1], "")}, "joint_names: expected a name for each joint"),
        ({"joint_names": (*SEVEN[:-1], "root")}, "joint_names: expected no root but the first joint"),
        ({"joint_names": ()}, "joint_names: expected a name for each joint"),
        ({"joint_names": range(7)}, "joint_names: expected text"),
        ({"head_joint": "skull"}, "head_joint: expected one of base, neck, .*, found 'skull'"),
        ({"head_joint": ("head", "neck")}, "head_joint: expected shape"),
        ({"kintree_table": [(-1, 0, 1, 2, 2, -1, 3), range(7)]}, "kintree_table: .* after one root"),
        ({"kintree_table": [(-1, 0, 1, 2, 2, 6, 3), range(7)]}, "kintree_table: expected parents that"),
    ],
)
def test_joints_that_are_none(arrays, read, changes, message):
    broken = with_seven_joints(arrays)
    for key, value in changes.items():
        if value is None:
            del broken[key]
        else:
            broken[key] = np.array(value if isinstance(value, str) else list(value))
    with pytest.raises(UserError, match=message):
        read(broken)


def test_names_that_a_file_would_have_had_anyway_change_no_hash(arrays, read, tmp_path):
    """Avatars know their template by its hash: those of FLAME's joints keep theirs."""
    plain = read(arrays)
    said = read(arrays | {"joint_names": np.array(FLAME_JOINTS), "head_joint": np.array("neck")})
    assert said.hash == plain.hash
    for name, other in (("joint_names", (*FLAME_JOINTS[:-1], "other")), ("head_joint", "root")):
        assert read(arrays | {name: np.array(other)}).hash != plain.hash
    save_template(plain, tmp_path / "plain.npz")
    with np.load(tmp_path / "plain.npz") as archive:
        assert not {"joint_names", "head_joint"} & set(archive)


def test_the_hash_is_the_one_that_it_always_was():
    """Of a template without floating-point sums, so that every machine makes the same one."""
    count = 4
    template = HeadTemplate(
        v_template=np.arange(12, dtype=np.float32).reshape(4, 3) / 8,
        shapedirs=np.arange(24, dtype=np.float32).reshape(4, 3, 2) / 4,
        n_shape=1,
        posedirs=np.zeros((count, 3, 36), np.float32),
        joint_regressor=np.full((5, count), 0.25, np.float32),
        parents=np.array([-1, 0, 1, 1, 1], np.int32),
        weights=np.eye(5, dtype=np.float32)[[0, 1, 2, 3]],
        faces=np.array([[0, 1, 2], [1, 2, 3]], np.int32),
        vt=np.array([[0, 0], [1, 0], [0, 1]], np.float32),
        ft=np.array([[0, 1, 2], [0, 1, 2]], np.int32),
        masks={"nose": np.array([1, 2], np.int32)},
        expression_names=("smile",),
        joint_names=FLAME_JOINTS,
        head_joint="neck",
    )
    assert template.hash == "137ca12ae5843713e69b3048f6122b858eca1f85c0225ecb69e877e1ca0f0e49"


@pytest.mark.subject
def test_the_real_heads_hash_is_the_one_that_its_avatars_know(subject):
    known = "3ddf4cd39cab5ec1652feb94df1e948cd841669d4676fdf3514e5298fd518959"
    assert read_template(subject / "template.npz").hash == known


def test_a_head_without_vertices(arrays, read):
    arrays |= {key: arrays[key][:0] for key in ("v_template", "shapedirs", "posedirs", "weights", "f", "ft")}
    arrays |= {"J_regressor": arrays["J_regressor"][:, :0]}
    with pytest.raises(UserError, match="v_template"):
        read(arrays)


def test_a_head_without_faces(arrays, read):
    arrays |= {key: arrays[key][:0] for key in ("f", "ft")}
    with pytest.raises(UserError, match="f: expected at least one face"):
        read(arrays)


def test_pickled_content_is_not_loaded(arrays, read):
    arrays["vt"] = np.array([Trap()], dtype=object)
    with pytest.raises(UserError, match=r"head\.npz: vt: .*pickle"):
        read(arrays)


def test_entries_that_nobody_needs_are_not_read(arrays, read):
    extra = {"settings": np.array([Trap()], dtype=object), "masks": np.zeros(3), "note": np.array("by hand")}
    assert read({**arrays, **extra}).hash == read(arrays).hash


def test_an_entry_that_is_no_array_is_refused_where_it_is_needed(arrays, read, tmp_path):
    read(arrays)
    path = tmp_path / "head.npz"
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("readme.txt", "by hand")
        archive.writestr("broken.npy", b"\x93NUMPY")
    assert read_template(path).hash == read(arrays).hash
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("mask_chin", "by hand")
    with pytest.raises(
        UserError, match=r"head\.npz: mask_chin: expected an \.npz of plain arrays, found .*no array"
    ):
        read_template(path)


@pytest.mark.parametrize("name", ["generic_model.pkl", "FLAME.PICKLE"])
def test_a_pickle_is_refused_unread(tmp_path, name):
    (tmp_path / name).write_bytes(pickle.dumps(Trap()))
    with pytest.raises(UserError, match=rf"{name}: expected an npz file"):
        read_template(tmp_path / name)


def test_a_pickle_by_another_name_is_not_loaded(tmp_path):
    (tmp_path / "head.npz").write_bytes(pickle.dumps(Trap()))
    with pytest.raises(UserError, match=r"head\.npz: expected an \.npz of plain arrays"):
        read_template(tmp_path / "head.npz")


def test_no_such_file(tmp_path):
    with pytest.raises(UserError, match=r"nowhere\.npz: expected an npz file.*no such file"):
        read_template(tmp_path / "nowhere.npz")
    with pytest.raises(UserError, match="no such file"):
        read_template(tmp_path)


@pytest.mark.parametrize("content", ["empty", "text", "zip without arrays", "truncated", "npy", "flipped"])
def test_not_an_npz(arrays, tmp_path, content):
    path = tmp_path / "head.npz"
    np.savez_compressed(path, **arrays)
    whole = path.read_bytes()
    if content == "npy":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
    else:
        middle = len(whole) // 2
        path.write_bytes(
            {
                "empty": b"",
                "text": b"v_template: 1 2 3",
                "zip without arrays": b"PK\x05\x06" + bytes(18),
                "truncated": whole[:middle],
                "flipped": whole[:middle]
                + bytes(255 - byte for byte in whole[middle : middle + 64])
                + whole[middle + 64 :],
            }[content]
        )
    with pytest.raises(UserError, match=r"head\.npz"):
        read_template(path)
