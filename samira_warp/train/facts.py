"""What config.json says of how a run was made."""

from __future__ import annotations

import json
import platform
from hashlib import sha256
from importlib.metadata import version
from typing import Any

import torch

from samira_warp.avatar import conditions_of
from samira_warp.data import TrackedSequence
from samira_warp.train.plan import TrainPlan

PACKAGES = ("samira-warp", "torch", "warp-lang", "numpy", "kornia", "transformers")
"""Whose versions are written down."""


def run_facts(
    plan: TrainPlan, sequence: TrackedSequence, *, perceptual: bool, ranks: int = 1
) -> dict[str, Any]:
    """How a run is made: every setting, what it trains on, versions and threads, as plain JSON values.

    Args:
        plan: The run.
        sequence: Its dataset.
        perceptual: Whether there is an LPIPS term.
        ranks: How many processes train.
    """
    versions = {name: version(name) for name in PACKAGES}
    facts = {
        "subject": sequence.root.resolve().name,
        "split": plan.settings.split,
        "settings": plan.settings.as_json(),
        "steps": plan.schedule.steps,
        "earlier_lengths": [list(length) for length in plan.schedule.earlier],
        "train_frames": len(sequence.train),
        "test_frames": len(sequence.test),
        "frames_hash": _frames_hash(sequence),
        "perceptual": perceptual,
        "template_hash": sequence.template.hash,
        "versions": {"python": platform.python_version(), **versions},
        "torch_threads": torch.get_num_threads(),
        "ranks": ranks,
    }
    return json.loads(json.dumps(facts))


def _frames_hash(sequence: TrackedSequence) -> str:
    """Digest of the subject's shape and of every frame's name and tracked head.

    FLAME's template and a number of frames are many subjects'.
    """
    digest = sha256(sequence.shape.numpy().tobytes())
    for index in (*sequence.train, *sequence.test):
        frame = sequence.frames[index]
        digest.update(frame.name.encode())
        for values in conditions_of(frame.parameters):
            digest.update(values.numpy().tobytes())
    return digest.hexdigest()
