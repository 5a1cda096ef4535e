import math

import numpy as np
import OpenImageIO
import pytest
import torch

from samira_warp.geometry.camera import Camera
from samira_warp.io.images import write_exr
from samira_warp.kernels.cubemap.equirect import picture_equirect
from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.kernels.cubemap.lookup import sample_cubemap
from samira_warp.light import Environment, encode_srgb, shade
from samira_warp.light.cross import cube_to_cross
from samira_warp.light.equirect import (
    cube_to_equirect,
    direction_to_equirect,
    equirect_directions,
    equirect_to_cube,
    turn_directions,
)
from samira_warp.light.radiance_map import RadianceMap
from samira_warp.reference.cubemap.equirect import picture_equirect as reference_picture
from samira_warp.support.errors import UserError
from samira_warp.surface import Surface


def write(path, pixels, format=OpenImageIO.FLOAT):
    height, width, channels = pixels.shape
    out = OpenImageIO.ImageOutput.create(str(path))
    out.open(str(path), OpenImageIO.ImageSpec(width, height, channels, format))
    out.write_image(pixels)
    out.close()
    return path


def mean_radiance(cubemap):
    areas = texel_solid_angles(cubemap.shape[1], dtype=torch.float64)[..., None]
    return (cubemap.double() * areas).sum(dim=(0, 1, 2)) / (4 * math.pi)


def equirect_mean(equirect):
    edges = torch.cos(torch.linspace(0, math.pi, equirect.shape[0] + 1, dtype=torch.float64))
    return (equirect.double().mean(dim=1) * (edges[:-1] - edges[1:])[:, None] / 2).sum(dim=0)


@pytest.mark.parametrize(
    ("direction", "rotate", "column", "row"),
    [
        ((0, 0, -1), 0, 0.5, 0.5),  # straight ahead of the camera: the centre
        ((1, 0, 0), 0, 0.75, 0.5),  # +x: the right-hand quarter
        ((-1, 0, 0), 0, 0.25, 0.5),
        ((0, math.sqrt(0.5), -math.sqrt(0.5)), 0, 0.5, 0.25),  # up: the upper rows
        ((0, 0, -1), 90, 0.75, 0.5),
        ((1, 0, 0), 180, 0.25, 0.5),
    ],
)
def test_convention(direction, rotate, column, row):
    turned = turn_directions(torch.tensor(direction, dtype=torch.float64), rotate)
    u, v = direction_to_equirect(turned)
    assert (u.item(), v.item()) == (pytest.approx(column), pytest.approx(row))


@pytest.mark.parametrize("rotate", [0.0, 40.0, -80.0])
@pytest.mark.parametrize(("row", "column"), [(10, 5), (20, 60), (31, 33)])
def test_a_bright_pixel_is_found_where_the_convention_puts_it(device, rotate, row, column):
    equirect = torch.zeros(64, 128, 3)
    equirect[row, column] = 1.0
    cubemap = equirect_to_cube(equirect.to(device), size=64)
    directions = equirect_directions(128).view(-1, 3)
    seen = sample_cubemap(cubemap, turn_directions(directions, rotate).to(device))
    x, y, z = directions[seen[:, 0].argmax().item()].tolist()
    u = 0.5 + math.atan2(x, -z) / (2 * math.pi) + rotate / 360
    # Within a pixel of the 64 x 128 map.
    assert (u - (column + 0.5) / 128 + 0.5) % 1.0 - 0.5 == pytest.approx(0, abs=1 / 128)
    assert math.acos(y) / math.pi == pytest.approx((row + 0.5) / 64, abs=1 / 64)


@pytest.mark.parametrize("size", [8, 32, 64])
def test_mean_radiance_is_kept(device, generator, size):
    # Light as in real maps: 1 % of the pixels carry nearly all of it.
    equirect = torch.rand(64, 128, 3, generator=generator) + 500 * (
        torch.rand(64, 128, 1, generator=generator) < 0.01
    )
    cubemap = equirect_to_cube(equirect.to(device), size=size).cpu()
    # Samples are dense, not infinitely so: each of the 80 lamps of one pixel is off by a few percent.
    assert torch.allclose(mean_radiance(cubemap), equirect_mean(equirect), rtol=1e-2)


