"""Whose head it is, and what it is made of, from a seed."""

from __future__ import annotations

import torch
from tqdm import tqdm

from samira_subject.head import build_head
from samira_subject.hidden_motion import hidden_motion
from samira_subject.materials import paint
from samira_subject.plan import TEXELS
from samira_subject.studio import Cast, threads


def build_cast(seed: int, *, texels: int = TEXELS, hidden: bool = False) -> Cast:
    """Shape and paint a head: with a progress bar, and the same for any number of threads.

    Args:
        seed: Whose head, 0 or more.
        texels: Width and height of the painted maps.
        hidden: Let it move as well as its template has no shapes for (`samira_subject.hidden_motion`), hair
            and collar in patches that show it.
    """
    with threads(1), tqdm(total=2, unit="part", desc="shaping the head", dynamic_ncols=True) as bar:
        head = build_head(seed)
        bar.update()
        bar.set_description("painting the head")
        materials = paint(head, seed=seed, size=texels, patches=hidden)
        bar.update()
    motion = hidden_motion(head.template) if hidden else None
    return Cast(head.template, torch.from_numpy(head.identity), materials, motion)
