import json
import types
from dataclasses import fields, replace

import pytest
import torch

from samira_warp.bench import avatar, drive, embree_peer, gsplat_peer, mesh, raster, timing, view, visibility
from samira_warp.bench.allocations import peak_bytes
from samira_warp.bench.disc import make_disc
from samira_warp.bench.subject import make_avatar, make_camera, make_parameters, make_template
from samira_warp.drive.arkit import SHAPES
from samira_warp.kernels.raster.projection import project
from samira_warp.kernels.raster.tiles import TILE, bin_tiles
from samira_warp.surface import SURFACE_CHANNELS

TINY = raster.Sweep((500,), (40,), (3, raster.GBUFFER_CHANNELS), (1, 2))
MEGABYTE = 2**20


@pytest.fixture
def brief(monkeypatch):
    """One timed run, none before it."""
    monkeypatch.setattr(timing, "REPEATS", 1)
    monkeypatch.setattr(timing, "WARM_UP", 0)


def test_peak_bytes_follow_storages_to_their_end(device):
    outside = torch.ones(MEGABYTE, dtype=torch.uint8, device=device)

    def work():
        first = torch.zeros(3 * MEGABYTE, dtype=torch.uint8, device=device)
        view = first[:MEGABYTE].view(-1, 2)  # owns nothing
        del first  # yet the storage stays with the view
        second = view + 1  # one more: four
        del view
        third = torch.zeros(2 * MEGABYTE, dtype=torch.uint8, device=device)  # one and two
        outside.add_(1)
        return second, third, outside[1:]

    # exactly four, but for what a GPU's allocator rounds up
    assert 4 * MEGABYTE <= peak_bytes(work, device) < (4 if device.type == "cpu" else 5) * MEGABYTE + 1
    assert peak_bytes(lambda: outside.mul_(2), device) == 0