def test_uniform_maps_stay_uniform(device):
    cubemap = equirect_to_cube(torch.full((32, 64, 3), 2.5, device=device), size=16)
    assert torch.allclose(cubemap, torch.full_like(cubemap, 2.5), rtol=1e-5)
    assert torch.allclose(cube_to_equirect(cubemap, height=10), torch.tensor(2.5, device=device), rtol=1e-5)


def test_equirect_to_cube_and_back(device):
    directions = equirect_directions(64, device=device)
    smooth = 1 + 0.5 * directions
    back = cube_to_equirect(equirect_to_cube(smooth, size=64), height=64)
    # Bilinear twice over a function of slope 0.5, with texels and pixels of 0.03 and 0.05 rad: second-order
    # errors.
    assert (back - smooth).abs().max() < 2e-3


def test_resampling_is_differentiable(generator):
    equirect = torch.rand(8, 16, 1, generator=generator, requires_grad=True)
    cubemap = equirect_to_cube(equirect, size=4)
    upstream = torch.randn(cubemap.shape, generator=generator)
    (adjoint,) = torch.autograd.grad(cubemap, equirect, upstream)
    assert (cubemap * upstream).sum().item() == pytest.approx(
        (equirect * adjoint).sum().item(), rel=1e-4, abs=1e-4
    )


@pytest.mark.parametrize("suffix", [".hdr", ".exr"])
def test_load(tmp_path, suffix, generator):
    pixels = torch.rand(32, 64, 3, generator=generator).numpy() * 4
    pixels[5, 7] = 900.0
    path = write(tmp_path / f"lämp 1{suffix}", pixels)
    # .hdr shares one exponent of 8 bits of mantissa between the channels.
    assert np.allclose(
        RadianceMap.read(path).texels.numpy(), pixels, rtol=1e-3, atol=8 / 256 if suffix == ".hdr" else 0
    )
    environment = Environment.load(path, exposure=2.0, size=32)
    mean = equirect_mean(torch.from_numpy(pixels))
    assert torch.allclose(mean_radiance(environment.specular), mean, rtol=2e-2)
    assert torch.allclose(environment.mean_irradiance(), 2 * mean, rtol=2e-2)
    light = environment.filtered()
    assert light.irradiance.shape == (6, 16, 16, 3)
    assert [mip.shape[1] for mip in light.specular] == [32, 16, 16, 8, 8, 4, 4, 4, 4]


def test_rotation_turns_the_light(tmp_path):
    pixels = np.zeros((32, 64, 3), np.float32)
    pixels[16, 32] = 1.0
    path = write(tmp_path / "lamp.exr", pixels)
    # Column 0.5 is seen where 0.5 + azimuth / 360 + 0.25 is 0.5: at azimuth -90 degrees, -x.
    sides = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    for turned in (
        Environment.load(path, rotate=90.0, size=32).filtered(),
        Environment.load(path, rotate=120.0, size=32).turned(-30.0).filtered(),
        Environment.load(path, size=32).filtered().turned(90.0),
    ):
        lit = irradiance_of(turned, sides)
        assert lit[1] > 3 * lit[[0, 2, 3, 4, 5]].max()


def irradiance_of(light, normals):
    """(M,) E_d of matt surfaces that face (M, 3) normals."""
    one = torch.ones(len(normals), 1)
    matt = Surface.of(albedo=one.expand(-1, 3), normal=normals, roughness=one, specular=0 * one)
    return shade(matt, normals, light).irradiance[:, 0]


# columns of 64, as rolling takes whole ones
@pytest.mark.parametrize("columns", [0, 6, -30])
def test_turning_a_look_is_turning_the_light(columns):
    rotate = 360 * columns / 64
    panorama = 1 + equirect_directions(32)
    directions = equirect_directions(9).view(-1, 3)
    turned = equirect_to_cube(panorama.roll(-columns, dims=1), size=32)
    seen = sample_cubemap(equirect_to_cube(panorama, size=32), turn_directions(directions, rotate))
    # two resamplings of a map of slope 1, whose pixels are the coarsest: second-order errors
    assert (sample_cubemap(turned, directions) - seen).abs().max() < (math.pi / 32) ** 2


