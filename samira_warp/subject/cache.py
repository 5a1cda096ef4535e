"""Where the built-in subject is kept, and making it where it is not yet."""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from filelock import FileLock
from tqdm import tqdm

from samira_warp.files import cache_folder
from samira_warp.subject.head import build_head
from samira_warp.subject.make import TEXELS, VERSION, SubjectPlan, make_subject
from samira_warp.subject.materials import paint
from samira_warp.subject.studio import Cast, threads


def subject_folder(seed: int = 0) -> Path:
    """The folder of the dataset of a seed, whether it is there or not."""
    return cache_folder() / "subject" / f"subject-{VERSION}-seed{seed}"


def built_in_subject(seed: int = 0) -> Path:
    """The folder of the built-in subject's dataset, which is made on its first use; one line says where it is, and why.

    Raises:
        OSError: It cannot be written.
    """
    folder = subject_folder(seed)
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        # another process may be making it
        with FileLock(folder.parent / f".{folder.name}.lock"):
            if not folder.is_dir():
                print(f"no --data: making the built-in subject, once, in {folder}", file=sys.stderr)
                make_subject(folder, SubjectPlan(seed=seed), build_cast(seed))
                return folder
    print(f"no --data: the built-in subject, in {folder}", file=sys.stderr)
    return folder


def build_cast(seed: int, *, texels: int = TEXELS) -> Cast:
    """Whose head it is, and what it is made of: with a progress bar, and the same for any number of threads."""
    with threads(1), tqdm(total=2, unit="part", desc="shaping the head", dynamic_ncols=True) as bar:
        head = build_head(seed)
        bar.update()
        bar.set_description("painting the head")
        materials = paint(head, seed=seed, size=texels)
        bar.update()
    return Cast(head.template, torch.from_numpy(head.identity), materials)
