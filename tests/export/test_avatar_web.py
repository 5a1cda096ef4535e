"""``avatar-web``: the page's own JavaScript against the rig, and the page in a browser."""

import functools
import http.server
import json
import shutil
import subprocess
import threading

import numpy as np
import pytest
import torch
from chromium import CHROMIUM, Browser
from sources import made_source, with_template
from subjects import small_avatar

from samira_warp.avatar import Avatar, read_frames
from samira_warp.export.__main__ import command
from samira_warp.export.avatar_web import AVERAGED, STEPS, bound_splats, write
from samira_warp.kernels.mesh.triangle_frames import triangle_frames

NODE = shutil.which("node")
in_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")

POSE = """
import {readFileSync} from "fs";
const {Head} = await import(process.argv[2] + "/head.mjs");
const description = JSON.parse(readFileSync(process.argv[2] + "/avatar.json"));
const content = readFileSync(process.argv[2] + "/avatar.bin");
const types = {float32: Float32Array, uint32: Uint32Array, int16: Int16Array};
const bytes = content.buffer.slice(content.byteOffset, content.byteOffset + content.byteLength);
const arrays = {};
for (const [name, {type, offset, shape}] of Object.entries(description.arrays)) {
  arrays[name] = new types[type](bytes, offset, shape.reduce((a, b) => a * b, 1));
}
const head = new Head(description, arrays);
const row = (name, size, number) => Array.from(arrays[name].subarray(number * size, (number + 1) * size));
const posed = description.frames.map((_, number) => {
  head.pose({
    translation: row("frame_translations", 3, number),
    rotations: row("frame_rotations", 3 * description.joints.length, number),
    expression: row("frame_expressions", description.expressions.length, number),
  });
  return {vertices: Array.from(head.vertices), frames: Array.from(head.frames)};
});
console.log(JSON.stringify(posed));
"""


@pytest.fixture(scope="module")
def source():
    avatar = small_avatar(perturb=0.2)
    shape = avatar.canonical.template.posedirs.shape
    posedirs = np.random.default_rng(0).normal(scale=1e-3, size=shape).astype(np.float32)
    return made_source(with_template(avatar, posedirs=posedirs))


@pytest.fixture(scope="module")
def folder(source, tmp_path_factory):
    folder = tmp_path_factory.mktemp("web")
    assert write(source, folder) == "a page of 200 splats and 3 frames, for any web server"
    return folder


def arrays(folder):
    """What the binary file holds, by name."""
    content = (folder / "avatar.bin").read_bytes()
    described = json.loads((folder / "avatar.json").read_text())["arrays"]
    return {
        name: np.frombuffer(content, entry["type"], int(np.prod(entry["shape"])), entry["offset"]).reshape(
            entry["shape"]
        )
        for name, entry in described.items()
    }


def test_shapes_are_kept_to_a_step(source, folder):
    template, stored = source.avatar.canonical.template, arrays(folder)
    shapes = np.concatenate([template.shapedirs[:, :, template.n_shape :], template.posedirs], axis=2)
    scales = stored["shape_scales"].astype(np.float64)
    np.testing.assert_allclose(scales, np.abs(shapes).max(axis=(0, 1)) / STEPS, rtol=1e-6)
    error = np.abs(stored["shapes"] * scales[:, None, None] - shapes.transpose(2, 0, 1))
    assert (error <= 0.51 * scales[:, None, None]).all()