@pytest.mark.parametrize("size", [(1, 2), (2, 4), (32, 64)])
def test_a_picture_of_a_panorama_is_smooth_and_within_its_range(size, generator):
    panorama = torch.rand(*size, 3, generator=generator)
    u = torch.linspace(-math.pi, math.pi, 2001)
    around = torch.stack([torch.sin(u), torch.full_like(u, 0.2), -torch.cos(u)], dim=-1)
    seen = picture_equirect(panorama, torch.nn.functional.normalize(around, dim=-1))
    assert seen.min() >= panorama.min() - 1e-6
    assert seen.max() <= panorama.max() + 1e-6
    assert torch.allclose(seen[0], seen[-1], atol=1e-3)
    # a B-spline's slope is at most the difference of neighbouring pixels a pixel
    assert (seen[1:] - seen[:-1]).abs().max() <= 1.01 * size[1] / 2000


def test_a_picture_of_a_panorama_keeps_a_slope():
    directions = equirect_directions(40).view(-1, 3)
    # a spline of a linear function is that function; directions curve by a pixel's angle squared
    assert (picture_equirect(equirect_directions(64), directions) - directions).abs().max() < (
        math.pi / 64
    ) ** 2


@pytest.mark.parametrize("size", [(1, 2), (2, 4), (3, 6), (32, 64)])
def test_a_picture_of_a_panorama_matches_the_twin(device, generator, size):
    panorama = torch.rand(*size, 3, generator=generator)
    directions = torch.nn.functional.normalize(torch.randn(5000, 3, generator=generator), dim=-1)
    # the seam and the middle; a pole itself lies in every column
    directions[:4] = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]])
    expected = reference_picture(panorama.double(), directions.double())
    found = picture_equirect(panorama.to(device), directions.view(50, 100, 3).to(device)).view(-1, 3).cpu()
    # arc cosine loses half the digits near its ends, 3e-4 rad at the worst, where pixels are 0.1 wide; slopes
    # are at most 1 a pixel
    near_pole = directions[:, 1].abs() > 0.999
    assert (found[~near_pole] - expected[~near_pole]).abs().max() < 2e-5
    assert (found - expected).abs().max() < 5e-3


def test_a_picture_of_a_panorama_has_the_same_bits_for_any_number_of_threads(generator, use_threads):
    panorama, directions = torch.rand(16, 32, 3, generator=generator), equirect_directions(100)
    pictures = []
    for count in (1, 2):
        use_threads(count)
        pictures.append(picture_equirect(panorama, directions))
    assert torch.equal(*pictures)


@pytest.mark.parametrize(
    ("panorama", "directions"),
    [((0, 0, 3), (2, 3)), ((4, 8, 4), (2, 3)), ((4, 8, 3), (2, 2))],
)
def test_a_picture_of_nothing_is_refused(panorama, directions):
    with pytest.raises(UserError):
        picture_equirect(torch.zeros(panorama), torch.ones(directions))


def test_auto_exposure_makes_the_mean_irradiance_one(tmp_path, generator):
    pixels = torch.rand(32, 64, 3, generator=generator).numpy() * 7
    environment = Environment.load(write(tmp_path / "map.exr", pixels), exposure="auto", size=32)
    luminance = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    assert (environment.mean_irradiance() @ luminance).item() == pytest.approx(1)
    # the mean over directions of the irradiance that shading reads, which is of 16 x 16 texels
    light = environment.filtered()
    mean = light.exposure * mean_radiance(light.irradiance)
    assert (mean @ luminance).item() == pytest.approx(1, rel=2e-3)
    # whatever it was exposed to before
    fixed = Environment.load(tmp_path / "map.exr", exposure=5.0, size=32)
    assert fixed.exposed("auto").exposure == pytest.approx(environment.exposure)
    with pytest.raises(UserError, match="black"):
        Environment.load(write(tmp_path / "black.exr", 0 * pixels), exposure="auto", size=32)


