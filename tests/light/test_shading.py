import inspect
import math
import re
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from samira_warp.kernels.shading import deferred
from samira_warp.kernels.shading.deferred import shade_gbuffer
from samira_warp.light import FilteredLight, Shaded, compose, decode_srgb, encode_srgb, shade, shading
from samira_warp.light.brdf import brdf_table
from samira_warp.reference.shading import deferred as reference
from samira_warp.support.errors import UserError
from samira_warp.surface import CHANNELS, Surface

RANGES = {"roughness": (0.08, 0.98), "specular": (0.02, 0.12)}
"""Ranges of what a surface is made of, where they are not those of the table."""


def unit(values):
    return torch.nn.functional.normalize(values, dim=-1)


def make_points(count, generator):
    """A surface with every channel anywhere in its range, and views with n . v from about 0.1 to 1."""
    options = {"generator": generator, "dtype": torch.float64}
    channels = {}
    for name, channel in CHANNELS.items():
        low, high = RANGES.get(name, (channel.low, channel.high))
        channels[name] = (
            unit(torch.randn(count, channel.width, **options))
            if channel.blend == "direction"
            else low + (high - low) * torch.rand(count, channel.width, **options)
        )
    surface = Surface(**channels)
    return surface, unit(surface.normal + 0.4 * torch.randn(count, 3, **options))


def single(tensor, device):
    """A leaf of single precision."""
    return tensor.detach().float().to(device).requires_grad_()


def single_points(count, generator, device):
    surface, view = make_points(count, generator)
    return surface.map(lambda values: single(values, device)), single(view, device)


def tensors(surface):
    return list(surface.channels().values())


def make_light(generator, device, *, sizes=(4,) * 6):
    maps = [single(torch.rand(6, size, size, 3, generator=generator), device) for size in sizes]
    return FilteredLight(maps[0], tuple(maps[1:]), maps[0])


def maps_of(light):
    return [light.irradiance, *light.specular]


def coverage(count, generator):
    """Alpha of which a quarter is 0, a quarter just too little for a surface, and the rest anything."""
    alpha = 0.01 + 0.99 * torch.rand(count, 1, generator=generator, dtype=torch.float64)
    alpha[::4] = 0
    alpha[1::4] = 0.9 / 255
    return alpha


KERNELS = {
    name: deferred._parameters(getattr(deferred, name))
    for name in ("_shade", "_display_adjoint", "_diffuse_adjoint", "_specular_adjoint")
}


@pytest.mark.parametrize("kernel", KERNELS)
def test_kernels_take_channels_and_their_gradients_in_the_tables_order(kernel):
    for prefix in ("", "grad_"):
        in_order = [prefix + name for name in CHANNELS]
        taken = [name for name in KERNELS[kernel] if name in in_order]
        assert taken == [name for name in in_order if name in taken]


def test_what_the_pass_reads_gets_a_gradient():
    read = [name for name in KERNELS["_shade"] if name in (*CHANNELS, "view", "alpha")]
    assert read == [*CHANNELS, "view", "alpha"]
    for name in read:
        assert any(f"grad_{name}" in parameters for parameters in KERNELS.values()), name


def test_the_reference_takes_what_the_operator_takes():
    assert inspect.signature(shade_gbuffer) == inspect.signature(reference.shade_gbuffer)


@pytest.mark.parametrize("color_space", ["srgb", "raw"])
def test_shade_matches_the_reference(device, generator, color_space):
    """Every output, and its gradients to every channel of the G-buffer and every texel of both
    environments."""
    surface, view = make_points(1000, generator)
    options = {"generator": generator, "dtype": torch.float64}
    # Some colours are below the end of the sRGB curve's line.
    maps = [torch.rand(6, size, size, 3, **options) ** 4 for size in (16, 16, 8, 4, 4, 2)]
    inputs = {**surface.channels(), "view": view, "alpha": coverage(1000, generator)}
    inputs |= {f"map {index}": texels for index, texels in enumerate(maps)}
    background = torch.rand(1000, 3, **options)
    upstream = [torch.randn(1000, 3, **options) for _ in Shaded._fields]

    def run(operator, convert):
        given = {name: convert(values).requires_grad_() for name, values in inputs.items()}
        first, *mips = (given[f"map {index}"] for index in range(len(maps)))
        shaded = operator(
            Surface(**{name: given[name] for name in CHANNELS}),
            given["view"],
            given["alpha"],
            irradiance=first,
            mips=tuple(mips),
            brdf=brdf_table(first.device),
            background=convert(background),
            encoded=color_space == "srgb",
        )
        grads = torch.autograd.grad(shaded, list(given.values()), [convert(grad) for grad in upstream])
        return shaded, dict(zip(given, grads, strict=True))

    expected, expected_grads = run(reference.shade_gbuffer, lambda values: values.clone())
    found, grads = run(shade_gbuffer, lambda values: values.float().to(device))
    for value, wanted in zip(found, expected, strict=True):
        assert torch.allclose(value.cpu().double(), wanted, atol=1e-5)
    for name, wanted in expected_grads.items():
        grad = grads[name].cpu().double()
        # Single precision moves a few lookups to the next cell, where the slope is another one.
        assert (grad - wanted).norm() <= 2e-3 * wanted.norm(), name
        assert torch.nn.functional.cosine_similarity(grad.flatten(), wanted.flatten(), dim=0) > 0.99999, name


