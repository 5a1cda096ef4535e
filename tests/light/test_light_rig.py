"""Light rigs: lamps against closed forms, what a cubemap and a panorama show of them, and their files."""

import json
import math

import pytest
import torch

from samira_warp.geometry.camera import Camera
from samira_warp.kernels.cubemap.layout import texel_directions, texel_solid_angles
from samira_warp.light import (
    AreaLight,
    DirectionalLight,
    Environment,
    LightRig,
    PointLight,
    equirect_directions,
)
from samira_warp.light.equirect import row_solid_angles
from samira_warp.light.polygon_coverage import polygon_coverage
from samira_warp.support.errors import UserError

RED_TO_BLUE = (1.0, 2.0, 3.0)


def irradiance(texels, normal):
    """(3,) E of a surface that faces ``normal``: the sum over a cubemap's texels or a panorama's pixels."""
    if texels.dim() == 4:
        areas = texel_solid_angles(texels.shape[1], dtype=torch.float64)[..., None]
        directions = texel_directions(texels.shape[1], dtype=torch.float64)
    else:
        areas = row_solid_angles(*texels.shape[:2])[:, None, None]
        directions = equirect_directions(texels.shape[0]).double()
    cosines = (directions @ unit(normal)).clamp(min=0.0)[..., None]
    return (texels.double() * areas * cosines).flatten(0, -2).sum(dim=0)


def unit(values):
    return torch.nn.functional.normalize(torch.tensor(values, dtype=torch.float64), dim=0)


def parallel_rectangle(half_width, half_height, distance):
    """E / L of a rectangle over a parallel surface under its middle: four times the form factor of a corner.

    Howell's catalogue, B-3: F = 1 / (2 pi) (a / sqrt(1 + a^2) atan(b / sqrt(1 + a^2)) + the same with a and b
    exchanged), and E = pi L F.
    """
    a, b = half_width / distance, half_height / distance
    halves = (x / math.hypot(1.0, x) * math.atan(y / math.hypot(1.0, x)) for x, y in ((a, b), (b, a)))
    return 4.0 * 0.5 * sum(halves)


@pytest.mark.parametrize("size", [16, 64, 256])
@pytest.mark.parametrize("towards", [(0.0, 0.0, 1.0), (0.8, 0.45, 0.6), (-1.0, 1.0, -1.0), (0.1, -1.0, 0.0)])
def test_a_facing_surface_has_the_irradiance_of_the_closed_form(size, towards):
    """To the rounding of texels to float32: some 6e-8 each. The light's own sum is made exact."""
    distance = math.hypot(*towards)
    lamps = {
        DirectionalLight(towards, RED_TO_BLUE): torch.tensor(RED_TO_BLUE),
        DirectionalLight(towards, RED_TO_BLUE, radius=30.0): torch.tensor(RED_TO_BLUE),
        PointLight(towards, RED_TO_BLUE): torch.tensor(RED_TO_BLUE) / distance**2,
        AreaLight(towards, RED_TO_BLUE, 0.4, 0.7): torch.tensor(RED_TO_BLUE)
        * parallel_rectangle(0.2, 0.35, distance),
    }
    for lamp, expected in lamps.items():
        found = irradiance(LightRig((lamp,)).to_cube(size), towards)
        # A large lamp may be turned by the rounding of its edge to texel centres, s texels of 90 / S degrees:
        # of its irradiance that takes the cosine, 1 - (s pi / 2 / S)^2 / 2, 1e-3 at S = 16 for s = 0.5.
        bound = 1e-6 + 0.5 * (0.5 * math.pi / 2 / size) ** 2
        torch.testing.assert_close(found, expected.double(), rtol=bound, atol=0.0)


def test_shading_sees_the_irradiance_over_pi():
    """E_d is the mean of the radiance, weighted by the cosine. Its map of 16 has a texel centre there."""
    directions = texel_directions(16, dtype=torch.float64)
    towards = tuple(directions[4, 5, 9].tolist())
    rig = LightRig((DirectionalLight(towards, RED_TO_BLUE),))
    found = Environment.from_rig(rig, size=64).filtered().irradiance[4, 5, 9]
    # the table of the cosine lobe is exact at texel centres: float32 sums over 24,576 texels
    torch.testing.assert_close(found, torch.tensor(RED_TO_BLUE) / math.pi, rtol=1e-3, atol=0.0)


