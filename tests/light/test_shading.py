import pytest
import torch

from samira_warp.light import FilteredLight, Shaded, compose, decode_srgb, encode_srgb, shade
from samira_warp.light.brdf import brdf_table
from samira_warp.reference.shading import deferred as reference
from samira_warp.support.errors import UserError

NAMES = (
    "albedo",
    "normal",
    "roughness",
    "specular",
    "response_diffuse",
    "response_specular",
    "view",
    "alpha",
)


def surface(count, generator, dtype=torch.float64):
    """G-buffer values in their ranges, n . v from about 0.1 to 1."""
    options = {"generator": generator, "dtype": dtype}
    normal = torch.nn.functional.normalize(torch.randn(count, 3, **options), dim=-1)
    view = torch.nn.functional.normalize(normal + 0.4 * torch.randn(count, 3, **options), dim=-1)
    scalar = [torch.rand(count, 1, **options) for _ in range(4)]
    roughness, specular, diffuse, shine = scalar
    return (
        torch.rand(count, 3, **options),
        normal,
        0.08 + 0.9 * roughness,
        0.02 + 0.1 * specular,
        0.5 + diffuse,
        0.5 + shine,
        view,
    )


def test_roughness_gradient_at_and_beyond_the_borders(device, generator):
    values = [value.float().to(device) for value in surface(4, generator)]
    values[2] = torch.tensor([[-0.1], [0.0], [1.0], [1.1]], device=device, requires_grad=True)
    maps = [torch.rand(6, size, size, 3, generator=generator).to(device) for size in (4, 8, 4, 4, 4, 4)]
    shaded = shade(*values, FilteredLight(maps[0], tuple(maps[1:])))
    grads = torch.autograd.grad(shaded.color.sum(), values[2])[0].flatten() != 0
    assert grads.tolist() == [False, True, True, False]


def coverage(count, generator, dtype=torch.float64):
    """Alpha of which a quarter is 0, a quarter just too little for a surface, and the rest anything."""
    alpha = 0.01 + 0.99 * torch.rand(count, 1, generator=generator, dtype=dtype)
    alpha[::4] = 0
    alpha[1::4] = 0.9 / 255
    return alpha


@pytest.mark.parametrize("color_space", ["srgb", "raw"])
def test_shade_matches_the_reference(device, generator, color_space):
    """Every output, and its gradients to every channel of the G-buffer and every texel of both
    environments."""
    values = [value.requires_grad_() for value in (*surface(1000, generator), coverage(1000, generator))]
    sizes = (16, 8, 4, 4, 2)
    options = {"generator": generator, "dtype": torch.float64}
    # Some colours are below the end of the sRGB curve's line.
    maps = [(torch.rand(6, size, size, 3, **options) ** 4).requires_grad_() for size in (16, *sizes)]
    background, upstream = (
        torch.rand(1000, 3, **options),
        [torch.randn(1000, 3, **options) for _ in Shaded._fields],
    )
    terms = {
        "irradiance": maps[0],
        "mips": tuple(maps[1:]),
        "brdf": brdf_table(torch.device("cpu")),
        "background": background,
    }
    expected = reference.shade_gbuffer(*values, **terms, exposure=0.7, encoded=color_space == "srgb")
    expected_grads = torch.autograd.grad(expected, [*values, *maps], upstream)
    inner = [tensor.detach().float().to(device).requires_grad_() for tensor in [*values, *maps]]
    composition = {
        "alpha": inner[7],
        "background": background.float().to(device),
        "exposure": 0.7,
        "color_space": color_space,
    }
    result = shade(*inner[:7], FilteredLight(inner[8], tuple(inner[9:])), **composition)
    grads = torch.autograd.grad(result, inner, [grad.float().to(device) for grad in upstream])
    for value, wanted in zip(result, expected, strict=True):
        assert torch.allclose(value.cpu().double(), wanted, atol=1e-5)
    for name, grad, wanted in zip((*NAMES, "irradiance", *("mip",) * 5), grads, expected_grads, strict=True):
        grad = grad.cpu().double()
        # Single precision moves a few lookups to the next cell, where the slope is another one.
        assert (grad - wanted).norm() <= 2e-3 * wanted.norm(), name
        assert torch.nn.functional.cosine_similarity(grad.flatten(), wanted.flatten(), dim=0) > 0.99999, name


@pytest.mark.parametrize("encoded", [True, False])
def test_reference_gradients_are_those_of_finite_differences(generator, encoded):
    values = [value.requires_grad_() for value in surface(3, generator)]
    alpha = torch.tensor([[0.2], [1.0], [0.9 / 255]], dtype=torch.float64, requires_grad=True)
    maps = [torch.rand(6, size, size, 3, generator=generator, dtype=torch.float64) for size in (2, 4, 2)]
    terms = {
        "irradiance": maps[0],
        "mips": tuple(maps[1:]),
        "brdf": brdf_table(torch.device("cpu")),
        "background": torch.full((1, 3), 0.3),
    }

    def run(*values):
        return tuple(reference.shade_gbuffer(*values, **terms, exposure=1.3, encoded=encoded))

    assert torch.autograd.gradcheck(run, (*values, alpha), eps=1e-7, atol=1e-4)


