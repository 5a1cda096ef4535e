"""A head for tests of what surrounds it: the made-up sphere with eyes, in plain colours.

``python tests/subject/stand_in.py --out FOLDER`` makes its dataset there, with as many pictures as ``--train
N`` says. With ``--stall-at FILE`` it says so in the middle of writing that file, and goes no further.
"""

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import torch

TESTS = Path(__file__).resolve().parents[1]
if str(TESTS) not in sys.path:
    sys.path.insert(0, str(TESTS))

from subjects import small_template  # noqa: E402

from samira_subject import make  # noqa: E402
from samira_subject.make import make_subject  # noqa: E402
from samira_subject.orbit import View  # noqa: E402
from samira_subject.plan import SubjectPlan  # noqa: E402
from samira_subject.raycaster import Effort  # noqa: E402
from samira_subject.studio import Cast  # noqa: E402
from samira_warp.support.cli import run  # noqa: E402

PLAN = SubjectPlan(
    seed=3,
    train=3,
    test=2,
    relit=1,
    size=48,
    texels=32,
    effort=Effort(samples=2, lights=2, lobes=1, more=2, rounds=1),
    orbit=(View(0, 0), View(90, 0), View(0, 40)),
)
NAMES = ("mouthSmile_L", "mouthSmile_R", "eyeBlink_L", "browInnerUp")


class PlainMaterials:
    """Skin colour with a gradient, and bumps that grow as the jaw opens."""

    def __init__(self, size):
        ramp = torch.linspace(0.0, 1.0, size)
        self.albedo = (
            torch.tensor([0.5, 0.3, 0.2]) * (0.6 + 0.4 * ramp[None, :, None]) * torch.ones(size, 1, 1)
        )
        self.finish = torch.tensor([0.5, 0.03, 1.0]).expand(size, size, 3).contiguous()
        self._waves = 0.2 * torch.sin(40.0 * ramp)[:, None, None] * torch.ones(1, size, 3)

    def relief(self, expression, jaw):
        return (0.2 + jaw) * self._waves


def stand_in(size=32):
    return Cast(
        replace(small_template(), expression_names=NAMES), torch.tensor([0.5, -0.5]), PlainMaterials(size)
    )


@dataclass(frozen=True)
class StandInConfig:
    """Make the stand-in's dataset."""

    out: Path
    train: int = PLAN.train
    stall_at: str | None = None


def main(config: StandInConfig) -> None:
    if config.stall_at is not None:
        make.write_png = stalling(make.write_png, at=config.stall_at)
    make_subject(config.out, replace(PLAN, train=config.train), stand_in)


def stalling(write, *, at):
    """``write``, but one file of a folder is never finished."""

    def write_or_stall(path, pixels):
        write(path, pixels)
        name = path.name.replace(".new.", ".").removeprefix(".")
        if f"{path.parent.name}/{name}" == at:
            path.write_bytes(path.read_bytes()[:100])
            print("stalled", file=sys.stderr, flush=True)
            time.sleep(600)

    return write_or_stall


def contents(folder):
    """Every file's bytes, by its path."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(Path(folder).rglob("*"))
        if path.is_file()
    }


if __name__ == "__main__":
    sys.exit(run(main, StandInConfig, program="stand_in"))
