"""The heads of a VHAP export: one parameter file a timestep, and one for the identity."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from samira_warp.data.frames import Listing
from samira_warp.data.index import FileIndex
from samira_warp.data.split import Split
from samira_warp.data.tracking import Reading, Tracking
from samira_warp.data.vhap import CANONICAL_FILE, list_vhap
from samira_warp.data.vhap_parameters import ParameterFile, read_parameter_file
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate
from samira_warp.support.errors import UserError
from samira_warp.support.faults import unless_at_fault


def open_vhap(root: Path, split: Split, index: FileIndex) -> Reading:
    """Open a VHAP export.

    Raises:
        UserError: As in list_vhap.
    """
    listing = list_vhap(root, split, index)
    return Reading(listing, lambda template: _read(listing, template, index))


def _read(listing: Listing, template: HeadTemplate, index: FileIndex) -> Tracking:
    """One row a parameter file: views of one moment share it."""
    canonical = read_parameter_file(listing.root / CANONICAL_FILE, template)
    row_of = {path: row for row, path in enumerate(dict.fromkeys(f.parameters_path for f in listing.frames))}
    frames = [
        unless_at_fault(
            partial(_read_frame, path, template, canonical, index), otherwise=canonical.parameters
        )
        for path in row_of
    ]
    return Tracking(
        shape=canonical.shape,
        static_offset=canonical.static_offset,
        parameters=FrameParameters.stack(frames),
        rows=tuple(row_of[frame.parameters_path] for frame in listing.frames),
    )


def _read_frame(
    path: Path, template: HeadTemplate, canonical: ParameterFile, index: FileIndex
) -> FrameParameters:
    """A frame's parameters; identity must not change within a sequence."""
    found = read_parameter_file(path, template, index)
    # coefficients are of order 1: the tolerance is what float32 text round trips lose
    if not torch.equal(found.shape, canonical.shape) and not torch.allclose(
        found.shape, canonical.shape, atol=1e-5
    ):
        raise UserError(f"{path}: shape", expected=f"the identity of {CANONICAL_FILE}", found="another")
    return replace(found.parameters, dynamic_offset=_offset_beyond(found, canonical.static_offset))


def _offset_beyond(found: ParameterFile, subjects: Tensor | None) -> Tensor | None:
    """(V, 3) metres of a frame's offsets that the subject's static one leaves, None where nothing is left.

    A frame that does not repeat the subject's static offset has it all the same; one that brings another
    keeps its head by moving the difference. Exports write zeros where they tracked none: 60 KB a frame.
    """
    own, dynamic = found.static_offset, found.parameters.dynamic_offset
    if dynamic is not None and not dynamic.any():
        dynamic = None
    if own is None or (subjects is not None and torch.equal(own, subjects)):
        return dynamic
    beyond = own if subjects is None else own - subjects
    return beyond if dynamic is None else beyond + dynamic
