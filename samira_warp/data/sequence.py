"""Opening a dataset folder, whatever its format: the one way in for every verb."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from samira_warp.data.appearance import read_appearance
from samira_warp.data.formats import recognise
from samira_warp.data.frames import Frame, FrameFiles, Listing, TrackedSequence
from samira_warp.data.index import FileIndex
from samira_warp.data.split import parse_split
from samira_warp.data.tracking import Reading
from samira_warp.head.models import read_head
from samira_warp.head.parameters import FrameParameters
from samira_warp.head.template import HeadTemplate, read_template
from samira_warp.support.errors import UserError
from samira_warp.support.faults import all_of


def open_listing(root: Path, *, split: str = "dataset") -> Listing:
    """List a dataset's pictures, masks and cameras without its parameters, as scoring needs.

    Args:
        root: The dataset's folder, of any of `formats.FORMATS`.
        split: ``train``, ``test`` or ``dataset`` (the dataset's own), a fraction, or ``last:N``.

    Raises:
        UserError: The folder is missing or of no known format, or anything that it lists is missing or does
            not fit.
    """
    reading, index = _open(root, split)
    index.save()
    return reading.listing


def open_sequence(root: Path, *, split: str = "dataset", flame: Path | None = None) -> TrackedSequence:
    """Open a dataset for training or rendering: everything but the pixels is read and checked.

    Args:
        root: The dataset's folder, of any of `formats.FORMATS`.
        split: ``train``, ``test`` or ``dataset`` (the dataset's own), a fraction, or ``last:N``.
        flame: The user's own FLAME file or a template, for a dataset that brings no ``template.npz``.

    Raises:
        UserError: As in open_listing; also where the template or any parameter is missing, of a wrong shape
            or not finite.
    """
    (reading, index), (template, template_path) = all_of(
        lambda: _open(root, split), lambda: _template(root, flame)
    )
    tracking, appearance = all_of(lambda: reading.tracking(template), lambda: read_appearance(root, template))
    index.save()
    listing = reading.listing
    return TrackedSequence(
        root=root,
        format=listing.format,
        split=listing.split,
        frames=tuple(
            _with_parameters(frame, tracking.parameters[row])
            for frame, row in zip(listing.frames, tracking.rows, strict=True)
        ),
        train=listing.train,
        test=listing.test,
        notes=(*listing.notes, *tracking.notes),
        doubts=listing.doubts,
        shape=tracking.shape,
        template=template,
        template_path=template_path,
        static_offset=tracking.static_offset,
        appearance=appearance,
    )


def _open(root: Path, split: str) -> tuple[Reading, FileIndex]:
    wanted, kind, index = parse_split(split), recognise(root), FileIndex(root)
    return kind.open(root, wanted, index), index


def _template(root: Path, flame: Path | None) -> tuple[HeadTemplate, Path]:
    """The dataset's own template, else the user's, and where it was read."""
    own = root / "template.npz"
    if own.is_file():
        return read_template(own), own
    if flame is None:
        raise UserError(own, expected="the dataset's own head template, or --flame FILE", found="neither")
    return read_head(flame), flame


def _with_parameters(frame: FrameFiles, parameters: FrameParameters) -> Frame:
    return Frame(**{field.name: getattr(frame, field.name) for field in fields(frame)}, parameters=parameters)