def test_an_8_bit_picture_is_taken_when_it_is_asked_for(tmp_path):
    levels = np.tile(np.arange(16, dtype=np.uint8)[None, :, None] * 17, (8, 1, 3))
    path = write(tmp_path / "picture.png", levels, OpenImageIO.UINT8)
    texels = RadianceMap.read(path, ldr=True).texels
    assert torch.allclose(encode_srgb(texels), torch.from_numpy(levels) / 255.0, atol=1e-6)
    assert Environment.load(path, ldr=True, size=16).specular.shape == (6, 16, 16, 3)


@pytest.mark.parametrize("size", [(1, 2), (5, 10), (33, 66), (300, 600)])
def test_panoramas_of_any_size(tmp_path, size):
    environment = Environment.load(write(tmp_path / "map.exr", np.full((*size, 3), 2, np.float32)), size=16)
    assert torch.allclose(environment.specular, torch.tensor(2.0), rtol=1e-4)


@pytest.mark.parametrize("turn", [0.0, 70.0])
def test_a_cross_is_the_same_light_as_its_panorama(tmp_path, generator, turn):
    panorama = torch.rand(8, 16, 3, generator=generator).repeat_interleave(8, 0).repeat_interleave(8, 1)
    lying = cube_to_cross(equirect_to_cube(panorama, size=64))
    write_exr(tmp_path / "cross.exr", lying.numpy())
    write_exr(tmp_path / "panorama.exr", panorama.numpy())
    cross, whole = (
        Environment.load(tmp_path / f"{name}.exr", size=32, rotate=turn) for name in ("cross", "panorama")
    )
    # only the edges of the panorama's blocks differ, which are resampled twice; two maps at random would
    # differ by a third
    assert (cross.specular - whole.specular).abs().mean() < 0.02
    assert torch.allclose(mean_radiance(cross.specular), mean_radiance(whole.specular), rtol=5e-3)


def test_a_panorama_in_memory_is_what_its_file_is(tmp_path, generator):
    panorama = 9 * torch.rand(16, 32, 3, generator=generator)
    light = Environment.from_panorama(panorama, size=32)
    read = Environment.load(write(tmp_path / "map.exr", panorama.numpy()), size=32)
    assert torch.equal(light.diffuse, read.diffuse)
    assert torch.equal(light.specular, read.specular)
    assert torch.equal(light.visible.texels, read.visible.texels)


@pytest.mark.parametrize(
    ("radiance", "options", "named"),
    [
        (torch.ones(8, 8, 3), {}, r"radiance: expected \(H, 2 H, 3\), found \(8, 8, 3\)"),
        (torch.ones(8, 16, 1), {}, "radiance"),
        (torch.ones(8, 16, 3).double(), {}, "radiance: .* float64"),
        (torch.full((8, 16, 3), math.inf), {}, "radiance: expected finite"),
        (torch.full((8, 16, 3), -1.0), {}, "radiance: expected finite values of at least 0"),
        (torch.zeros(0, 0, 3), {}, "at least one pixel"),
        (torch.ones(8, 16, 3), {"size": 24}, "size"),
    ],
)
def test_what_is_no_panorama_is_refused(radiance, options, named):
    with pytest.raises(UserError, match=named):
        Environment.from_panorama(radiance, **options)


def test_a_pair_of_maps_is_a_light_for_diffuse_and_one_for_specular(tmp_path, generator):
    diffuse, specular = (
        torch.rand(6, 16, 16, 3, generator=generator),
        5 * torch.rand(6, 64, 64, 3, generator=generator),
    )
    Environment.from_cubemaps(diffuse, specular).save(tmp_path)
    for read in (
        Environment.load(tmp_path),
        Environment.load(tmp_path / "light_diffuse.exr", tmp_path / "light_specular.exr"),
    ):
        assert torch.equal(read.diffuse, diffuse)
        assert torch.equal(read.specular, specular)
    # whatever it is turned and exposed by, its texels stay
    turned = Environment.load(tmp_path, rotate=90.0, exposure=3.0, size=128)
    assert torch.equal(turned.diffuse, diffuse)
    assert (turned.rotate, turned.exposure) == (90.0, 3.0)


