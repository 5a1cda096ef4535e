"""Surface points against the rig that poses the whole mesh, and their derivatives against differences."""

import pytest
import torch

from samira_subject.head import build_template
from samira_warp.head import FrameParameters, Rig
from samira_warp.tracker.surface_points import SurfacePoints

FRAMES, POINTS, FUNCTIONS = 3, 40, 4
STEP = 1e-6
"""Central differences in float64: truncation of 1e-12 and rounding of 1e-16 / 1e-6 = 1e-10."""


@pytest.fixture(scope="module")
def case():
    generator = torch.Generator().manual_seed(3)

    def uniform(*shape):
        return torch.rand(shape, generator=generator, dtype=torch.float64)

    template = build_template()
    rig = Rig.build(template).to(dtype=torch.float64)
    faces = torch.from_numpy(template.faces).long()
    corners = faces[torch.randint(len(faces), (POINTS,), generator=generator)]
    barycentrics = uniform(POINTS, 3)
    barycentrics /= barycentrics.sum(dim=1, keepdim=True)
    basis = 0.1 * uniform(len(rig.v_template), FUNCTIONS)
    points = SurfacePoints.build(rig, corners, barycentrics, basis=basis, moving=(0, 1, 2, 3, 4))
    parameters = FrameParameters(
        0.1 * uniform(FRAMES, 3), uniform(FRAMES, 5, 3) - 0.5, uniform(FRAMES, rig.n_expression)
    )
    shape, offset = uniform(rig.n_shape) - 0.5, 0.01 * uniform(FUNCTIONS, 3)
    return rig, corners, barycentrics, basis, points, parameters, shape, offset


def test_points_lie_on_the_posed_mesh(case):
    rig, corners, barycentrics, basis, points, parameters, shape, offset = case
    vertices = rig.pose(parameters, shape, basis @ offset).vertices
    expected = (vertices[:, corners] * barycentrics[..., None]).sum(dim=2)
    found = points.pose(parameters, shape, offset).points
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-14)  # sums in another order


def test_correctives_move_points_as_they_move_the_mesh(case):
    rig, corners, barycentrics, basis, _, parameters, shape, offset = case
    generator = torch.Generator().manual_seed(5)
    posedirs = 1e-3 * torch.randn(rig.posedirs.shape, generator=generator, dtype=torch.float64)
    rig = Rig(**{**vars(rig), "posedirs": posedirs})
    points = SurfacePoints.build(rig, corners, barycentrics, basis=basis, moving=(0, 2))
    vertices = rig.pose(parameters, shape, basis @ offset).vertices
    expected = (vertices[:, corners] * barycentrics[..., None]).sum(dim=2)
    torch.testing.assert_close(points.pose(parameters, shape, offset).points, expected, rtol=0, atol=1e-14)


def test_derivatives_by_a_frame(case):
    *_, points, parameters, shape, offset = case
    rows = torch.eye(3, dtype=torch.float64).expand(FRAMES, POINTS, 3, 3)
    found = points.pose(parameters, shape, offset).by_frame(rows)
    for name, first in (("translation", 0), ("rotations", 3), ("expression", 18)):
        values = getattr(parameters, name)
        for column in range(values[0].numel()):
            expected = (
                _moved(points, parameters, name, column, STEP, shape, offset)
                - _moved(points, parameters, name, column, -STEP, shape, offset)
            ) / (2 * STEP)
            torch.testing.assert_close(found[..., first + column], expected, rtol=0, atol=1e-9)


def test_derivatives_by_the_subject(case):
    *_, points, parameters, shape, offset = case
    rows = torch.eye(3, dtype=torch.float64).expand(FRAMES, POINTS, 3, 3)
    found = points.pose(parameters, shape, offset).by_subject(rows)
    subject = torch.cat([shape, offset.flatten()])
    for column in range(len(subject)):
        step = torch.zeros_like(subject)
        step[column] = STEP
        ahead, behind = (
            points.pose(parameters, moved[: len(shape)], moved[len(shape) :].view(-1, 3)).points
            for moved in (subject + step, subject - step)
        )
        torch.testing.assert_close(found[..., column], (ahead - behind) / (2 * STEP), rtol=0, atol=1e-9)


def test_rows_are_linear_functions_of_places(case):
    """A projection's rows give what multiplying the full derivatives by them gives."""
    *_, points, parameters, shape, offset = case
    generator = torch.Generator().manual_seed(9)
    rows = torch.randn(FRAMES, POINTS, 2, 3, generator=generator, dtype=torch.float64)
    posed = points.pose(parameters, shape, offset)
    whole = torch.eye(3, dtype=torch.float64).expand(FRAMES, POINTS, 3, 3)
    torch.testing.assert_close(posed.by_frame(rows), rows @ posed.by_frame(whole), rtol=0, atol=1e-13)
    torch.testing.assert_close(posed.by_subject(rows), rows @ posed.by_subject(whole), rtol=0, atol=1e-13)


def _moved(points, parameters, name, column, step, shape, offset):
    values = {key: getattr(parameters, key).clone() for key in ("translation", "rotations", "expression")}
    values[name].view(FRAMES, -1)[:, column] += step
    return points.pose(FrameParameters(**values), shape, offset).points