@pytest.mark.skipif(NODE is None, reason="no node on this machine")
def test_the_page_poses_the_head_as_the_rig_does(source, folder, tmp_path):
    """To the steps of the shapes: half a step of each, times a frame's coefficients and correctives."""
    for name in ("head.js", "avatar.json", "avatar.bin"):
        shutil.copy(folder / name, tmp_path / name.replace(".js", ".mjs" if name == "head.js" else ".js"))
    script = tmp_path / "pose.mjs"
    script.write_text(POSE)
    done = subprocess.run([NODE, script, tmp_path], capture_output=True, text=True, timeout=300, check=True)
    canonical, scales = source.avatar.canonical, arrays(folder)["shape_scales"]
    for frame, posed in zip(source.chosen, json.loads(done.stdout), strict=True):
        vertices = canonical.pose(frame.parameters).vertices
        found = torch.tensor(posed["vertices"]).view(-1, 3)
        # entries of rotations less the identity are below 2; float32's own rounding is below 1e-6 m
        size = float(frame.parameters.expression.abs().max().clamp(min=2.0))
        atol = float(3**0.5 * 0.5 * scales.sum() * size) + 1e-6
        torch.testing.assert_close(found, vertices, rtol=0, atol=atol)
        assert atol < 2e-5  # metres: 4 expressions and 36 correctives, each of some millimetres
        faces = triangle_frames(found, canonical.topology)
        wanted = torch.cat(
            [faces.scale[:, None, None] * faces.rotation, faces.translation[:, :, None]], dim=2
        )
        # slivers at the ball's poles turn with the last bit of their corners
        off = (torch.tensor(posed["frames"]).view(-1, 3, 4) - wanted).abs().amax(dim=(1, 2))
        assert float(off.quantile(0.9)) < 1e-6


def test_bound_splats_are_the_gaussians_where_nothing_else_moves_them():
    """Without a residual a Gaussian stays where it is in its triangle, in every frame."""
    avatar = small_avatar(residual=False)
    with torch.no_grad():
        bound = bound_splats(avatar, made_source(avatar).frames)
    own = avatar.gaussians
    # a triangle's corners are 1 m from the origin and its size is a centimetre: 6e-8 / 0.01
    torch.testing.assert_close(bound.means, own.means.detach(), rtol=0, atol=1e-4)
    torch.testing.assert_close(bound.scales, own.scales.detach(), rtol=1e-5, atol=0)
    turn = (bound.quaternions * torch.nn.functional.normalize(own.quaternions, dim=1)).sum(dim=1).abs()
    torch.testing.assert_close(turn, torch.ones_like(turn), rtol=0, atol=1e-5)


def test_the_sequence_and_the_controls_are_the_avatars(source, folder):
    description, stored = json.loads((folder / "avatar.json").read_text()), arrays(folder)
    template = source.avatar.canonical.template
    assert description["frames"] == [frame.name for frame in source.chosen]
    assert description["expressions"] == list(template.expression_names)
    for key, frame in enumerate(source.chosen):
        np.testing.assert_array_equal(stored["frame_expressions"][key], frame.parameters.expression)
        np.testing.assert_array_equal(stored["frame_rotations"][key], frame.parameters.rotations)
        np.testing.assert_array_equal(stored["frame_translations"][key], frame.parameters.translation)
    (jaw,) = (control for control in description["controls"] if control["label"] == "jaw, open")
    assert jaw["joints"] == [template.joint_names.index("jaw")]
    rows = description["sliders"]["main"] + description["sliders"]["more"]
    assert sorted(row["name"] for row in rows) == sorted(template.expression_names)
    assert AVERAGED > 1


def test_the_verb_writes_a_folder_or_nothing(saved, tmp_path, capsys):
    out = tmp_path / "page"
    options = ["--avatar", str(saved), "--format", "avatar-web", "--out", str(out)]
    assert command([*options, "--frames", "9"]) == 2
    assert list(tmp_path.iterdir()) == []
    assert command(options) == 0
    names = {"index.html", "page.js", "avatar.js", "head.js", "splats.js", "avatar.json", "avatar.bin"}
    assert {path.name for path in out.iterdir()} == names
    capsys.readouterr()
    assert command(options) == 2
    assert f"{out}: expected a new or an empty folder" in capsys.readouterr().err


@pytest.fixture(scope="module")
def served(saved, tmp_path_factory):
    """The address of a page of the finished run under no light, with all of its frames."""
    folder = tmp_path_factory.mktemp("served") / "page"
    options = ("--format", "avatar-web", "--albedo", "--split", "train", "--out", str(folder))
    assert command(["--avatar", str(saved), *options]) == 0
    handler = functools.partial(QuietHandler, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}/"
    server.shutdown()
    server.server_close()


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *arguments):
        pass


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"), width=640, height=480)
    yield browser
    browser.end()