def test_background_is_the_environment_straight_ahead():
    pixels = equirect_directions(64)
    radiance = equirect_to_cube(0.5 + 0.5 * pixels, size=64)
    environment = Environment(radiance, radiance)
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))
    camera = Camera(flip, fx=20.0, fy=20.0, cx=8.0, cy=6.0, width=16, height=12)
    seen = environment.background(camera, color_space="raw")
    # The map holds directions: the picture must be the camera's rays; it looks along -z with y up.
    assert torch.allclose(seen, 0.5 + 0.5 * camera.ray_directions(), atol=1e-3)
    assert seen[0, 8, 1] > seen[-1, 8, 1]
    assert seen[6, 8, 2] < 0.02


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: path, "no such file"),
        (lambda path: path.write_bytes(b"not an image") and path, "readable"),
        (
            lambda path: write(path.with_suffix(".png"), np.zeros((8, 16, 3), np.uint8), OpenImageIO.UINT8),
            "8-bit",
        ),
        (lambda path: write(path, np.ones((8, 8, 3), np.float32)), "8 x 8"),
        (lambda path: write(path, np.ones((8, 12, 3), np.float32)), "4:3 or 3:4"),
        (lambda path: path.mkdir() or path, "light_diffuse.exr and light_specular.exr"),
        (lambda path: write(path, np.full((8, 16, 3), np.inf, np.float32)), "384 values"),
        (lambda path: write(path, np.ones((8, 16, 2), np.float32)), "channels"),
    ],
)
def test_unusable_files_are_refused_in_one_line(tmp_path, make, message):
    path = make(tmp_path / "light.exr")
    with pytest.raises(UserError, match=message) as error:
        Environment.load(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("exposure", math.nan),
        ("exposure", math.inf),
        ("exposure", -1.0),
        ("exposure", "bright"),
        ("rotate", math.nan),
        ("rotate", math.inf),
        ("size", 0),
        ("size", -16),
        ("size", 24),
        ("size", 32.0),
    ],
)
def test_bad_options_are_refused_before_the_file_is_read(tmp_path, name, value):
    with pytest.raises(UserError, match=f"^{name}: expected .*, found {value}"):
        Environment.load(tmp_path / "missing.exr", **{name: value})


@pytest.mark.parametrize(
    ("diffuse", "specular", "named"),
    [
        ((6, 3, 3, 3), (6, 16, 16, 3), "diffuse"),
        ((6, 4, 4, 3), (6, 24, 24, 3), "specular"),
        ((6, 4, 2, 3), (6, 16, 16, 3), "diffuse"),
        ((6, 4, 4, 3), (6, 16, 16, 1), "specular"),
        ((6, 0, 0, 3), (6, 16, 16, 3), "diffuse"),
    ],
)
def test_cubemaps_that_cannot_be_filtered_are_refused(diffuse, specular, named):
    with pytest.raises(UserError, match=f"^{named}: "):
        Environment.from_cubemaps(torch.ones(diffuse), torch.ones(specular))


def test_lights_are_told_apart_by_identity():
    light = Environment.from_cubemaps(torch.ones(6, 2, 2, 3), torch.ones(6, 16, 16, 3))
    # equality of tensors would be one truth value a texel
    assert light == light
    assert light != Environment.from_cubemaps(torch.ones(6, 2, 2, 3), torch.ones(6, 16, 16, 3))
    assert len({light, light.visible}) == 2


def test_exposures_may_be_whole_numbers_or_zero():
    light = Environment.from_cubemaps(torch.ones(6, 2, 2, 3), torch.ones(6, 16, 16, 3))
    up = torch.tensor([[0.0, 1.0, 0.0]])
    plain = irradiance_of(light.filtered(), up)
    for exposed in (light.exposed(2).filtered(), light.filtered().exposed(2)):
        assert torch.equal(irradiance_of(exposed, up), 2 * plain)
    assert irradiance_of(light.exposed(0).filtered(), up).item() == 0.0


