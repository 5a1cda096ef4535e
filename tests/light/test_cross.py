import pytest
import torch

from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.light.cross import cross_to_cube, cube_to_cross, resample_cube
from samira_warp.light.equirect import turn_directions
from samira_warp.support.errors import UserError

SIZE = 8


def block(cross, row, column):
    """One face of a cross."""
    return cross[row * SIZE : (row + 1) * SIZE, column * SIZE : (column + 1) * SIZE]


def upright(lying):
    """The same cross with the face behind below the bottom one, where the picture goes on over their common
    edge."""
    cross = torch.zeros(4 * SIZE, 3 * SIZE, lying.shape[2])
    cross[: 3 * SIZE] = lying[:, : 3 * SIZE]
    block(cross, 3, 1)[:] = block(lying, 1, 3).flip(0, 1)
    return cross


@pytest.mark.parametrize(
    ("row", "column", "direction"),
    [
        (1, 1, (0, 0, -1)),
        (1, 2, (1, 0, 0)),
        (1, 3, (0, 0, 1)),
        (1, 0, (-1, 0, 0)),
        (0, 1, (0, 1, 0)),
        (2, 1, (0, -1, 0)),
    ],
)
def test_faces_lie_where_a_viewer_sees_them(row, column, direction):
    middle = block(cube_to_cross(texel_directions(SIZE)), row, column).mean(dim=(0, 1))
    assert torch.allclose(middle / middle.norm(), torch.tensor(direction, dtype=torch.float32), atol=1e-6)


def test_a_cross_is_a_picture_without_seams():
    """Directions go on from face to face wherever two faces touch, in both layouts."""
    lying = cube_to_cross(texel_directions(SIZE))
    # between neighbouring texels of 8 a face, directions differ by a quarter of a unit at most
    assert (lying[SIZE : 2 * SIZE, 1:] - lying[SIZE : 2 * SIZE, :-1]).norm(dim=-1).max() < 0.26
    tall = upright(lying)[:, SIZE : 2 * SIZE]
    assert (tall[1:] - tall[:-1]).norm(dim=-1).max() < 0.26


def test_straight_ahead_is_not_mirrored():
    ahead = block(cube_to_cross(texel_directions(SIZE)), 1, 1)
    assert (ahead[:, 1:, 0] > ahead[:, :-1, 0]).all()
    assert (ahead[1:, :, 1] < ahead[:-1, :, 1]).all()


def test_both_layouts_hold_the_same_cube(generator):
    cubemap = torch.rand(6, SIZE, SIZE, 3, generator=generator)
    lying = cube_to_cross(cubemap)
    assert lying.shape == (3 * SIZE, 4 * SIZE, 3)
    assert (block(lying, 0, 0) == 0).all()
    assert torch.equal(cross_to_cube(lying), cubemap)
    assert torch.equal(cross_to_cube(upright(lying)), cubemap)


def test_what_is_no_cross_is_refused():
    with pytest.raises(UserError, match="8 x 8"):
        cross_to_cube(torch.zeros(8, 8, 3))


@pytest.mark.parametrize(("old", "new"), [(48, 16), (24, 16), (16, 16), (6, 16), (64, 16)])
@pytest.mark.parametrize("rotate", [0.0, 50.0])
def test_resampling_keeps_the_mean_and_the_directions(device, old, new, rotate):
    cubemap = 1.0 + 0.5 * texel_directions(old, device=device)
    resampled = resample_cube(cubemap, size=new, rotate=rotate)
    expected = 1.0 + 0.5 * turn_directions(texel_directions(new, device=device), rotate)
    # bilinear lookups and means over texels of a map of slope 0.5: second-order errors in the coarser texel
    assert (resampled - expected).abs().max() < 0.5 * (2 / min(old, new)) ** 2
    areas = texel_solid_angles(new, device=device)[..., None]
    assert torch.allclose(
        (resampled * areas).sum(dim=(0, 1, 2)) / (4 * torch.pi), torch.ones(3, device=device), atol=2e-3
    )


def test_whole_blocks_are_averaged_exactly(generator):
    cubemap = torch.rand(6, 12, 12, 2, generator=generator)
    areas = texel_solid_angles(12)[..., None]
    blocks = (cubemap * areas).view(6, 4, 3, 4, 3, 2).sum(dim=(2, 4)) / areas.view(4, 3, 4, 3, 1).sum(
        dim=(1, 3)
    )
    assert torch.allclose(resample_cube(cubemap, size=4), blocks)
    assert resample_cube(cubemap, size=12) is cubemap
    assert resample_cube(cubemap, size=12, rotate=360.0) is cubemap