def test_a_rectangle_over_a_surface_off_its_middle_adds_up_of_rectangles_over_their_corners():
    """The irradiance vector, whatever the surface faces, as long as the whole lamp is before it."""
    lamp = AreaLight((0.5, 0.3, 1.0), RED_TO_BLUE, 0.6, 0.4, normal=(0.0, 0.0, -1.0))

    # corner factors of a rectangle from 0 to x and from 0 to y, at a distance of 1, signed
    def corner(x, y):
        return 0.25 * parallel_rectangle(abs(x), abs(y), 1.0) * math.copysign(1.0, x * y)

    expected = corner(0.8, 0.5) - corner(0.2, 0.5) - corner(0.8, 0.1) + corner(0.2, 0.1)
    vector = lamp.irradiance_vector()
    torch.testing.assert_close(
        vector[:, 2], expected * torch.tensor(RED_TO_BLUE).double(), rtol=1e-12, atol=0
    )
    found = irradiance(LightRig((lamp,)).to_cube(256), (0.0, 0.0, 1.0))
    torch.testing.assert_close(found, vector[:, 2], rtol=1e-5, atol=0.0)


def test_a_texel_within_a_lamp_has_its_radiance_and_the_lamp_its_solid_angle():
    """A rectangle of half sides a, b at distance d spans 4 asin(a b / sqrt((a^2 + d^2) (b^2 + d^2)))."""
    lamp = AreaLight((0.0, 0.0, 1.0), RED_TO_BLUE, 1.2, 0.8)
    texels = LightRig((lamp,)).to_cube(256)
    areas = texel_solid_angles(256, dtype=torch.float64)[..., None]
    a, b = 0.6, 0.4
    expected = 4.0 * math.asin(a * b / math.sqrt((a * a + 1.0) * (b * b + 1.0)))
    # A texel's solid angle varies within it by 2 / S: its covered share stands for it to some (2 / S)^2.
    found = (texels.double() * areas).sum(dim=(0, 1, 2)) / torch.tensor(RED_TO_BLUE)
    torch.testing.assert_close(found, torch.full((3,), expected).double(), rtol=1e-4, atol=0.0)
    torch.testing.assert_close(texels[4, 128, 128], torch.tensor(RED_TO_BLUE), rtol=1e-4, atol=0.0)
    assert (texels[5] == 0).all()


@pytest.mark.parametrize("size", [4, 32])
def test_a_polygon_about_a_corner_of_the_cube_is_covered_once(size, generator):
    """Six faces of a box about the centre are all that can be seen: every texel is covered, once in all."""
    turn, _ = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64, generator=generator))
    square = torch.tensor([[-1.0, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=torch.float64)
    sides = [square.roll(shift, dims=1) * sign for shift in range(3) for sign in (1.0, -1.0)]
    total = sum(polygon_coverage(side @ turn.T, size=size) for side in sides)
    torch.testing.assert_close(total, torch.ones_like(total), rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("thickness", [0.002, 0.05])
def test_thin_and_small_lamps_lose_nothing(thickness):
    """A strip a sixth of a texel wide, in a cubemap and in a panorama."""
    lamp = AreaLight((0.6, 0.5, 1.0), RED_TO_BLUE, thickness, 1.2)
    rig = LightRig((lamp,))
    towards = tuple(lamp.irradiance_vector()[0].tolist())
    expected = lamp.irradiance_vector() @ unit(towards)
    torch.testing.assert_close(irradiance(rig.to_cube(64), towards), expected, rtol=1e-3, atol=0.0)
    for height in (64, 512, 1024):
        found = irradiance(rig.to_panorama(height), towards)
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=0.0)


def test_lamps_are_added_to_a_map_and_turned_and_exposed_with_it():
    rig = LightRig((DirectionalLight((1.0, 0.2, -0.4), RED_TO_BLUE, radius=5.0),))
    sky = Environment.from_panorama(0.5 + 0.4 * equirect_directions(32), size=32)
    alone = Environment.from_rig(rig, size=32)
    both = sky.turned(30.0).exposed(2.0).with_rig(rig).turned(10.0)
    assert (both.rotate, both.exposure) == (40.0, 2.0)
    assert torch.equal(both.specular, sky.specular + alone.specular)
    assert both.diffuse is both.specular
    torch.testing.assert_close(
        both.mean_irradiance(), 2.0 * (sky.mean_irradiance() + alone.mean_irradiance())
    )
    learned = Environment.from_cubemaps(torch.ones(6, 8, 8, 3), torch.ones(6, 16, 16, 3)).with_rig(rig)
    assert (learned.diffuse.shape[1], learned.specular.shape[1]) == (8, 16)
    # a light of 1 all around has E_d = 1; E is pi times that
    expected = math.pi + torch.tensor(RED_TO_BLUE).double()
    found = irradiance(learned.diffuse, (1.0, 0.2, -0.4))
    torch.testing.assert_close(found, expected, rtol=5e-3, atol=0.0)  # 8 texels along a face


def test_a_lamp_is_seen_where_it_is(generator):
    """A camera that looks along -z sees a lamp on its right there, on a map and alone; turned, elsewhere."""
    rig = LightRig((AreaLight((0.25, 0.0, -1.0), (5.0, 0.0, 0.0), 0.2, 0.2),))
    view = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))
    camera = Camera(view, 64.0, 64.0, 32.0, 32.0, 64, 64)
    for light in (
        Environment.from_rig(rig, size=64),
        Environment.from_panorama(torch.zeros(32, 64, 3), size=32).with_rig(rig),
    ):
        seen = light.background(camera)
        column = 32 + int(64 * 0.25)
        assert seen[32, column, 0] > 0.95
        assert seen[32, 8, 0] < 0.05
        # by 90 degrees, what was straight right is straight ahead: this lamp has gone left, out of sight
        assert light.turned(90.0).background(camera).max() < 0.05