@pytest.mark.parametrize("make", [Environment.filtered, lambda light: light], ids=["filtered", "as read"])
def test_turning_and_exposing_add_up_and_copy_no_texel(make):
    light = make(Environment.from_cubemaps(torch.ones(6, 2, 2, 3), torch.ones(6, 16, 16, 3)))
    moved = light.turned(30.0).exposed(0.5).turned(-50).exposed(3)
    assert (light.rotate, light.exposure) == (0.0, 1.0)
    assert (moved.rotate, moved.exposure) == (-20.0, 1.5)
    assert moved.specular is light.specular
    there = moved.to("cpu")
    assert (there.rotate, there.exposure) == (-20.0, 1.5)
    for value in (math.nan, math.inf, "far"):
        with pytest.raises(UserError, match="rotate"):
            light.turned(value)
    for value in (-0.5, math.nan, "bright"):
        with pytest.raises(UserError, match="exposure"):
            light.exposed(value)


def test_auto_is_a_question_to_the_light_before_it_is_filtered():
    light = Environment.from_cubemaps(torch.ones(6, 2, 2, 3), torch.full((6, 16, 16, 3), 8.0))
    with pytest.raises(UserError, match="exposure: expected a factor, once a light is filtered"):
        light.filtered().exposed("auto")
    # E_d of the diffuse map alone
    assert light.exposed(7.0).exposed("auto").exposure == pytest.approx(1.0, rel=1e-6)


def test_a_light_that_is_turned_and_exposed_is_saved_as_it_is(tmp_path, generator):
    smooth = 1.0 + 0.5 * texel_directions(32)
    light = Environment.from_cubemaps(smooth[:, ::2, ::2].contiguous(), smooth).turned(70.0).exposed(2.0)
    light.save(tmp_path)
    read = Environment.load(tmp_path)
    assert (read.rotate, read.exposure) == (0.0, 1.0)
    normals = torch.nn.functional.normalize(torch.randn(50, 3, generator=generator), dim=-1)
    # the maps' slope is 1 and their texels are a sixteenth wide: second-order errors of a resampling
    expected, found = (irradiance_of(one.filtered(), normals) for one in (light, read))
    assert (found - expected).abs().max() < 2 * (1 / 8) ** 2
    assert (expected.max() - expected.min()) > 0.5


def test_the_background_is_display_values_of_the_light_as_it_is_turned_and_exposed():
    u = torch.linspace(0, 1, 65)[:-1] + 1 / 128
    panorama = (u[None, :, None] ** 2).expand(32, 64, 3).contiguous()
    light = Environment(torch.ones(6, 2, 2, 3), torch.ones(6, 16, 16, 3), RadianceMap(panorama))
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))
    camera = Camera(flip, fx=2000.0, fy=2000.0, cx=8.0, cy=6.0, width=16, height=12)
    for turned, exposed, radiance in ((0, 1, 0.25), (36, 1, 0.36), (-36, 2, 0.32), (72, 4, 1.0)):
        # the camera's narrow view of the middle column, at 0.5 + turned / 360; clipped at 1
        seen = light.turned(turned).exposed(exposed).background(camera)
        assert seen.shape == (12, 16, 3)
        # a B-spline of u^2 is off by a third of a pixel's width squared, the view by 1 / 500 rad
        assert torch.allclose(seen, encode_srgb(torch.tensor(radiance)), atol=5e-3)
        assert torch.equal(light.turned(360).display_map().texels, light.display_map().texels)
    raw = light.exposed(0.5).background(camera, color_space="raw")
    assert torch.allclose(raw, torch.tensor(0.125), atol=5e-3)


def test_real_maps_have_the_brightness_that_the_dataset_states(subject):
    import json

    luminance = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    behind = torch.tensor([[0.0, 0.0, 1.0]])
    for name in ("city", "lobby"):
        stated = json.loads((subject / "gt" / "relight" / f"{name}.json").read_text())
        environment = Environment.load(subject / stated["file"], rotate=stated["azimuth_degrees"], size=64)
        assert (mean_radiance(environment.diffuse) @ luminance).item() == pytest.approx(
            stated["mean_radiance"], rel=1e-2
        )
        towards = turn_directions(behind, environment.rotate)
        front = sample_cubemap(environment.filtered().irradiance, towards).double() @ luminance
        assert front.item() == pytest.approx(stated["front_irradiance_over_pi"], rel=1.5e-2)
