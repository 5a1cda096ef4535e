import subprocess

import torch
from subjects import TESTS
from warm_start import warm_python

from samira_warp.support.caching import cached_tensors

RENDER_THEN_TRAIN = """
import torch
from subjects import SMALL_LIGHT, camera, parameters, small_avatar

avatar = small_avatar(light_sizes=SMALL_LIGHT)
with torch.inference_mode():
    shown = avatar.render(parameters(0), camera(24)).image
learned = avatar.render(parameters(0), camera(24)).image
assert torch.equal(shown, learned)
learned.sum().backward()
assert avatar.light.specular.grad.abs().sum() > 0
"""


def test_tensors_are_built_once_and_outside_inference_mode():
    calls = []

    @cached_tensors()
    def ones(count, *, value=1.0):
        """Doc."""
        calls.append(count)
        return torch.full((count,), value, requires_grad=False) * torch.ones(count, requires_grad=True)

    with torch.inference_mode():
        first = ones(3)
    assert not first.is_inference()
    assert not first.requires_grad
    assert ones(3) is first
    assert ones(2, value=2.0).tolist() == [2.0, 2.0]
    assert calls == [3, 2]
    assert ones.__doc__ == "Doc."


def test_rendering_in_inference_mode_leaves_nothing_that_training_cannot_use():
    """In a process of its own, where nobody has built the tables before."""
    done = subprocess.run(
        [*warm_python(), "-c", RENDER_THEN_TRAIN],
        cwd=TESTS,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