def test_peak_bytes_see_the_backward_pass(device):
    leaf = torch.ones(MEGABYTE // 4, device=device, requires_grad=True)
    # exp's result, kept for the backward pass, then its gradient by ones and the product of the two
    assert peak_bytes(lambda: torch.autograd.grad(leaf.exp(), leaf, leaf.detach()), device) >= 2 * MEGABYTE


def test_raster_rows_keep_their_fields(monkeypatch, capsys):
    monkeypatch.setitem(raster.SWEEPS, "cpu", TINY)
    before = torch.get_num_threads()
    raster.main("cpu", True)
    rows = json.loads(capsys.readouterr().out)
    assert torch.get_num_threads() == before
    of_gbuffer = raster.GBUFFER_CHANNELS
    assert [(row["channels"], row["threads"]) for row in rows] == [
        *((3, threads) for threads in (1, 2)),
        *((of_gbuffer, threads) for threads in (1, 2)),
    ]
    promised = (
        "gaussians size channels threads forward_ms backward_ms forward_ratio backward_ratio "
        "pairs_per_second peak_bytes"
    )
    for row in rows:
        assert set(promised.split()) <= set(row) == {field.name for field in fields(raster.Row)}
        assert all(
            row[name] > 0
            for name in [*promised.split(), "prepare_ms", "dispatch_forward_ms", "dispatch_backward_ms"]
        )
        for direction in ("forward", "backward"):
            assert row[f"{direction}_ratio"] == pytest.approx(
                row[f"plain_{direction}_ms"] / row[f"{direction}_ms"]
            )
        assert row["gsplat_forward_ms"] is None
    assert rows[2]["peak_bytes"] > rows[0]["peak_bytes"]


def test_raster_tables_leave_out_the_other_devices_yardstick(monkeypatch, capsys):
    monkeypatch.setitem(raster.SWEEPS, "cpu", TINY._replace(channels=(3,)))
    raster.main("cpu", False)
    large, dispatch = capsys.readouterr().out.split("\n\n")
    assert "gsplat" not in large
    assert len(large.splitlines()) == 1 + 1 + 2
    assert [line.split()[0] for line in dispatch.splitlines()] == ["threads", "1", "2"]


def test_the_plain_kernels_stop_when_their_time_is_up_and_say_so(monkeypatch, capsys):
    monkeypatch.setattr(raster, "PLAIN_BUDGET", 1e-9)
    rows = list(raster.run(torch.device("cpu"), TINY))
    assert [row.plain_forward_ms is None for row in rows] == [False, False, True, True]
    assert capsys.readouterr().err.startswith("plain kernels left out")


def test_visibility_rows_compare_the_same_rays(monkeypatch, capsys, use_threads):
    monkeypatch.setattr(visibility, "FACE", 4)
    monkeypatch.setattr(visibility, "REPEATS", 1)
    monkeypatch.setattr(visibility, "embree_ms", lambda *rays: 1e3 if len(rays[2]) == len(rays[3]) else None)
    use_threads(2)
    visibility.main("cpu", True)
    rows = json.loads(capsys.readouterr().out)
    assert torch.get_num_threads() == 2
    assert [row["threads"] for row in rows] == [1, 2]
    for row in rows:
        assert set(row) == {field.name for field in fields(visibility.Row)}
        assert row["embree_rays_per_s"] == row["rays"]
        # a closed head's vertices have half of all directions above them; mouth and eyes are shut in
        assert 0.4 < row["rays"] / (96 * row["points"]) < 0.6
        assert 0.2 < row["blocked"] < 0.6


def test_embree_is_left_out_where_it_is_not(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert embree_peer.embree_ms(*[torch.zeros(0, 3)] * 4) is None


def test_mesh_rows_are_of_heads_in_the_picture(monkeypatch, capsys):
    monkeypatch.setitem(mesh.SWEEPS, "cpu", mesh.Sweep((24,), (1, 2)))
    monkeypatch.setattr(mesh, "FRAMES", 2)
    before = torch.get_num_threads()
    mesh.main("cpu", True)
    assert torch.get_num_threads() == before
    rows = json.loads(capsys.readouterr().out)
    assert [row["threads"] for row in rows] == [1, 2]
    for row in rows:
        assert set(row) == {field.name for field in fields(mesh.Row)}
        assert all(value > 0 for name, value in row.items() if name.endswith("_ms"))
        assert 0.2 < row["covered"] < 0.8
        stages = row["rasterize_ms"] + row["interpolate_ms"] + row["antialias_ms"]
        assert row["forward_ms"] == pytest.approx(stages)
    mesh.main("cpu", False)
    assert len(capsys.readouterr().out.splitlines()) == 1 + 1 + 2


@torch.no_grad()
def test_the_gbuffers_channels_are_counted_right():
    subject = make_avatar("cpu", device="cpu")
    motion = subject.move(make_parameters(0))
    surface = subject.surface(motion).channels()
    assert sum(surface[name].shape[1] for name in SURFACE_CHANNELS) + 1 == raster.GBUFFER_CHANNELS
    assert subject.rasterize(motion, make_camera(16)).depth.shape[2] == 1


def test_avatar_rows_time_only_what_is_not_cached(brief):
    rows = avatar.measure(torch.device("cpu"), size=24)
    ran = {row["moves"]: [stage for stage in avatar.STAGES[:-1] if row[f"{stage}_ms"] > 0] for row in rows}
    assert ran == {
        "everything": ["light", "motion", "raster", "shading"],
        "head": ["motion", "raster", "shading"],
        "camera": ["raster", "shading"],
        "light": ["light", "shading"],
        "exposure": ["shading"],
    }
    for row in rows:
        # whole frames, timed once here: their stages and what is between them
        assert row["total_ms"] > sum(row[f"{stage}_ms"] for stage in avatar.STAGES[:-1])
        assert row["frames_per_second"] == pytest.approx(1e3 / row["total_ms"])


def test_driving_is_measured_stage_by_stage(brief):
    head = replace(make_template(), expression_names=SHAPES[:50])
    row = drive.measure(torch.device("cpu"), size=24, template=head, items=drive._signals(), pictures=False)
    stages = [row[f"{name}_ms"] for name in ("track", "pose", "picture", "jpeg")]
    assert row["delay_ms"] == pytest.approx(sum(stages))
    assert row["pictures_per_second"] == pytest.approx(1e3 / max(sum(stages[:2]), sum(stages[2:])))


def test_viewer_rows_are_of_all_that_can_be_moved(brief):
    rows = view.measure(torch.device("cpu"), size=24)
    assert [row["moves"] for row in rows] == list(view.MOVES)
    assert all(row["picture_ms"] > 0 and row["jpeg_ms"] > 0 for row in rows)
    for row in rows:
        assert row["pictures_per_second"] == pytest.approx(1e3 / (row["picture_ms"] + row["jpeg_ms"]))
    rows = view.measure_splats(torch.device("cpu"))
    assert [row["moves"] for row in rows] == [move for move in view.MOVES if move != "camera"]
    assert all(row["splats_ms"] > 0 for row in rows)


def fake_gsplat(scene, calls):
    """What of gsplat's interface the benchmark uses, for one camera and all Gaussians (packed=False); shapes
    are checked, not results."""
    count, size = len(scene.means), scene.camera.width
    tiles = -(-size // TILE)

    def rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height, *, packed):
        assert (means.shape, quats.shape, scales.shape, opacities.shape) == (
            (count, 3),
            (count, 4),
            (count, 3),
            (count,),
        )
        assert (viewmats.shape, Ks.shape, width, height, packed) == ((1, 4, 4), (1, 3, 3), size, size, False)
        calls.append("rasterization")
        projection = project(means, quats, scales, opacities, scene.camera)
        bins = bin_tiles(projection, width=width, height=height)
        lists = {
            "isect_offsets": bins.tile_offsets[:-1].view(1, tiles, tiles),
            "flatten_ids": bins.gaussians,
            "tile_size": TILE,
        }
        return (
            colors,
            None,
            {
                "means2d": projection.means2d[None],
                "conics": projection.conics[None],
                "opacities": projection.opacities[None],
                **lists,
            },
        )

    def rasterize_to_pixels(
        means2d, conics, colors, opacities, image_width, image_height, tile_size, isect_offsets, flatten_ids
    ):
        assert (means2d.shape, conics.shape, opacities.shape) == ((1, count, 2), (1, count, 3), (1, count))
        assert isect_offsets.shape == (1, tiles, tiles)
        calls.append("rasterize_to_pixels")
        sums = means2d.sum() + conics.sum() + opacities.sum()
        image = colors.sum(dim=(0, 1)).expand(1, image_height, image_width, -1)
        return image, sums.expand(1, image_height, image_width, 1)

    return types.SimpleNamespace(rasterization=rasterization, rasterize_to_pixels=rasterize_to_pixels)


def test_gsplat_is_timed_by_stage(device, monkeypatch):
    scene, calls = make_disc(50, 40, device), []
    monkeypatch.setattr(gsplat_peer, "_gsplat", lambda: fake_gsplat(scene, calls))
    times = gsplat_peer.gsplat_times(scene, 11)
    assert times.forward > 0
    assert times.backward > 0
    assert set(calls) == {"rasterization", "rasterize_to_pixels"}


def test_without_gsplat_there_are_no_figures_and_a_broken_one_says_why(device, monkeypatch, capsys):
    scene = make_disc(50, 40, device)
    monkeypatch.setattr(gsplat_peer, "_gsplat", lambda: None)
    assert gsplat_peer.gsplat_times(scene, 3) is None
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(gsplat_peer, "_gsplat", lambda: types.ModuleType("gsplat"))
    assert gsplat_peer.gsplat_times(scene, 3) is None
    assert capsys.readouterr().err.startswith("gsplat left out: AttributeError")


@pytest.mark.parametrize(
    "error", [AssertionError(), ImportError("no CUDA"), KeyError("means2d"), TypeError("packed")]
)
@pytest.mark.parametrize("where", ["import", "call"])
def test_whatever_gsplat_raises_the_benchmark_goes_on(monkeypatch, capsys, error, where):
    def fail(*_, **__):
        raise error

    broken = types.SimpleNamespace(rasterization=fail)
    monkeypatch.setattr(gsplat_peer, "_gsplat", fail if where == "import" else lambda: broken)
    assert gsplat_peer.gsplat_times(make_disc(50, 40, torch.device("cpu")), 3) is None
    assert capsys.readouterr().err.startswith(f"gsplat left out: {type(error).__name__}")
