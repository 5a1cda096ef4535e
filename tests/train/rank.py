"""``python tests/train/rank.py FOLDER OPTIONS``: one of several processes that train with `subjects`' preset.

After each step it writes what it holds into FOLDER, for each rank and step a file. ``END=RANK,SIGNAL,STEP``
in the environment sends that rank, or all of them where RANK is ``all``, a signal before that step.
"""

import os
import signal
import sys
from pathlib import Path

import torch

TESTS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(TESTS))

import subjects  # noqa: E402

from samira_warp.train import trainer  # noqa: E402
from samira_warp.train.checkpoint import _training_tensors  # noqa: E402
from samira_warp.train.row_adam import RowAdam  # noqa: E402

RANK = os.environ.get("RANK", "0")
FOLDER, OPTIONS = Path(sys.argv[1]), sys.argv[2:]

step_of_all, step_of_adam, seen = trainer.Trainer.train_step, RowAdam.step, {}


def told_adam(self, closure=None, *, rows=()):
    """Keep the gradients that are about to be followed, and for which rows."""
    seen["rows"] = rows = list(rows)
    for group in self.param_groups:
        for index, parameter in enumerate(group["params"]):
            if parameter.grad is not None:
                seen[f"{group['name']}.{index}"] = parameter.grad.clone()
    step_of_adam(self, closure, rows=rows)


def told_step(self):
    ended, name, at = os.environ.get("END", "none,,").split(",")
    if ended in (RANK, "all") and self.step == int(at):
        os.kill(os.getpid(), getattr(signal, name))
    before = {name: values.clone() for name, values in _training_tensors(self._state()).items()}
    before |= {name: values.clone() for name, values in self.avatar.state_dict().items()}
    seen.clear()
    result = step_of_all(self)
    after = {**_training_tensors(self._state()), **self.avatar.state_dict()}
    held = {"before": before, "after": after, "gradients": dict(seen), "terms": result[2]}
    torch.save(held, FOLDER / f"{self.step:03d}_{RANK}.pt")
    return result


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    trainer.Trainer.train_step, RowAdam.step = told_step, told_adam
    sys.exit(subjects.train_command(*OPTIONS))
