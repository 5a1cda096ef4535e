"""The heads of a VHAP export: one parameter file a timestep, and one for the identity."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from samira_warp.data.frames import Listing
from samira_warp.data.index import FileIndex
from samira_warp.data.split import Split
from samira_warp.data.track import Heads, Reading
from samira_warp.data.vhap import CANONICAL_FILE, list_vhap
from samira_warp.data.vhap_parameters import TrackedHead, read_tracked_head
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.support.faults import unless_at_fault


def open_vhap(root: Path, split: Split, index: FileIndex) -> Reading:
    """Open a VHAP export.

    Raises:
        UserError: As in list_vhap.
    """
    listing = list_vhap(root, split, index)
    return Reading(listing, lambda template: _read_heads(listing, template, index))


def _read_heads(listing: Listing, template: HeadTemplate, index: FileIndex) -> Heads:
    canonical = read_tracked_head(listing.root / CANONICAL_FILE, template)
    heads: dict[Path, TrackedHead] = {}
    for frame in listing.frames:
        path = frame.parameters_path
        if path not in heads:
            heads[path] = unless_at_fault(
                partial(_read_head, path, template, canonical, index), otherwise=canonical
            )
    parameters = tuple(heads[frame.parameters_path].parameters for frame in listing.frames)
    return Heads(canonical.shape, parameters, canonical.parameters.static_offset)


def _read_head(path: Path, template: HeadTemplate, canonical: TrackedHead, index: FileIndex) -> TrackedHead:
    """A frame's head, with the canonical static offset's memory where it repeats it; identity must not change
    within a sequence.
    """
    head = read_tracked_head(path, template, index)
    # coefficients are of order 1: the tolerance is what float32 text round trips lose
    if not torch.equal(head.shape, canonical.shape) and not torch.allclose(
        head.shape, canonical.shape, atol=1e-5
    ):
        raise UserError(f"{path}: shape", expected=f"the identity of {CANONICAL_FILE}", found="another")
    offset, shared = head.parameters.static_offset, canonical.parameters.static_offset
    if offset is not None and shared is not None and torch.equal(offset, shared):
        return head._replace(parameters=replace(head.parameters, static_offset=shared))
    return head