def test_what_nothing_covers_shows_the_background_and_moves_alpha_alone(device, generator):
    values = [value.float().to(device).requires_grad_() for value in surface(3, generator)]
    maps = [torch.rand(6, 4, 4, 3, generator=generator).to(device).requires_grad_() for _ in range(6)]
    alpha = torch.tensor([[0.0], [0.9 / 255], [0.9 / 255]], device=device, requires_grad=True)
    shaded = shade(*values, FilteredLight(maps[0], tuple(maps[1:])), alpha=alpha, background=0.25)
    assert not any(value.any() for value in (shaded.color, shaded.irradiance, shaded.specular_light))
    assert torch.equal(shaded.image, (0.25 * (1 - alpha)).expand(3, 3))
    grads = torch.autograd.grad(sum(value.sum() for value in shaded), [*values, *maps, alpha])
    assert not any(grad.any() for grad in grads[:-1])
    assert torch.equal(grads[-1], torch.full((3, 1), -0.75, device=device))


def test_what_is_covered_no_longer_depends_on_what_is_not(device, generator):
    """Values where nothing is, NaN among them, reach neither the image nor a gradient."""
    values = [value.float().to(device) for value in surface(8, generator)]
    maps = [torch.rand(6, 4, 4, 3, generator=generator).to(device).requires_grad_() for _ in range(6)]
    alpha = torch.ones(8, 1, device=device)
    alpha[::2] = 0
    kept = [value[1::2].requires_grad_() for value in values]
    spoilt = [
        value.clone().index_fill_(0, torch.arange(0, 8, 2, device=device), float("nan")).requires_grad_()
        for value in values
    ]
    light = FilteredLight(maps[0], tuple(maps[1:]))
    alone, among = shade(*kept, light), shade(*spoilt, light, alpha=alpha, background=0.0)
    assert torch.equal(among.image[1::2], alone.image)
    assert not among.image[::2].any()
    grads = torch.autograd.grad(among.image.sum(), [*spoilt, *maps])
    for grad, wanted in zip(grads, torch.autograd.grad(alone.image.sum(), [*kept, *maps]), strict=True):
        assert torch.equal(grad if grad.shape == wanted.shape else grad[1::2], wanted)


def test_image_is_the_composed_colour(device, generator):
    values = [value.float().to(device) for value in surface(50, generator)]
    maps = [torch.rand(6, 4, 4, 3, generator=generator).to(device) for _ in range(6)]
    alpha = torch.rand(50, 1, generator=generator).to(device)
    for color_space in ("srgb", "raw"):
        shaded = shade(
            *values,
            FilteredLight(maps[0], tuple(maps[1:])),
            alpha=alpha,
            background=0.5,
            exposure=2.0,
            color_space=color_space,
        )
        wanted = compose(shaded.color, alpha, 0.5, exposure=2.0, color_space=color_space)
        # A few roundings of values around 1; the curve's power is another one.
        assert torch.allclose(shaded.image, wanted, atol=1e-5)


def test_borders_of_the_brdf_table_give_the_gradients_of_the_reference(device, generator):
    """Roughness 0 and 1; n . v of 1, grazing, 0 and below."""
    count, options = 8, {"generator": generator, "dtype": torch.float64}
    normal = torch.nn.functional.normalize(torch.randn(count, 3, **options), dim=-1)
    across = torch.nn.functional.normalize(
        torch.linalg.cross(normal, torch.randn(count, 3, **options)), dim=-1
    )
    cosine = torch.tensor([1.0, 1.0, 1e-3, 1e-3, 0.0, 0.0, -0.5, -0.5], dtype=torch.float64)[:, None]
    values = list(surface(count, generator))
    values[1], values[6] = normal, cosine * normal + torch.sqrt(1 - cosine**2) * across
    values[2] = torch.tensor([0.0, 1.0] * 4, dtype=torch.float64)[:, None]
    # Light without a slope leaves the table's slopes alone; single precision decides on which side of 1 and 0
    # n . v lies.
    maps = [torch.ones(6, 2, 2, 3, dtype=torch.float64)] * 6
    values = [value.float().double().requires_grad_() for value in values]
    alpha, brdf = torch.ones(count, 1, dtype=torch.float64), brdf_table(torch.device("cpu"))
    terms = {"irradiance": maps[0], "mips": tuple(maps[1:]), "brdf": brdf, "background": torch.zeros(1, 3)}
    wanted = torch.autograd.grad(
        reference.shade_gbuffer(*values, alpha, **terms).color.sum(), (values[2], values[3])
    )
    inner = [value.detach().float().to(device).requires_grad_() for value in values]
    light = FilteredLight(maps[0].float().to(device), tuple(mip.float().to(device) for mip in maps[1:]))
    grads = torch.autograd.grad(shade(*inner, light).color.sum(), inner)
    assert all(grad.isfinite().all() for grad in grads)
    for grad, expected in zip((grads[2], grads[3]), wanted, strict=True):
        assert torch.allclose(grad.cpu().double(), expected, rtol=1e-3, atol=2e-3)


