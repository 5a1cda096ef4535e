import numpy as np
import pytest

from samira_warp.io.wavefront import read_mesh, read_vertices
from samira_warp.support.errors import UserError

QUAD = """# a comment
mtllib some.mtl
v 0 0 0 1.0
v 1e0 0 0
v 1 1.5 0
v 0 1 -0.5
vt 0.25 0.5 0
vt 0.75 0.5
vn 0 0 1
usemtl M_Face
f 1/1/1 2/2/1 3/2 4/1
f 1//1 2 3
f -4/-2 -3/-1 -1/-1
"""


def written(tmp_path, text):
    path = tmp_path / "mesh.obj"
    path.write_text(text, encoding="utf-8")
    return path


def test_polygons_fan_out_and_every_number_is_the_files_own(tmp_path):
    mesh = read_mesh(written(tmp_path, QUAD))
    np.testing.assert_array_equal(mesh.vertices, [(0, 0, 0), (1, 0, 0), (1, 1.5, 0), (0, 1, -0.5)])
    np.testing.assert_array_equal(mesh.uvs, [(0.25, 0.5), (0.75, 0.5)])
    np.testing.assert_array_equal(mesh.faces, [(0, 1, 2), (0, 2, 3), (0, 1, 2), (0, 1, 3)])
    np.testing.assert_array_equal(mesh.uv_faces, [(0, 1, 1), (0, 1, 0), (-1, -1, -1), (0, 1, 1)])
    np.testing.assert_array_equal(read_vertices(written(tmp_path, QUAD)), mesh.vertices)


def test_lines_of_windows_and_a_mesh_without_coordinates(tmp_path):
    mesh = read_mesh(written(tmp_path, "v 0 0 0\r\nv 1 0 0\r\nv 0 1 0\r\nf 1 2 3\r\n"))
    assert mesh.uvs.shape == (0, 2)
    np.testing.assert_array_equal(mesh.faces, [(0, 1, 2)])


THREE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected polygons (f), found none"),
        (THREE + "l 1 2", "expected polygons (f), found none"),
        (THREE + "f 1 2 4", "expected ids of its 3 vertices after each f, found 1 to 4"),
        (THREE + "f 1 2 0", None),
        (THREE + "f 1/1 2/1 3/1", "expected ids of its 0 UV coordinates after each f"),
        (THREE + "f 1 2 x", "line 4: expected numbers after f, found 'f 1 2 x'"),
        (THREE + "vt 0", "line 4: expected numbers after vt"),
        ("v 0 0\nf 1 1 1", "expected three numbers after each v"),
        ("v 0 0 zero\nf 1 1 1", "expected three numbers after each v"),
        ("v 0 0 nan\nf 1 1 1", "expected finite numbers after each v"),
    ],
)
def test_a_file_that_is_broken(tmp_path, text, said):
    with pytest.raises(UserError) as refusal:
        read_mesh(written(tmp_path, text))
    assert "mesh.obj" in str(refusal.value)
    assert said is None or said in str(refusal.value)


def test_no_such_file(tmp_path):
    for read in (read_mesh, read_vertices):
        with pytest.raises(UserError, match="expected a Wavefront file"):
            read(tmp_path / "mesh.obj")
