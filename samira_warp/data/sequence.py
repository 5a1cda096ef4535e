"""Opening a dataset folder, whatever its format: the one way in for every verb."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import torch

from samira_warp.data.frames import Frame, FrameFiles, Listing, Sequence
from samira_warp.data.split import parse_split
from samira_warp.data.vhap import CANONICAL_FILE, list_vhap
from samira_warp.data.vhap_parameters import TrackedHead, read_tracked_head
from samira_warp.errors import UserError
from samira_warp.head.template import read_template


def open_listing(root: Path, *, split: str = "dataset") -> Listing:
    """List a dataset's pictures, masks and cameras without its parameters, as scoring needs.

    Args:
        root: The dataset's folder.
        split: ``train``, ``test`` or ``dataset`` (the dataset's own), a fraction, or ``last:N``.

    Raises:
        UserError: The folder is missing or of no known format, or anything that it lists is missing or does not fit.
    """
    wanted = parse_split(split)
    if not root.is_dir():
        raise UserError(root, expected="a dataset's folder", found="a file" if root.exists() else "no such folder")
    if not (root / CANONICAL_FILE).is_file():
        raise UserError(root / CANONICAL_FILE, expected="the canonical parameters that mark a VHAP export", found="no such file")
    return list_vhap(root, wanted)


def open_sequence(root: Path, *, split: str = "dataset", flame: Path | None = None) -> Sequence:
    """Open a dataset for training or rendering: everything but the pixels is read and checked.

    Args:
        root: The dataset's folder.
        split: ``train``, ``test`` or ``dataset`` (the dataset's own), a fraction, or ``last:N``.
        flame: The user's own FLAME file, for a dataset that brings no ``template.npz``.

    Raises:
        UserError: As in open_listing; also where the template or any parameter is missing, of a wrong shape or not finite.
    """
    listing = open_listing(root, split=split)
    template_path = _template_path(root, flame)
    template = read_template(template_path)
    canonical = read_tracked_head(root / CANONICAL_FILE, template)
    heads: dict[Path, TrackedHead] = {}
    for frame in listing.frames:
        if frame.parameters_path not in heads:
            heads[frame.parameters_path] = _sharing(frame.parameters_path, read_tracked_head(frame.parameters_path, template), canonical)
    return Sequence(
        root=root,
        split=listing.split,
        frames=tuple(_with_parameters(frame, heads[frame.parameters_path]) for frame in listing.frames),
        train=listing.train,
        test=listing.test,
        shape=canonical.shape,
        template=template,
        template_path=template_path,
        canonical_static_offset=canonical.parameters.static_offset,
    )


def _template_path(root: Path, flame: Path | None) -> Path:
    own = root / "template.npz"
    if own.is_file():
        return own
    if flame is None:
        raise UserError(own, expected="the dataset's own head template, or --flame FILE", found="neither")
    return flame


def _sharing(path: Path, head: TrackedHead, canonical: TrackedHead) -> TrackedHead:
    """The same head, with the canonical static offset's memory where it repeats it; identity must not change within a sequence."""
    if not torch.allclose(head.shape, canonical.shape, atol=1e-5):  # coefficients are of order 1: what float32 text round trips lose
        raise UserError(f"{path}: shape", expected=f"the identity of {CANONICAL_FILE}", found="another")
    offset, shared = head.parameters.static_offset, canonical.parameters.static_offset
    if offset is not None and shared is not None and torch.equal(offset, shared):
        return head._replace(parameters=replace(head.parameters, static_offset=shared))
    return head


def _with_parameters(frame: FrameFiles, head: TrackedHead) -> Frame:
    return Frame(**{field.name: getattr(frame, field.name) for field in fields(frame)}, parameters=head.parameters)
