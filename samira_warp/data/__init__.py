"""Datasets: what a folder holds, read and checked before anything is trained on it."""

from samira_warp.data.cache import PixelCache
from samira_warp.data.formats import FORMATS, recognise
from samira_warp.data.frames import Frame, FrameFiles, Listing, TrackedSequence
from samira_warp.data.pixels import FramePixels, load_pixels
from samira_warp.data.sequence import open_listing
from samira_warp.data.sequence import open_sequence as open_sequence  # public as samira_warp.open_sequence
from samira_warp.data.subjects import MadeSubject, made_subject

__all__ = [
    "FORMATS",
    "Frame",
    "FrameFiles",
    "FramePixels",
    "Listing",
    "MadeSubject",
    "PixelCache",
    "TrackedSequence",
    "load_pixels",
    "made_subject",
    "open_listing",
    "recognise",
]
