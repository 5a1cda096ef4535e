#!/usr/bin/env bash
# pymatting 1.1.16 with numba 0.68.1 and torch 2.13.0: importing pymatting gives torch all cores.
#
# 2026-11-30, Python 3.11, Linux x86-64, CPU, two cores. OMP_NUM_THREADS=1, or torch.set_num_threads(1), is how a
# data-loading worker or a reproducible run is held to one thread. pymatting, which makes closed-form mattes of
# heads, compiles with numba when it is imported, and numba sets the number of threads of the OpenMP runtime that
# torch shares to the number of cores. torch is not asked: it reports the new number, and sums that it divides
# among other threads end in other bits. Mattes made in the process of a training change what is trained.
set -euo pipefail
if [ "$(nproc)" -lt 2 ]; then
    echo "this needs two cores"
    exit 1
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    torch==2.13.0 numpy==2.4.6 pymatting==1.1.16 numba==0.68.1 2>/dev/null
OMP_NUM_THREADS=1 "$folder/venv/bin/python" - <<'PYTHON'
import os
import sys

import torch

before = torch.get_num_threads()
import pymatting  # noqa: E402

after = torch.get_num_threads()
print(f"torch {torch.__version__}, pymatting {pymatting.__version__}, {os.cpu_count()} cores")
print(f"torch's threads: {before} as asked, {after} once pymatting is imported")
sys.exit(0 if before == 1 and after == os.cpu_count() else "this has changed")
PYTHON