def sphere_irradiance(position, *, radius=0.1, count=20_000):
    """Irradiance of a sphere about the centre under a lamp of intensity 1: true, and the far field's."""
    steps = torch.arange(count, dtype=torch.float64)
    heights, turns = 1.0 - (2.0 * steps + 1.0) / count, steps * math.pi * (3.0 - math.sqrt(5.0))
    rings = (1.0 - heights**2).sqrt()
    normals = torch.stack([rings * turns.cos(), heights, rings * turns.sin()], dim=1)
    lamp = torch.tensor(position, dtype=torch.float64)
    towards = lamp - radius * normals
    true = (normals * towards).sum(dim=1).clamp(min=0.0) / towards.norm(dim=1) ** 3
    return true, (normals @ unit(position)).clamp(min=0.0) / float(lamp @ lamp)


@pytest.mark.parametrize(
    ("distance", "nearest", "on_average"),
    # at the nearest point (d / (d - r))^2 exactly: docs/relighting.md has these numbers
    [(0.5, 1.5625, 0.295), (1.0, 1.2346, 0.151), (2.0, 1.1080, 0.077)],
)
def test_the_error_of_the_far_field_is_what_the_documentation_says(distance, nearest, on_average):
    """A sphere of the head's size under a point lamp: ratio at the nearest point, and RMS over mean error."""
    true, far = sphere_irradiance((0.0, 0.0, distance))
    # 20,000 points: one lies within a degree of the nearest, whose cosine is 1 to 2e-4
    assert float((true / far.clamp(min=1e-9))[far.argmax()]) == pytest.approx(nearest, rel=1e-3)
    error = (true - far).square().mean().sqrt() / true.square().mean().sqrt()
    assert float(error) == pytest.approx(on_average, abs=0.001)


KEY = {"kind": "area", "position": [0.6, 0.5, 1.0], "width": 0.6, "height": 0.9, "radiance": [9, 8, 7]}


def test_a_file_says_what_python_says(tmp_path):
    lamps = [
        KEY,
        {**KEY, "name": "up", "target": [0.6, 0.8, 0.7], "normal": None},
        {"kind": "point", "position": [1, 0, 0], "intensity": 2, "radius": 1.5},
        {"kind": "directional", "direction": [0, 1, 1], "irradiance": [1, 2, 3], "name": "sun"},
    ]
    del lamps[1]["normal"]
    path = tmp_path / "rig.json"
    # as editors write it: with a byte order mark, too
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps({"lamps": lamps}).encode())
    first, second, third, fourth = LightRig.load(path).lamps
    assert first == AreaLight((0.6, 0.5, 1.0), (9, 8, 7), 0.6, 0.9)
    assert second.normal == pytest.approx((0.0, 0.3, -0.3))
    assert (second.name, second.width) == ("up", 0.6)
    assert third == PointLight((1, 0, 0), (2, 2, 2), 1.5)
    assert fourth == DirectionalLight((0, 1, 1), (1, 2, 3), name="sun")


def without(key):
    return {name: value for name, value in KEY.items() if name != key}


POINT = {"kind": "point", "position": [1, 0, 0], "intensity": 1}
SUN = {"kind": "directional", "direction": [0, 1, 0], "irradiance": 1}