def test_a_light_is_shaded_as_its_maps_are(device, generator):
    """`light.shade` with its defaults is the operator with the light's maps and the BRDF's table."""
    surface, view = single_points(40, generator, device)
    light = make_light(generator, device)
    terms = {"irradiance": light.irradiance, "mips": light.specular, "brdf": brdf_table(device)}
    ones = torch.ones(40, 3, device=device)
    wanted = shade_gbuffer(surface, view, ones[:, :1], **terms, background=ones)
    assert all(map(torch.equal, shade(surface, view, light), wanted))


def test_a_light_is_turned_and_exposed_as_the_reference_is(device, generator):
    """Every output and gradient, against maps of another brightness and a scene that is turned in float64."""
    surface, view = make_points(1000, generator)
    maps = [torch.rand(6, size, size, 3, generator=generator, dtype=torch.float64) for size in (16, 16, 8, 4)]
    upstream = [torch.randn(1000, 3, generator=generator, dtype=torch.float64) for _ in Shaded._fields]
    # what turns by 50 degrees is seen by a scene whose azimuths atan2(x, -z) grow by as much
    cosine, sine = math.cos(math.radians(50)), math.sin(math.radians(50))
    turn = torch.tensor([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], dtype=torch.float64)

    exact = [values.clone().requires_grad_() for values in (*tensors(surface), view, *maps)]
    first, *mips = (0.7 * texels for texels in exact[-len(maps) :])
    channels = dict(zip(CHANNELS, exact, strict=False))
    expected = reference.shade_gbuffer(
        Surface(**{**channels, "normal": channels["normal"] @ turn}),
        exact[len(CHANNELS)] @ turn,
        torch.ones(1000, 1, dtype=torch.float64),
        irradiance=first,
        mips=tuple(mips),
        brdf=brdf_table(torch.device("cpu")),
        background=torch.zeros(1, 3),
    )
    inner = [single(values, device) for values in exact]
    light = (
        FilteredLight(inner[-len(maps)], tuple(inner[1 - len(maps) :]), inner[-len(maps)])
        .turned(50)
        .exposed(0.7)
    )
    surface = Surface(**dict(zip(CHANNELS, inner, strict=False)))
    found = shade(surface, inner[len(CHANNELS)], light, background=0.0)
    for value, wanted in zip(found, expected, strict=True):
        assert torch.allclose(value.cpu().double(), wanted, atol=1e-5)
    wanted = torch.autograd.grad(expected, exact, upstream)
    grads = torch.autograd.grad(found, inner, [grad.float().to(device) for grad in upstream])
    for grad, expected_grad in zip(grads, wanted, strict=True):
        # single precision moves a few lookups to the next cell, where the slope is another one
        assert (grad.cpu().double() - expected_grad).norm() <= 2e-3 * expected_grad.norm()


def test_a_neutral_light_costs_nothing(generator, monkeypatch):
    """Neither turned nor exposed, it is shaded as if there were no such thing, without a copy."""
    surface, view = single_points(5, generator, torch.device("cpu"))
    light = make_light(generator, torch.device("cpu"))
    seen = []
    monkeypatch.setattr(shading, "shade_gbuffer", lambda *given, **_: seen.append(given))
    shade(surface, view, light)
    shade(surface, view, light.turned(0.0).exposed(1.0))
    assert all(given[0] is surface and given[1] is view for given in seen)
    shade(surface, view, light.turned(1.0).exposed(2.0))
    assert seen[2][0].albedo is surface.albedo
    assert torch.equal(seen[2][0].response_specular, 2 * surface.response_specular)


