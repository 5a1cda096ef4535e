"""The subject refined by rendering, against silhouettes and colours of a head that is known."""

from dataclasses import replace

import pytest
import torch
from tracked_heads import VIEW, head, model, performed, pixels_of, seen_landmarks

from samira_warp.kernels.mesh.antialias import antialias
from samira_warp.kernels.mesh.interpolate import interpolate
from samira_warp.kernels.mesh.mesh_normals import mesh_normals
from samira_warp.kernels.mesh.mesh_raster import rasterize_mesh
from samira_warp.kernels.mesh.topology import MeshTopology
from samira_warp.light.color import encode_srgb
from samira_warp.light.harmonics import irradiance_functions, uniform_harmonics
from samira_warp.tracker import render_fit
from samira_warp.tracker.render_fit import KeyFrames, Rendered, refine_by_rendering

FRAMES, SIDE = 4, 96
LEVELS = ((SIDE, 60),)


def light():
    """From above and a little from the left, (9, 3)."""
    result = uniform_harmonics(torch.tensor([0.8, 0.8, 0.8]))
    result[1], result[3] = 0.5, -0.3
    return result


def rendered(unknowns, albedo):
    """(N, SIDE, SIDE, 3) and (N, SIDE, SIDE) uint8 pictures on black, and mattes."""
    offset = head().basis @ unknowns.offset.float()
    parameters = unknowns.parameters().to(dtype=torch.float32)
    vertices = head().rig.pose(parameters, unknowns.shape.float(), offset).vertices
    camera = VIEW.in_camera(vertices)
    scale = SIDE / VIEW.width
    points = torch.cat([VIEW.project(camera, unknowns.focal) * scale, camera[..., 2:]], dim=-1)
    topology = MeshTopology.build(head().faces, vertices.shape[1])
    raster = rasterize_mesh(points, topology, width=SIDE, height=SIDE)
    shaded = encode_srgb(albedo * (irradiance_functions(mesh_normals(vertices, topology)) @ light()))
    layer = torch.cat([shaded, torch.ones_like(shaded[..., :1])], dim=-1)
    image = antialias(interpolate(layer, raster, topology), raster, points, topology)
    found = (255.0 * image).round().clamp(0, 255).to(torch.uint8)
    return found[..., :3].contiguous(), found[..., 3].contiguous()


@pytest.fixture(scope="module")
def case():
    """A head whose crown is higher than landmarks tell, which are on its face."""
    truth = performed(FRAMES)
    layout = head().layout
    truth.subject[layout.offset] = 0.0
    start = replace(truth, subject=truth.subject.clone())
    truth.subject[layout.offset.stop - 2] = 0.003  # the dome, along y
    albedo = torch.full_like(head().rig.v_template, 0.4)
    pictures, mattes = rendered(truth, albedo)
    landmarks = seen_landmarks(truth)
    scales = truth.focal / pixels_of(model().points, truth)[1].mean(dim=1)
    points = landmarks.points[:, model().ids]
    keys = KeyFrames(pictures, mattes, points, model().precision(landmarks, scales=scales))
    return truth, start, albedo, keys


def test_a_skull_is_found_by_its_outline(case, monkeypatch):
    monkeypatch.setattr(render_fit, "LEVELS", LEVELS)
    truth, start, albedo, keys = case
    said = []
    found = refine_by_rendering(model(), Rendered(start, albedo, light()), keys, VIEW, say=said.append)
    assert len(said) == len(LEVELS)
    top = head().basis[:, -1].argmax()

    def height(unknowns):
        offset = head().basis[top] @ unknowns.offset.float()
        shape = head().rig.shapedirs[top, :, : head().layout.identities] @ unknowns.shape.float()
        return float((offset + shape)[1])

    missing = height(truth) - height(start)
    assert missing > 0.006  # a pixel is 4 mm
    assert abs(height(found.unknowns) - height(truth)) < 0.35 * missing
    overlap = rendered(found.unknowns, albedo)[1].float() - keys.mattes.float()
    before = rendered(start, albedo)[1].float() - keys.mattes.float()
    assert overlap.abs().sum() < 0.3 * before.abs().sum()


def test_light_and_albedo_are_found_up_to_their_scale(case, monkeypatch):
    """From a uniform light as bright, the pictures come out; what is dark stays dark."""
    monkeypatch.setattr(render_fit, "LEVELS", LEVELS)
    truth, _, albedo, keys = case
    start = Rendered(truth, albedo, uniform_harmonics(torch.tensor([0.8, 0.8, 0.8])))
    renderer = render_fit._Renderer.build(model(), VIEW)
    level = render_fit._Level.build(keys, VIEW, SIDE)

    def colors(state):
        with torch.no_grad():
            variables = render_fit._Variables(model(), state)
            return renderer.loss(variables, keys, level, slice(0, FRAMES)).colors

    found = refine_by_rendering(model(), start, keys, VIEW, say=lambda text: None)
    assert colors(found) < 0.3 * colors(start)
    assert (found.albedo > 0).all()


def test_a_true_head_stays(case, monkeypatch):
    """Where all fits, priors alone pull: the outline moves by less than a tenth of the fault above."""
    monkeypatch.setattr(render_fit, "LEVELS", LEVELS)
    truth, start, albedo, keys = case
    own, mattes = rendered(start, albedo)
    keys = keys._replace(pictures=own, mattes=mattes)
    found = refine_by_rendering(model(), Rendered(start, albedo, light()), keys, VIEW, say=lambda text: None)
    change = (rendered(found.unknowns, albedo)[1].float() - mattes.float()).abs().sum()
    fault = (rendered(truth, albedo)[1].float() - mattes.float()).abs().sum()
    assert change < 0.25 * fault
