"""The table of channels, and that everything follows it: a channel that a row adds reaches the picture."""

import subprocess
import sys
from dataclasses import FrozenInstanceError, fields
from pathlib import Path

import pytest
import torch
from subjects import camera, parameters, small_avatar

import samira_warp.surface
from samira_warp.avatar import GBuffer
from samira_warp.surface import CHANNELS, LIGHT_WIDTH, SURFACE_WIDTH, Surface

REQUIRED = {
    "albedo": torch.full((2, 5, 3), 0.5, dtype=torch.float64),
    "normal": torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(2, 5, 3),
    "roughness": torch.full((2, 5, 1), 0.4, dtype=torch.float64),
    "specular": torch.full((2, 5, 1), 0.04, dtype=torch.float64),
}


def test_the_table_is_the_surfaces_fields():
    assert list(CHANNELS) == [field.name for field in fields(Surface)]
    assert sum(channel.width for channel in CHANNELS.values()) == SURFACE_WIDTH + LIGHT_WIDTH
    for name, channel in CHANNELS.items():
        assert channel.low < channel.high, name
        assert channel.neutral is None or channel.low <= channel.neutral <= channel.high, name
        # directions and colours have three numbers
        assert channel.width == 3 or (channel.blend, channel.drawn) != ("direction", "color"), name


def test_the_table_is_read_without_torch():
    code = "import sys, samira_warp.surface; print(sorted({'torch', 'warp', 'numpy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_channels_left_out_are_neutral():
    surface = Surface.of(**REQUIRED)
    assert list(surface.channels()) == list(CHANNELS)
    for name, values in surface.channels().items():
        assert values.shape == (2, 5, CHANNELS[name].width), name
        assert values.dtype == torch.float64, name
        if name in REQUIRED:
            assert values is REQUIRED[name]
        else:
            assert (values == CHANNELS[name].neutral).all()


def test_what_has_no_neutral_value_has_to_be_given():
    rest = {name: values for name, values in REQUIRED.items() if name != "specular"}
    with pytest.raises(TypeError, match="specular"):
        Surface.of(**rest)
    with pytest.raises(TypeError, match="gloss"):
        Surface.of(**REQUIRED, gloss=REQUIRED["specular"])


def test_a_surface_does_not_change():
    with pytest.raises(FrozenInstanceError):
        Surface.of(**REQUIRED).albedo = REQUIRED["normal"]


def test_a_function_of_all_channels_or_of_directions():
    surface = Surface.of(**REQUIRED)
    flat = surface.map(lambda values: values.flatten(0, 1))
    assert [values.shape for values in flat.channels().values()] == [(10, c.width) for c in CHANNELS.values()]
    turned = surface.map(torch.neg, blend="direction")
    for name, values in turned.channels().items():
        before = getattr(surface, name)
        assert torch.equal(values, -before if CHANNELS[name].blend == "direction" else before), name


def test_a_gbuffer_is_a_surface_and_where_it_is():
    with torch.no_grad():
        gbuffer = small_avatar().render(parameters(0), camera(24)).gbuffer
    assert isinstance(gbuffer, Surface)
    assert list(gbuffer.channels()) == list(CHANNELS)
    assert [field.name for field in fields(GBuffer)] == [*CHANNELS, "depth", "alpha", "screen", "splats"]
    assert type(gbuffer.map(lambda values: values)) is Surface


A_NEW_ROW = """
import sys, types
from pathlib import Path
name = "samira_warp.surface"
source = Path(sys.argv[1]).read_text()
row = '    gleam: Annotated["Tensor", Channel(1, 0.0, 2.0, neutral=1.5)]\\n'
source = source.replace("\\n    @classmethod\\n    def of", row + "\\n    @classmethod\\n    def of", 1)
module = types.ModuleType(name)
sys.modules[name] = module
exec(compile(source, sys.argv[1], "exec"), module.__dict__)
assert list(module.CHANNELS)[-1] == "gleam"

from typing import get_args
import torch
from samira_warp.bench.raster import GBUFFER_CHANNELS
from samira_warp.light import FilteredLight, shade
from samira_warp.stage.layer_names import Layer
from samira_warp.stage.layers import layer_image
from samira_warp.support.errors import UserError
from subjects import camera, parameters, small_avatar

avatar, frame, view = small_avatar(), parameters(0), camera(24)
rendering = avatar.render(frame, view)
gbuffer = rendering.gbuffer
covered = gbuffer.alpha >= 1 / 255
assert gbuffer.gleam.shape == (24, 24, 1)
assert (gbuffer.gleam[covered] - 1.5).abs().max() < 1e-5
assert "gleam" in get_args(Layer) and GBUFFER_CHANNELS == 12
picture = layer_image(rendering, "gleam").picture
assert torch.allclose(picture, gbuffer.alpha * gbuffer.gleam / 2 + 1 - gbuffer.alpha)

# nothing shades it yet: the image is what it was and sends it no gradient, and it is checked all the same
surface = avatar.surface(avatar.move(frame)).map(lambda values: values.detach().requires_grad_())
maps = [torch.rand(6, size, size, 3) for size in (4, 8, 4)]
light, view = FilteredLight(maps[0], tuple(maps[1:]), maps[0]), surface.normal.detach()
shaded = shade(surface, view, light)
grads = torch.autograd.grad(shaded.image.sum(), list(surface.channels().values()), allow_unused=True)
assert [grad is None for grad in grads] == [name == "gleam" for name in module.CHANNELS]
try:
    shade(module.Surface(**{**surface.channels(), "gleam": surface.gleam[:-1]}), view, light)
except UserError as error:
    print(error)
"""


def test_a_row_in_the_table_is_enough_for_all_but_source_and_use():
    """In a process of its own, with a copy of the table that has one more row."""
    table = Path(samira_warp.surface.__file__)
    done = subprocess.run(
        [sys.executable, "-c", A_NEW_ROW, str(table)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parent,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("gleam: expected float32 tensor of shape (")