@pytest.fixture
def page(browser, served):
    page = browser.open("about:blank")
    noting = (
        "window.faults = []; window.addEventListener('error', (e) => faults.push(e.message));"
        "window.addEventListener('unhandledrejection', (e) => faults.push(String(e.reason)));"
        "for (const kind of ['error', 'warn']) console[kind] = (...words) => faults.push(words.join(' '));"
    )
    page.call("Page.addScriptToEvaluateOnNewDocument", source=noting)
    page.call("Page.navigate", url=served)
    page.until("window.page !== undefined && !window.page.asked", seconds=120)
    yield page
    assert page.evaluate("window.faults") == []
    browser.vanish(page)


def seen(page):
    """(H, W, 3) what the canvas shows, drawn anew."""
    page.until("!window.page.asked", seconds=60)
    return page.screenshot()[:, :360].astype(float)


@in_browser
def test_the_page_opens_and_shows_the_head(page):
    assert page.evaluate("document.querySelector('#message').hidden")
    picture = seen(page)
    assert (picture.mean(axis=2) < 200).mean() > 0.1
    assert (picture[:5] == 255).all()
    assert page.evaluate("document.querySelectorAll('#panel label input').length") >= 8


@in_browser
@pytest.mark.parametrize("label", ["jaw, open", "head, turn", "an expression"])
def test_a_slider_moves_the_picture_and_reset_takes_it_back(page, label):
    before = seen(page)
    if label == "an expression":
        label = page.evaluate("window.page.avatar.description.sliders.main[0].name")
    moved = page.evaluate(
        "(() => { for (const row of document.querySelectorAll('#panel label')) {"
        f" if (row.innerText.trim() !== {label!r}) continue;"
        " const input = row.querySelector('input'); input.value = input.max;"
        " input.dispatchEvent(new Event('input')); return true; } return false; })()"
    )
    assert moved
    # an expression may be one of a lid alone
    assert (seen(page) != before).any()
    page.evaluate("document.querySelector('#reset').click()")
    np.testing.assert_array_equal(seen(page), before)


@in_browser
def test_play_moves_it_and_pause_stops_it(page):
    before = seen(page)
    for _ in range(20):
        page.evaluate("document.querySelector('#play').click()")
        page.until("window.page.frame >= 1", seconds=60)
        page.evaluate("document.querySelector('#play').click()")
        if page.evaluate("window.page.frame >= 1"):  # it may have come round to the first one meanwhile
            break
    after = seen(page)
    assert np.abs(after - before).mean() > 0.1
    np.testing.assert_array_equal(seen(page), after)


@in_browser
def test_the_mouse_goes_round_and_the_wheel_nearer(page):
    before = seen(page)
    page.drag(180, 240, 80, 20)
    after = seen(page)
    assert np.abs(after - before).mean() > 0.5
    distance = page.evaluate("window.page.orbit.distance")
    page.mouse("mouseWheel", 180, 240, deltaX=0, deltaY=-200)
    page.until(f"window.page.orbit.distance < 0.9 * {distance}", seconds=60)


@in_browser
def test_its_picture_is_that_of_the_bound_gaussians(page, saved):
    """Drawn by the same formulas, but half floats, a sort in 65,536 steps and the mean of the residual."""
    avatar = Avatar.load(saved)
    train = [frame for frame in read_frames(saved) if frame.part == "train"]
    for number, frame in enumerate(train[:2]):
        camera = frame.camera.with_longer_side(96)
        with torch.no_grad():
            gbuffer = avatar.rasterize(avatar.move(frame.parameters), camera)
        wanted = gbuffer.alpha * avatar.display(gbuffer.albedo) + 1.0 - gbuffer.alpha
        lens = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")}
        view = json.dumps({"worldToCamera": camera.world_to_camera.flatten().tolist(), **lens})
        pixels = page.evaluate(
            "(() => { const {avatar} = window.page, canvas = avatar.canvas;"
            " Object.assign(canvas, {width: 96, height: 96});"
            f" avatar.draw(avatar.frame({number}), {view});"
            " const gl = avatar.view.gl, data = new Uint8Array(96 * 96 * 4);"
            " gl.readPixels(0, 0, 96, 96, gl.RGBA, gl.UNSIGNED_BYTE, data); return Array.from(data); })()"
        )
        found = np.array(pixels).reshape(96, 96, 4)[::-1, :, :3] / 255.0
        error = float(((found - wanted.numpy()) ** 2).mean())
        assert -10.0 * np.log10(error) > 35.0