@pytest.mark.parametrize("encoded", [True, False])
def test_reference_gradients_are_those_of_finite_differences(generator, encoded):
    surface, view = make_points(3, generator)
    alpha = torch.tensor([[0.2], [1.0], [0.9 / 255]], dtype=torch.float64)
    maps = [torch.rand(6, size, size, 3, generator=generator, dtype=torch.float64) for size in (2, 4, 2)]
    terms = {
        "irradiance": maps[0],
        "mips": tuple(maps[1:]),
        "brdf": brdf_table(torch.device("cpu")),
        "background": torch.full((1, 3), 0.3),
    }

    def run(view, alpha, *channels):
        return tuple(reference.shade_gbuffer(Surface(*channels), view, alpha, **terms, encoded=encoded))

    inputs = [tensor.requires_grad_() for tensor in (view, alpha, *tensors(surface))]
    assert torch.autograd.gradcheck(run, inputs, eps=1e-7, atol=1e-4)


def test_roughness_gradient_at_and_beyond_the_borders(device, generator):
    surface, view = single_points(4, generator, device)
    roughness = torch.tensor([[-0.1], [0.0], [1.0], [1.1]], device=device, requires_grad=True)
    light = make_light(generator, device, sizes=(4, 8, 4, 4, 4, 4))
    shaded = shade(replace(surface, roughness=roughness), view, light)
    grads = torch.autograd.grad(shaded.color.sum(), roughness)[0].flatten() != 0
    assert grads.tolist() == [False, True, True, False]


def test_what_nothing_covers_shows_the_background_and_moves_alpha_alone(device, generator):
    surface, view = single_points(3, generator, device)
    light = make_light(generator, device)
    alpha = torch.tensor([[0.0], [0.9 / 255], [0.9 / 255]], device=device, requires_grad=True)
    shaded = shade(surface, view, light, alpha=alpha, background=0.25)
    assert not any(value.any() for value in (shaded.color, shaded.irradiance, shaded.specular_light))
    assert torch.equal(shaded.image, (0.25 * (1 - alpha)).expand(3, 3))
    inputs = [*tensors(surface), view, *maps_of(light), alpha]
    grads = torch.autograd.grad(sum(value.sum() for value in shaded), inputs)
    assert not any(grad.any() for grad in grads[:-1])
    assert torch.equal(grads[-1], torch.full((3, 1), -0.75, device=device))


def test_what_is_covered_no_longer_depends_on_what_is_not(device, generator):
    """Values where nothing is, NaN among them, reach neither the image nor a gradient."""
    surface, view = single_points(8, generator, device)
    light = make_light(generator, device)
    alpha = torch.ones(8, 1, device=device)
    alpha[::2] = 0
    even = torch.arange(0, 8, 2, device=device)

    def keep(values):
        return single(values[1::2], device)

    def spoil(values):
        return single(values.detach().index_fill(0, even, float("nan")), device)

    kept, spoilt = (surface.map(keep), keep(view)), (surface.map(spoil), spoil(view))
    alone, among = shade(*kept, light), shade(*spoilt, light, alpha=alpha, background=0.0)
    assert torch.equal(among.image[1::2], alone.image)
    assert not among.image[::2].any()
    grads, wanted = (
        torch.autograd.grad(shaded.image.sum(), [*tensors(points), seen, *maps_of(light)])
        for shaded, (points, seen) in ((among, spoilt), (alone, kept))
    )
    for grad, expected in zip(grads, wanted, strict=True):
        assert torch.equal(grad if grad.shape == expected.shape else grad[1::2], expected)


def test_image_is_the_composed_colour(device, generator):
    surface, view = single_points(50, generator, device)
    light = make_light(generator, device)
    alpha = torch.rand(50, 1, generator=generator).to(device)
    for color_space in ("srgb", "raw"):
        shaded = shade(surface, view, light, alpha=alpha, background=0.5, color_space=color_space)
        wanted = compose(shaded.color, alpha, 0.5, color_space=color_space)
        # A few roundings of values around 1; the curve's power is another one.
        assert torch.allclose(shaded.image, wanted, atol=1e-5)


