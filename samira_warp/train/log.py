"""What a run shows while it trains: metrics.jsonl, TensorBoard events, preview grids, the progress bar."""

from __future__ import annotations

import json
import time
from pathlib import Path
from types import TracebackType

import numpy as np
import torch
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from samira_warp.avatar import Rendering
from samira_warp.io.files import replace_file
from samira_warp.io.images import write_png
from samira_warp.light import Environment, encode_srgb
from samira_warp.light.equirect import cube_to_equirect
from samira_warp.train.losses import Target
from samira_warp.train.metrics import METRICS_FILE, read_metrics

LOG_EVERY = 25
"""Steps between log lines: numbers are read back from the device only then."""


class RunLog:
    """Scalars and pictures of a run; use as a context manager."""

    def __init__(self, folder: Path, *, steps: int, start: int) -> None:
        self._previews = folder / "preview"
        self._previews.mkdir(parents=True, exist_ok=True)
        self._metrics = folder / METRICS_FILE
        _drop_lines_after(self._metrics, start)
        # a run that goes on has taken the time until then, and none while it stood still
        before = [line["seconds"] for line in read_metrics(folder) if "seconds" in line]
        self._began = time.monotonic() - (before[-1] if before else 0.0)
        self._board = SummaryWriter(str(folder), purge_step=start)
        self._bar = tqdm(total=steps, initial=start, unit="step", dynamic_ncols=True)
        self._sums: dict[str, torch.Tensor] = {}
        self._count = 0
        self._last = steps

    def __enter__(self) -> RunLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()
        self._board.close()

    def add(
        self,
        step: int,
        terms: dict[str, torch.Tensor],
        *,
        frames: int,
        gaussians: int,
        test_psnr: float | None = None,
    ) -> None:
        """Add the detached scalars of one step, or of several that were taken at once.

        Their means are written every LOG_EVERY steps, at the last one, and where test frames were looked at.

        Args:
            step: Number of steps done.
            terms: Loss terms and ``mse``, the mean squared error of the image, summed over the steps.
            frames: How many those were.
            gaussians: N.
            test_psnr: Of some test frames after this step, dB; None where nobody looked.
        """
        for name, value in terms.items():
            self._sums[name] = self._sums[name] + value if name in self._sums else value
        self._count += frames
        self._bar.update(frames)
        due = step // LOG_EVERY > (step - frames) // LOG_EVERY or step == self._last
        if due or test_psnr is not None:
            self._write(step, gaussians, test_psnr)

    def preview(self, step: int, rendering: Rendering, target: Target, light: Environment) -> None:
        """Write one preview grid: image | truth | albedo | normal | specular light | the light itself."""
        grid = preview_grid(rendering, target, light)
        write_png(self._previews / f"{step:06d}.png", grid)
        self._board.add_image("preview", grid, step, dataformats="HWC")

    def _write(self, step: int, gaussians: int, test_psnr: float | None) -> None:
        names = list(self._sums)
        means = dict(
            zip(
                names, (torch.stack([self._sums[name] for name in names]) / self._count).tolist(), strict=True
            )
        )
        psnr = -10.0 * float(np.log10(max(means.pop("mse"), 1e-12)))
        shown = {"loss": sum(means.values()), "psnr": psnr, "gaussians": gaussians, **means}
        test = {} if test_psnr is None else {"test_psnr": test_psnr}
        line = {"step": step, "seconds": round(time.monotonic() - self._began, 3), **shown, **test}
        with self._metrics.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        for name, value in shown.items():
            self._board.add_scalar(f"train/{name}", value, step)
        if test_psnr is not None:
            self._board.add_scalar("test/psnr", test_psnr, step)
        self._bar.set_postfix_str(
            f"loss {shown['loss']:.4f}, PSNR {psnr:.2f} dB, {gaussians} Gaussians", refresh=False
        )
        self._sums, self._count = {}, 0


def preview_grid(rendering: Rendering, target: Target, light: Environment) -> np.ndarray:
    """Image | truth | albedo | normal | specular light, each on white, and `light_panel`.

    Returns:
        (H, 5 W + 2 (H // 2), 3) display values.
    """
    gbuffer = rendering.gbuffer
    alpha = gbuffer.alpha
    # white behind both, whatever colour it was in this step
    white, mask = 1.0 - target.background, target.mask
    truth = target.image if mask is None else target.image + (1.0 - mask[..., None]) * white
    panels = [rendering.image + (1.0 - alpha) * white, truth]
    panels += [
        alpha * panel + (1.0 - alpha)
        for panel in (rendering.albedo, 0.5 * (gbuffer.normal + 1.0), encode_srgb(rendering.specular_light))
    ]
    panels.append(light_panel(light, height=len(truth)))
    return torch.cat(panels, dim=1).clamp(0.0, 1.0).detach().cpu().numpy()


def light_panel(light: Environment, *, height: int) -> torch.Tensor:
    """The diffuse map above the specular one, as panoramas, white where a row is left.

    Radiance x is shown as x / (1 + x), which leaves no lamp without its colour.

    Returns:
        (height, 2 (height // 2), 3) display values.
    """
    half = height // 2
    maps = [cube_to_equirect(radiance, height=half) for radiance in (light.diffuse, light.specular)]
    shown = encode_srgb(torch.cat([radiance / (1.0 + radiance) for radiance in maps]))
    return torch.cat([shown, shown.new_ones(height - 2 * half, 2 * half, 3)])


def _drop_lines_after(path: Path, step: int) -> None:
    """Forget what was logged after the checkpoint that a run goes on from."""
    if not path.exists():
        return
    lines = [
        line
        for line in path.read_text(encoding="utf-8").splitlines()
        if line.endswith("}") and json.loads(line)["step"] <= step
    ]
    replace_file(path, "".join(line + "\n" for line in lines))
