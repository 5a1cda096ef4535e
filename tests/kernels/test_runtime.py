import gc
import os
import subprocess
import textwrap
import weakref

import pytest
import torch
import warp as wp
from warm_start import warm_python

from samira_warp.kernels.runtime import launch, launch_range


@wp.kernel(enable_backward=False)
def _affine(
    first: wp.int32, x: wp.array[wp.vec2], scale: wp.vec2, offset: wp.float32, y: wp.array2d[wp.float32]
) -> None:
    i = first + wp.tid()
    y[i, 0] = scale[0] * x[i][0] + offset
    y[i, 1] = scale[1] * x[i][1] + offset


def affine(x, scale, offset):
    y = torch.full_like(x, torch.nan)
    launch_range(_affine, len(x), x, scale, offset, y, grain=10)
    return y


def test_a_replayed_launch_takes_all_its_new_arguments(device, generator, use_threads):
    """Other addresses, sizes, vectors and numbers than those that the launch was recorded with."""
    use_threads(2)
    for count in (3, 1000, 1, 57):
        x = torch.rand(count, 2, generator=generator).to(device)
        scale, offset = wp.vec2(float(count), -2.0), 0.5 * count
        expected = x * torch.tensor([count, -2.0], device=device) + offset
        # one rounding more or less, where the kernel fuses
        assert torch.allclose(affine(x, scale, offset), expected, rtol=1e-6, atol=1e-6)


@wp.kernel(enable_backward=False)
def _scaled(scale: wp.vec2, y: wp.array[wp.vec2]) -> None:
    y[wp.tid()] = scale


def test_a_launch_leaves_its_arguments_alone(device):
    """A vector that a caller keeps, and that the launch was recorded with, still holds what it held after
    other launches."""
    kept, y = wp.vec2(3.0, 5.0), torch.zeros(2, 2, device=device)
    launch(_scaled, 2, kept, y)
    launch(_scaled, 2, wp.vec2(7.0, 7.0), y)
    assert list(kept) == [3.0, 5.0]
    launch(_scaled, 2, kept, y)
    assert y.tolist() == [[3.0, 5.0], [3.0, 5.0]]


def test_tensors_of_another_layout_are_read_right(device):
    """The fast path is for contiguous tensors; others go through Warp's own conversion, between fast ones."""
    rows = torch.arange(12.0, device=device).reshape(3, 4)
    for x in (rows[:, 1:3].contiguous(), rows[:, 1:3], rows[:, :2].contiguous()):
        y = torch.zeros(3, 2, device=device)
        launch(_affine, 3, 0, x, wp.vec2(1.0, 1.0), 0.0, y)
        assert torch.equal(y, x)


def test_nothing_to_run_and_too_few_arguments(device):
    empty = torch.zeros(0, 2, device=device)
    assert affine(empty, wp.vec2(1.0, 1.0), 0.0).shape == (0, 2)
    with pytest.raises(TypeError, match="takes 5 arguments"):
        launch(_affine, 1, 0, empty)
    with pytest.raises(TypeError, match="at least one tensor"):
        launch(_affine, 1, 0, 1.0)


def test_a_wrong_dtype_is_refused_also_after_a_right_one(device):
    x = torch.ones(2, 2, device=device)
    affine(x, wp.vec2(1.0, 1.0), 0.0)
    with pytest.raises(RuntimeError):
        affine(x.double(), wp.vec2(1.0, 1.0), 0.0)


def test_a_launch_holds_on_to_nothing(use_threads):
    """What was launched on can be freed afterwards, whichever thread ran it."""
    use_threads(2)
    x, y = torch.ones(1000, 2), torch.zeros(1000, 2)
    for _ in range(2):
        launch_range(_affine, 1000, x, wp.vec2(1.0, 1.0), 0.0, y, grain=10)
    alive = [weakref.ref(tensor) for tensor in (x, y)]
    del x, y
    gc.collect()
    assert [reference() for reference in alive] == [None, None]


def test_many_threads_may_begin_at_once():
    """Compiling and loading is done by one of them; in a process of its own, where nothing is loaded yet."""
    done = run_python(
        """
        import threading, torch
        from samira_warp.geometry.camera import Camera
        from samira_warp.kernels.raster.rasterizer import rasterize

        camera = Camera(torch.eye(4), 40.0, 40.0, 16.0, 16.0, 32, 32)
        means = torch.tensor([[0.0, 0.0, 1.0], [0.1, 0.1, 2.0]])
        shapes = (torch.ones(2, 4), torch.full((2, 3), 0.1), torch.full((2,), 0.5))
        arguments = (means, *shapes, torch.ones(2, 3), camera)
        together, sums = threading.Barrier(4), []

        def work():
            together.wait()
            for _ in range(50):
                sums.append(rasterize(*arguments).features.sum().item())

        threads = [threading.Thread(target=work) for _ in range(4)]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
        assert len(sums) == 200 and len(set(sums)) == 1, set(sums)
        """
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_process_goes_on():
    """The child of a process that has launched on two threads can do so too."""
    done = run_python(
        """
        import os, torch, warp as wp
        from samira_warp.kernels.raster.splats import GRAIN
        from samira_warp.kernels.raster.projection import project
        from samira_warp.geometry.camera import Camera

        torch.set_num_threads(2)
        camera = Camera(torch.eye(4), 40.0, 40.0, 16.0, 16.0, 32, 32)
        count = 4 * GRAIN
        shapes = (torch.ones(count, 4), torch.ones(count, 3), torch.ones(count))
        arguments = (torch.ones(count, 3), *shapes, camera)
        expected = project(*arguments).conics.clone()
        child = os.fork()
        if child == 0:
            os._exit(0 if torch.equal(project(*arguments).conics, expected) else 1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        """
    )
    assert done.returncode == 0, done.stderr


def run_python(code):
    return subprocess.run(
        [*warm_python(), "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=120
    )
