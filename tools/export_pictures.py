"""Compare what a browser shows of an exported avatar with the avatar's own pictures, frame by frame.

usage: python tools/export_pictures.py --avatar RUN --exported FILE.glb --three FOLDER [--out SHEET.png]
       python tools/export_pictures.py --avatar RUN --exported FOLDER [--albedo] [--out SHEET.png]

The first is a `glb`, drawn by three.js (`npm pack three`, unpacked: FOLDER has build/ and examples/jsm/): its
base colour alone beside the avatar's albedo, and under a light of 1 from everywhere. The second is an
`avatar-web`, drawn by its own code, beside the picture under the light that it was exported with: the learned
one, or none with --albedo. Both were exported with the default frames. A headless Chromium draws.
"""

from __future__ import annotations

import base64
import contextlib
import http.server
import io
import json
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import torch
from PIL import Image

from samira_warp.avatar import Avatar, DrivingFrame, read_frames
from samira_warp.avatar.storage import find_avatar
from samira_warp.geometry.camera import Camera
from samira_warp.io.images import to_uint8, write_png
from samira_warp.light import Environment
from samira_warp.support.cli import run
from samira_warp.support.errors import UserError

SECONDS = 600.0
"""That a browser may take; software rendering on a busy machine is slow."""

FLAGS = (
    *(
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
    ),
    *("--disable-dev-shm-usage", "--no-first-run", "--disable-background-networking", "--disable-sync"),
)

GLB_PAGE = """<!doctype html>
<script type="importmap">{"imports": {"three": "/three/build/three.module.js"}}</script>
<script type="module">
import * as THREE from "three";
import {GLTFLoader} from "/three/examples/jsm/loaders/GLTFLoader.js";
const post = (path, body) => fetch(path, {method: "POST", body});
window.addEventListener("error", (event) => post("/failed", event.message));
try {
  const {views, fps} = await (await fetch("/views.json")).json();
  const gltf = await new GLTFLoader().loadAsync("/exported");
  const scene = new THREE.Scene();
  scene.add(gltf.scene);
  const renderer = new THREE.WebGLRenderer({antialias: true, preserveDrawingBuffer: true});
  renderer.setClearColor(0xffffff, 1);
  const mixer = new THREE.AnimationMixer(gltf.scene);
  for (const clip of gltf.animations) {
    const action = mixer.clipAction(clip);
    action.setLoop(THREE.LoopOnce);
    action.clampWhenFinished = true;  // the end of a clip that repeats is its beginning
    action.play();
  }
  const ones = new Float32Array(64 * 32 * 4).fill(1);
  const white = new THREE.DataTexture(ones, 64, 32, THREE.RGBAFormat, THREE.FloatType);
  white.mapping = THREE.EquirectangularReflectionMapping;
  white.needsUpdate = true;
  scene.environment = white;
  const meshes = [];
  scene.traverse((node) => { if (node.isMesh) { node.frustumCulled = false; meshes.push(node); } });
  const materials = {white: meshes.map((mesh) => mesh.material)};
  const anisotropy = renderer.capabilities.getMaxAnisotropy();
  for (const {map, normalMap, roughnessMap} of materials.white) {
    for (const texture of [map, normalMap, roughnessMap]) texture.anisotropy = anisotropy;
  }
  materials.albedo = materials.white.map((m) => new THREE.MeshBasicMaterial({map: m.map, side: m.side}));
  for (const {number, width, height, fx, fy, cx, cy, toWorld} of views) {
    renderer.setSize(width, height, false);
    const camera = new THREE.PerspectiveCamera();
    const near = 0.05, far = 20;
    camera.projectionMatrix.set(
      2 * fx / width, 0, 1 - 2 * cx / width, 0,
      0, 2 * fy / height, 2 * cy / height - 1, 0,
      0, 0, (near + far) / (near - far), 2 * near * far / (near - far),
      0, 0, -1, 0);
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    camera.matrixAutoUpdate = false;
    camera.matrix.set(...toWorld);
    camera.matrixWorldNeedsUpdate = true;
    mixer.setTime(number / fps);
    for (const [name, own] of Object.entries(materials)) {
      meshes.forEach((mesh, i) => { mesh.material = own[i]; });
      renderer.render(scene, camera);
      await post(`/picture/${name}/${number}`, renderer.domElement.toDataURL("image/png"));
    }
  }
  await post("/done", "");
} catch (error) { await post("/failed", error.stack); }
</script>"""