def test_same_bits_for_any_number_of_threads(device, generator, use_threads):
    values = [value.float().to(device).requires_grad_() for value in surface(9000, generator)]
    alpha = coverage(9000, generator).float().to(device).requires_grad_()
    maps = [
        torch.rand(6, size, size, 3, generator=generator).to(device).requires_grad_()
        for size in (16, 32, 16, 8, 4, 4)
    ]

    def run():
        result = shade(*values, FilteredLight(maps[0], tuple(maps[1:])), alpha=alpha)
        loss = sum(value.square().sum() for value in result)
        first = torch.autograd.grad(loss, [*values, alpha, *maps], retain_graph=True)
        second = torch.autograd.grad(loss, [*values, alpha, *maps])
        assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
        return *result, *first

    use_threads(1)
    one = run()
    use_threads(2)
    two = run()
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))


def test_zero_normals_see_nothing_and_send_no_nan(device):
    values = [torch.zeros(2, n, device=device, requires_grad=True) for n in (3, 3, 1, 1, 1, 1, 3)]
    maps = [torch.rand(6, 4, 4, 3, device=device, requires_grad=True) for _ in range(6)]
    shaded = shade(*values, FilteredLight(maps[0], tuple(maps[1:])))
    grads = torch.autograd.grad(shaded.color.sum(), [*values, *maps])
    assert not shaded.color.any()
    assert all(grad.isfinite().all() for grad in grads)


def test_no_points(device):
    light = FilteredLight(torch.ones(6, 2, 2, 3, device=device), (torch.ones(6, 2, 2, 3, device=device),) * 5)
    assert shade(*(torch.empty(0, n, device=device) for n in (3, 3, 1, 1, 1, 1, 3)), light).color.shape == (
        0,
        3,
    )


def test_wrong_shapes_are_refused():
    light = FilteredLight(torch.ones(6, 2, 2, 3), (torch.ones(6, 2, 2, 3),) * 5)
    with pytest.raises(UserError, match="roughness"):
        shade(
            torch.ones(4, 3),
            torch.ones(4, 3),
            torch.ones(4),
            *(torch.ones(4, 1),) * 3,
            torch.ones(4, 3),
            light,
        )
    values = (torch.ones(4, 3), torch.ones(4, 3), *(torch.ones(4, 1),) * 4, torch.ones(4, 3), light)
    with pytest.raises(UserError, match="alpha"):
        shade(*values, alpha=torch.ones(4))
    with pytest.raises(UserError, match="background"):
        shade(*values, background=torch.ones(3))
    with pytest.raises(UserError, match=r"light\.irradiance: .* found float64"):
        shade(*values[:-1], FilteredLight(light.irradiance.double(), light.specular))
    with pytest.raises(UserError, match=r"light\.irradiance: expected square"):
        shade(*values[:-1], FilteredLight(torch.ones(6, 2, 4, 3), light.specular))
    with pytest.raises(UserError, match=r"light\.specular\[2\]: .* found float32 \(6, 2, 2, 4\)"):
        shade(*values[:-1], FilteredLight(light.irradiance, (*light.specular[:2], torch.ones(6, 2, 2, 4))))


@pytest.mark.parametrize("background", [1, True])
def test_whole_numbers_are_backgrounds_and_exposures_as_well(device, generator, background):
    values = [value.float().to(device) for value in surface(5, generator)]
    light = FilteredLight(torch.ones(6, 2, 2, 3, device=device), (torch.ones(6, 2, 2, 3, device=device),) * 2)
    alpha = torch.linspace(0, 1, 5, device=device)[:, None]
    found = shade(*values, light, alpha=alpha, background=background, exposure=2)
    assert torch.equal(found.image, shade(*values, light, alpha=alpha, background=1.0, exposure=2.0).image)


def test_the_background_is_a_constant(device, generator):
    values = [value.float().to(device) for value in surface(5, generator)]
    light = FilteredLight(torch.ones(6, 2, 2, 3, device=device), (torch.ones(6, 2, 2, 3, device=device),) * 2)
    assert not shade(
        *values, light, background=torch.rand(5, 3, device=device, requires_grad=True)
    ).image.requires_grad


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
    expected = 0.25 * encode_srgb(0.5 * foreground) + 0.75
    assert torch.allclose(compose(foreground, alpha, torch.ones(3), exposure=0.5), expected)
