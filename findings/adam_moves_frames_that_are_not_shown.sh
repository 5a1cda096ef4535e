#!/usr/bin/env bash
# torch 2.13.0: Adam over a table of per-frame parameters moves every frame at every step.
#
# 2026-11-30, Python 3.11, Linux x86-64, CPU. Avatars of the GaussianAvatars family tune the tracked pose and
# expression of each frame as rows of one parameter, and a step shows one frame: the gradient of the other rows is
# zero, but not absent, so Adam goes on moving them by the momentum of when they were last shown. Here 300 rows of
# three numbers are pulled towards random targets, one row a step, ten times each in random order. Nine tenths of
# a row's way are made in steps that do not show it.
#
# torch.optim.SparseAdam with a sparse gradient leaves the others alone, but counts every step of the table as
# the row's own when it corrects the bias of its moments: a row whose first gradient comes at step 1,000 moves by
# 2.5 times the rate, where Adam's first step is the rate itself.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.13.0 numpy==2.4.6 2>/dev/null
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import torch

ROWS, EPOCHS, RATE = 300, 10, 1e-3
generator = torch.Generator().manual_seed(0)
targets = torch.randn(ROWS, 3, generator=generator)
table = torch.nn.Parameter(torch.zeros(ROWS, 3))
adam = torch.optim.Adam([table], lr=RATE, eps=1e-15)
shown, unshown = torch.zeros(()), torch.zeros(())
for _ in range(EPOCHS):
    for row in torch.randperm(ROWS, generator=generator).tolist():
        before = table.detach().clone()
        adam.zero_grad()
        (table[row] - targets[row]).square().sum().backward()
        adam.step()
        moved = (table.detach() - before).abs().sum(dim=1)
        shown += moved[row]
        unshown += moved.sum() - moved[row]
share = float(unshown / (shown + unshown))

sparse_table = torch.nn.Parameter(torch.zeros(2, 1))
sparse = torch.optim.SparseAdam([sparse_table], lr=RATE)
for step in range(1, 1001):
    row = 1 if step == 1000 else 0
    sparse_table.grad = torch.sparse_coo_tensor([[row]], torch.ones(1, 1), (2, 1))
    sparse.step()
first = float(sparse_table[1].abs() / RATE)

print(f"torch {torch.__version__}: Adam makes {share:.0%} of the way of a row while it is not shown")
print(f"SparseAdam's first step of a row, at step 1,000: {first:.2f} times the rate")
sys.exit(0 if 0.85 < share < 0.95 and 2.4 < first < 2.7 else "this has changed")
PYTHON