WEB_PAGE = """<!doctype html><canvas id="picture"></canvas><script type="module">
import {Avatar} from "/exported/avatar.js";
const post = (path, body) => fetch(path, {method: "POST", body});
try {
  const {views} = await (await fetch("/views.json")).json();
  const canvas = document.getElementById("picture");
  const avatar = await Avatar.load("/exported/", canvas);
  for (const {number, width, height, ...camera} of views) {
    Object.assign(canvas, {width, height});
    avatar.draw(avatar.frame(number), camera);
    await post(`/picture/splats/${number}`, canvas.toDataURL("image/png"));
  }
  await post("/done", "");
} catch (error) { await post("/failed", error.stack); }
</script>"""


@dataclass(frozen=True)
class PicturesConfig:
    """Compare what a browser shows of an exported avatar with the avatar's own pictures."""

    avatar: Path
    """Avatar folder, or the run folder that it is in."""
    exported: Path
    """What was exported of it, with the default frames: a .glb, or the folder of an avatar-web."""
    three: Path | None = None
    """For a .glb: three.js, as `npm pack three` has it, unpacked."""
    albedo: bool = False
    """The avatar-web was exported with --albedo."""
    count: int = 8
    """How many of the test frames are compared, evenly."""
    out: Path | None = None
    """A sheet of the first of them: the browser's pictures, and the avatar's below."""