def test_borders_of_the_brdf_table_give_the_gradients_of_the_reference(device, generator):
    """Roughness 0 and 1; n . v of 1, grazing, 0 and below."""
    count, options = 8, {"generator": generator, "dtype": torch.float64}
    normal = unit(torch.randn(count, 3, **options))
    across = unit(torch.linalg.cross(normal, torch.randn(count, 3, **options)))
    cosine = torch.tensor([1.0, 1.0, 1e-3, 1e-3, 0.0, 0.0, -0.5, -0.5], dtype=torch.float64)[:, None]
    roughness = torch.tensor([0.0, 1.0] * 4, dtype=torch.float64)[:, None]
    surface, _ = make_points(count, generator)

    def as_single(values):
        return values.float().double()

    surface = replace(surface, normal=normal, roughness=roughness).map(as_single)
    view = as_single(cosine * normal + torch.sqrt(1 - cosine**2) * across)
    # Light without a slope leaves the table's slopes alone; single precision decides on which side of 1 and 0
    # n . v lies.
    light = FilteredLight(*(lambda one: (one, (one,) * 5, one))(torch.ones(6, 2, 2, 3, device=device)))
    twin = surface.map(lambda values: values.clone().requires_grad_())
    wanted = reference.shade_gbuffer(
        twin,
        view,
        torch.ones(count, 1, dtype=torch.float64),
        irradiance=light.irradiance.cpu().double(),
        mips=tuple(mip.cpu().double() for mip in light.specular),
        brdf=brdf_table(torch.device("cpu")),
        background=torch.zeros(1, 3),
    ).color
    surface = surface.map(lambda values: single(values, device))
    found = shade(surface, single(view, device), light).color
    grads = torch.autograd.grad(found.sum(), tensors(surface), retain_graph=True)
    assert all(grad.isfinite().all() for grad in grads)
    for name in ("roughness", "specular"):
        (grad,) = torch.autograd.grad(found.sum(), getattr(surface, name), retain_graph=True)
        (expected,) = torch.autograd.grad(wanted.sum(), getattr(twin, name), retain_graph=True)
        assert torch.allclose(grad.cpu().double(), expected, rtol=1e-3, atol=2e-3), name


def test_same_bits_for_any_number_of_threads(device, generator, use_threads):
    surface, view = single_points(9000, generator, device)
    alpha = single(coverage(9000, generator), device)
    light = make_light(generator, device, sizes=(16, 32, 16, 8, 4, 4))
    inputs = [*tensors(surface), view, alpha, *maps_of(light)]

    def run():
        result = shade(surface, view, light, alpha=alpha)
        loss = sum(value.square().sum() for value in result)
        first = torch.autograd.grad(loss, inputs, retain_graph=True)
        second = torch.autograd.grad(loss, inputs)
        assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
        return *result, *first

    use_threads(1)
    one = run()
    use_threads(2)
    two = run()
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))


def test_zero_normals_see_nothing_and_send_no_nan(device, generator):
    surface, view = single_points(2, generator, device)
    surface, view = surface.map(lambda values: single(0 * values, device)), single(0 * view, device)
    light = make_light(generator, device)
    shaded = shade(surface, view, light)
    grads = torch.autograd.grad(shaded.color.sum(), [*tensors(surface), view, *maps_of(light)])
    assert not shaded.color.any()
    assert all(grad.isfinite().all() for grad in grads)


def test_no_points(device, generator):
    surface, view = single_points(0, generator, device)
    assert shade(surface, view, make_light(generator, device)).color.shape == (0, 3)


SPOILT = {
    "too few": lambda tensor: tensor[:-1],
    "flat": lambda tensor: tensor[..., 0],
    "too wide": lambda tensor: torch.cat([tensor, tensor], dim=-1),
    "double": lambda tensor: tensor.double(),
    "elsewhere": lambda tensor: tensor.to("meta"),
    "no tensor": lambda tensor: tensor.detach().numpy(),
}


@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT)
@pytest.mark.parametrize("name", [*CHANNELS, "view", "alpha", "irradiance", "mips[1]", "brdf", "background"])
def test_every_input_is_checked(generator, name, spoil):
    """A kernel would read past the end of what is too short, and into another device's memory."""
    cpu = torch.device("cpu")
    surface, view = single_points(4, generator, cpu)
    light = make_light(generator, cpu, sizes=(4, 4, 2))
    inputs = {**surface.channels(), "view": view, "alpha": torch.ones(4, 1), "background": torch.ones(4, 3)}
    inputs |= {"irradiance": light.irradiance, "mips[1]": light.specular[1], "brdf": brdf_table(cpu)}
    given = {**inputs, name: spoil(inputs[name])}
    # the first channel says how many points there are and where: it may be the second that differs
    blamed = "albedo|normal" if name == "albedo" else re.escape(name)
    with pytest.raises(UserError, match=f"^({blamed}): expected "):
        shade_gbuffer(
            Surface(**{name: given[name] for name in CHANNELS}),
            given["view"],
            given["alpha"],
            irradiance=given["irradiance"],
            mips=(light.specular[0], given["mips[1]"]),
            brdf=given["brdf"],
            background=given["background"],
        )


