import numpy as np
import torch
from subjects import small_avatar, small_template

from samira_warp.train.materials import CORNEA, SKIN, hold_known, material_prior


def eyeball_faces(template):
    inside = np.zeros(len(template.v_template), bool)
    for name in ("left_eyeball", "right_eyeball"):
        inside[template.masks[name]] = True
    return inside[template.faces].all(axis=1)


def test_skin_and_eyes_are_as_they_were_measured():
    """Reflectance at normal incidence follows from the index of refraction: ((n - 1) / (n + 1))^2."""
    for finish, index in ((SKIN, 1.4), (CORNEA, 1.376)):
        assert abs(finish.specular - ((index - 1) / (index + 1)) ** 2) < 5e-4
    assert abs(SKIN.roughness**2 - 0.3) < 1e-12


def test_every_face_has_its_own(device):
    template = small_template()
    prior = material_prior(template)
    eyes = eyeball_faces(template)
    assert eyes.any()
    assert np.array_equal(prior.held.numpy(), eyes)
    assert np.allclose(prior.roughness[prior.held], CORNEA.roughness)
    gaussians = small_avatar(gaussians=400, device=device).gaussians
    faces = gaussians.faces.long().cpu()
    # through a logit and back in float32
    torch.testing.assert_close(gaussians.roughness.cpu(), prior.roughness[faces], rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(gaussians.specular.cpu(), prior.specular[faces], rtol=1e-3, atol=1e-5)


def test_what_is_known_of_eyes_is_not_learned(device):
    avatar = small_avatar(gaussians=2000, device=device)
    gaussians, held = avatar.gaussians, material_prior(avatar.canonical.template).held.to(device)
    (gaussians.normals.sum() + gaussians.roughness.sum() + gaussians.albedo.sum()).backward()
    hold_known(gaussians, held)
    there = held[gaussians.faces.long()]
    assert there.any()
    assert not there.all()
    for name in ("normals", "roughness_logits"):
        gradient = getattr(gaussians, name).grad
        assert (gradient[there] == 0).all()
        assert (gradient[~there] != 0).all()
    assert (gaussians.albedo_logits.grad != 0).all()