def main(config: PicturesConfig) -> None:
    """Print a JSON object: PSNR of whole frames, and of what both cover, by picture."""
    folder = find_avatar(config.avatar)
    frames = [frame for frame in read_frames(folder) if frame.part == "test"]
    numbers = np.unique(np.linspace(0, len(frames) - 1, config.count).round().astype(int)).tolist()
    chosen = {number: frames[number] for number in numbers}
    pictures = browser_pictures(config.exported, chosen, three=config.three)
    avatar = Avatar.load(folder)
    wanted = {name: own_pictures(avatar, chosen, name, albedo=config.albedo) for name in pictures}
    scores = {name: score(pictures[name], wanted[name]) for name in pictures}
    print(json.dumps({"exported": config.exported.name, "frames": len(chosen), **scores}, indent=1))
    if config.out is not None:
        first = numbers[len(numbers) // 2]
        rows = [[pictures[name][first], to_uint8(wanted[name][first][0])] for name in pictures]
        write_png(config.out, np.concatenate([np.concatenate(row, axis=0) for row in rows], axis=1))


def browser_pictures(
    exported: Path, frames: dict[int, DrivingFrame], *, three: Path | None = None
) -> dict[str, dict[int, np.ndarray]]:
    """(H, W, 3) uint8 pictures by name and number of the frame in the sequence that was exported.

    Raises:
        UserError: There is no browser, it says that it cannot draw them, or it takes too long.
    """
    is_glb = exported.is_file()
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        raise UserError("chromium", expected="a Chromium on the path", found="none")
    if is_glb and three is None:
        raise UserError("--three", expected="the folder of three.js, for a .glb", found="none")
    views = [_view(number, frame.camera, is_glb=is_glb) for number, frame in frames.items()]
    server = _Server(
        exported, three, page=GLB_PAGE if is_glb else WEB_PAGE, views={"views": views, "fps": 25.0}
    )
    with tempfile.TemporaryDirectory() as profile, server.running() as address:
        process = subprocess.Popen(
            [chromium, *FLAGS, f"--user-data-dir={profile}", address],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            if not server.ended.wait(SECONDS):
                server.failure = f"nothing after {SECONDS:.0f} s"
        finally:
            process.terminate()
            process.wait()
    if server.failure is not None:
        raise UserError(exported, expected="what a browser can draw", found=server.failure)
    return server.pictures


@torch.no_grad()
def own_pictures(
    avatar: Avatar, frames: dict[int, DrivingFrame], name: str, *, albedo: bool
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """(H, W, 3) display values on white and (H, W) coverage of the avatar itself, by number."""
    light = Environment.from_cubemaps(*(torch.ones(6, 16, 16, 3),) * 2) if name == "white" else None
    found = {}
    for number, frame in frames.items():
        rendering = avatar.render(frame.parameters, frame.camera, light)
        alpha = rendering.gbuffer.alpha
        image = rendering.image
        if name == "albedo" or albedo:
            image = alpha * rendering.albedo + 1.0 - alpha
        found[number] = image.clamp(0.0, 1.0).numpy(), alpha[..., 0].numpy()
    return found


def score(
    pictures: dict[int, np.ndarray], wanted: dict[int, tuple[np.ndarray, np.ndarray]]
) -> dict[str, float]:
    """Mean PSNR in dB over frames: of all pixels, and of those that the avatar covers and the browser too."""
    whole, covered = [], []
    for number, picture in pictures.items():
        image, alpha = wanted[number]
        error = ((picture / 255.0 - image) ** 2).mean(axis=2)
        both = (alpha > 0.95) & (picture.min(axis=2) < 250)
        whole.append(-10.0 * np.log10(error.mean()))
        covered.append(-10.0 * np.log10(error[both].mean()))
    return {"psnr": round(float(np.mean(whole)), 2), "psnr_covered": round(float(np.mean(covered)), 2)}


def _view(number: int, camera: Camera, *, is_glb: bool) -> dict[str, Any]:
    """A camera for a page: world to camera, y down, z forward; for a .glb its inverse, y up, z back."""
    lens = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    transform = camera.world_to_camera.double()
    if not is_glb:
        return {"number": number, **lens, "worldToCamera": transform.flatten().tolist()}
    turned = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
    return {"number": number, **lens, "toWorld": (turned @ transform).inverse().flatten().tolist()}


class _Server:
    """Serves a page and what it reads on this machine alone, and takes the pictures that it sends."""

    def __init__(self, exported: Path, three: Path | None, *, page: str, views: dict[str, Any]) -> None:
        self.pictures: dict[str, dict[int, np.ndarray]] = {}
        self.failure: str | None = None
        self.ended = threading.Event()
        self._folders = {"exported": exported, **({} if three is None else {"three": three})}
        self._texts = {"/": ("text/html", page), "/views.json": ("application/json", json.dumps(views))}

    @contextlib.contextmanager
    def running(self) -> Iterator[str]:
        """The page's address, while it is served."""
        handler = type("Handler", (_Handler,), {"owner": self})
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            server.server_close()

    def answer(self, path: str) -> tuple[str, bytes] | None:
        """The kind and the content of what is asked for."""
        if path in self._texts:
            kind, text = self._texts[path]
            return kind, text.encode()
        _, top, *rest = unquote(path).split("/")
        if top not in self._folders or ".." in rest:
            return None
        file = self._folders[top].joinpath(*rest)
        kinds = {".js": "text/javascript", ".json": "application/json", ".html": "text/html"}
        return (
            (kinds.get(file.suffix, "application/octet-stream"), file.read_bytes())
            if file.is_file()
            else None
        )

    def take(self, path: str, body: bytes) -> None:
        """A picture, or word of the end."""
        _, what, *rest = path.split("/")
        if what == "picture":
            pixels = Image.open(io.BytesIO(base64.b64decode(body.split(b",", 1)[1]))).convert("RGB")
            self.pictures.setdefault(rest[0], {})[int(rest[1])] = np.asarray(pixels)
            return
        if what == "failed":
            self.failure = " ".join(body.decode().split())
        self.ended.set()


class _Handler(http.server.BaseHTTPRequestHandler):
    owner: _Server

    def do_GET(self) -> None:
        found = self.owner.answer(urlsplit(self.path).path)
        if found is None:
            self.send_error(404)
            return
        kind, content = found
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def do_POST(self) -> None:
        self.owner.take(self.path, self.rfile.read(int(self.headers["Content-Length"])))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *arguments: object) -> None:
        """Nothing: standard output is the result's."""


if __name__ == "__main__":
    sys.exit(run(main, PicturesConfig, program="export_pictures"))