def test_maps_that_are_no_cubes_are_refused(generator):
    surface, view = single_points(4, generator, torch.device("cpu"))
    cube, oblong = torch.ones(6, 2, 2, 3), torch.ones(6, 2, 4, 3)
    with pytest.raises(UserError, match=r"irradiance: expected .* \(6, S, S, 3\), found"):
        shade(surface, view, FilteredLight(oblong, (cube,), cube))
    with pytest.raises(UserError, match=r"mips\[2\]: expected .* \(6, S, S, 3\), found"):
        shade(surface, view, FilteredLight(cube, (cube, cube, oblong), cube))
    with pytest.raises(UserError, match="mips: expected at least one"):
        shade(surface, view, FilteredLight(cube, (), cube))
    options = {"irradiance": cube, "mips": (cube,), "background": torch.ones(1, 3)}
    for brdf, expected in (
        (torch.ones(8, 7, 2), r".* \(N, N, 2\)"),
        (torch.ones(1, 1, 2), "at least 2 rows"),
    ):
        with pytest.raises(UserError, match=f"brdf: expected {expected}"):
            shade_gbuffer(surface, view, torch.ones(4, 1), **options, brdf=brdf)


@pytest.mark.parametrize("background", [1, True])
def test_whole_numbers_are_backgrounds_as_well(device, generator, background):
    surface, view = single_points(5, generator, device)
    light = make_light(generator, device, sizes=(2, 2, 2))
    alpha = torch.linspace(0, 1, 5, device=device)[:, None]
    found = shade(surface, view, light, alpha=alpha, background=background)
    assert torch.equal(found.image, shade(surface, view, light, alpha=alpha, background=1.0).image)


def test_one_background_for_all_points_is_the_same_for_each(device, generator):
    surface, view = single_points(5, generator, device)
    light, alpha = make_light(generator, device), torch.linspace(0, 1, 5, device=device)[:, None]
    one = torch.tensor([[0.2, 0.4, 0.6]], device=device)
    found = shade(surface, view, light, alpha=alpha, background=one)
    wanted = shade(surface, view, light, alpha=alpha, background=one.expand(5, 3))
    assert torch.equal(found.image, wanted.image)


def test_the_background_is_a_constant(device, generator):
    surface, view = single_points(5, generator, device)
    constant = surface.map(Tensor.detach), view.detach()
    light = make_light(generator, device, sizes=(2, 2, 2))
    light = replace(
        light,
        irradiance=light.irradiance.detach(),
        specular=tuple(mip.detach() for mip in light.specular),
    )
    background = torch.rand(5, 3, device=device, requires_grad=True)
    assert not shade(*constant, light, background=background).image.requires_grad


def test_srgb_is_the_standard_and_inverts():
    # IEC 61966-2-1: 18 % grey is 0.4614, the line joins the curve to 1e-5.
    assert encode_srgb(torch.tensor([0.0, 0.18, 1.0], dtype=torch.float64)).tolist() == pytest.approx(
        [0, 0.46135, 1], abs=1e-5
    )
    values = torch.tensor(
        [-0.5, 0.0, 0.001, 0.0031308, 0.01, 0.5, 1.0, 40.0], dtype=torch.float64, requires_grad=True
    )
    encoded = encode_srgb(values)
    assert torch.allclose(decode_srgb(encoded), values, rtol=1e-6)
    assert (torch.autograd.grad(encoded.sum(), values)[0] > 0).all()
    smooth = torch.tensor([-0.5, 0.001, 0.01, 0.5, 40.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(encode_srgb, smooth)
    assert torch.autograd.gradcheck(decode_srgb, smooth)


def test_compose():
    foreground, alpha = torch.tensor([[0.18, 2.0, 0.0]]), torch.tensor([[0.25]])
    assert torch.allclose(
        compose(foreground, alpha, torch.ones(3), color_space="raw"), 0.25 * foreground + 0.75
    )
    expected = 0.25 * encode_srgb(foreground) + 0.75
    assert torch.allclose(compose(foreground, alpha, torch.ones(3)), expected)