BAD = {
    "a missing key": (without("width"), "lamp 0: expected 'width' in it"),
    "no kind": (without("kind"), "lamp 0, kind: expected one of area, directional, point, found none"),
    "an unknown kind": ({**KEY, "kind": "spot"}, "lamp 0, kind: expected one of"),
    "a kind that is none": ({**KEY, "kind": ["area"]}, "lamp 0, kind: expected one of"),
    "an unknown key": ({**KEY, "colour": 1}, "found 'colour'"),
    "another kind's key": ({**SUN, "position": [1, 0, 0]}, "found 'position'"),
    "negative": ({**KEY, "radiance": [1, -1, 1]}, "lamp 0, radiance: expected linear red, green and blue"),
    "a negative grey": ({**POINT, "intensity": -2}, "lamp 0, intensity: expected linear red"),
    "not a number": ({**KEY, "radiance": [1, math.nan, 1]}, "lamp 0, radiance: expected"),
    "infinite": ({**SUN, "irradiance": math.inf}, "lamp 0, irradiance: expected"),
    "four hundred digits": ({**SUN, "irradiance": 10**400}, "lamp 0, irradiance: expected"),
    "true": ({**SUN, "irradiance": True}, "lamp 0, irradiance: expected"),
    "two colours": ({**KEY, "radiance": [1, 1]}, "lamp 0, radiance: expected"),
    "a place that is none": ({**KEY, "position": "left"}, "lamp 0, position: expected three numbers"),
    "a place far away": ({**KEY, "position": [0, 0, 1e4]}, "lamp 0, position: expected three numbers"),
    "within the head": (
        {**POINT, "position": [0, 0.1, 0]},
        "expected at least 0.12 m from the head's centre",
    ),
    "across the head": (
        {**KEY, "position": [0.5, 0, 0.1], "width": 1.2, "normal": [0, 0, -1]},
        "lamp 0, the lamp's nearest part: expected at least 0.12 m",
    ),
    "no area": ({**KEY, "height": 0}, "lamp 0, height: expected 0.001 to 1000 metres, found 0"),
    "its back": ({**KEY, "normal": [0, 0, 1]}, "expected a lamp whose front faces the head"),
    "no normal": ({**KEY, "normal": [0, 0, 0]}, "lamp 0, normal: expected three numbers, not all"),
    "two normals": ({**KEY, "normal": [0, 0, -1], "target": [0, 0, 0]}, "a normal or a target, found both"),
    "itself as target": ({**KEY, "target": KEY["position"]}, "lamp 0, target: expected a point"),
    "a target that is none": ({**KEY, "target": 3}, "lamp 0, target: expected a point"),
    "no direction": ({**SUN, "direction": [0, 0, 0]}, "lamp 0, direction: expected three numbers"),
    "a wide lamp": ({**SUN, "radius": 90}, "lamp 0, radius: expected above 0 to 60 degrees"),
    "no radius": ({**SUN, "radius": None}, "lamp 0, radius: expected"),
    "a name that is none": ({**SUN, "name": 3}, "lamp 0, name: expected text"),
    "a list for a lamp": ([1, 2, 3], "lamp 0: expected an object with a kind, found a list"),
    "named": ({**SUN, "name": "sun", "radius": 0}, "lamp 0 (sun), radius: expected"),
}

BAD_DOCUMENTS = {
    "a list": ([KEY], "expected a JSON object, found list"),
    "another key": ({"lights": [KEY]}, "expected 'lamps' in it, found 'lights'"),
    "a key too many": ({"lamps": [KEY], "units": "feet"}, "expected only lamps, found 'units'"),
    "no lamps": ({"lamps": []}, "lamps: expected a list of at least one lamp, found an empty list"),
    "one lamp without a list": ({"lamps": KEY}, "expected a list of at least one lamp, found an object"),
}


@pytest.mark.parametrize("case", [*BAD, *BAD_DOCUMENTS])
def test_what_is_wrong_is_said_in_one_line(case, tmp_path):
    document, message = (
        BAD_DOCUMENTS[case] if case in BAD_DOCUMENTS else ({"lamps": [BAD[case][0]]}, BAD[case][1])
    )
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(document))
    with pytest.raises(UserError) as raised:
        LightRig.load(path)
    assert str(raised.value).startswith(str(path))
    assert message in str(raised.value)
    assert len(str(raised.value).splitlines()) == 1


def test_what_is_no_json_is_said(tmp_path):
    for content, expected in {
        b"{lamps: []}": "a JSON file",
        b"": "a JSON file",
        b"\x89PNG\r\n": "a JSON file",
    }.items():
        (tmp_path / "rig.json").write_bytes(content)
        with pytest.raises(UserError, match=expected):
            LightRig.load(tmp_path / "rig.json")
    with pytest.raises(UserError, match="no such file"):
        LightRig.load(tmp_path / "missing.json")


def test_python_is_held_to_the_same():
    with pytest.raises(UserError, match="lamps: expected at least one lamp"):
        LightRig(())
    with pytest.raises(UserError, match="lamp 1, intensity"):
        LightRig((PointLight((1, 0, 0), (1, 1, 1)), PointLight((1, 0, 0), (1, 1, -1))))
    with pytest.raises(UserError, match="size"):
        Environment.from_rig(LightRig((PointLight((1, 0, 0), (1, 1, 1)),)), size=40)
