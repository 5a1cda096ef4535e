"""Driving an avatar by what somebody does now or did: films, cameras, recordings and streams of phones."""

from samira_warp.drive.arkit import SHAPES, FaceSignal
from samira_warp.drive.performer import DriveSettings, Performance, Performer
from samira_warp.drive.recording import record
from samira_warp.drive.sources import FilmedPicture, Source, open_source
from samira_warp.drive.stream import Stream

__all__ = [
    "SHAPES",
    "DriveSettings",
    "FaceSignal",
    "FilmedPicture",
    "Performance",
    "Performer",
    "Source",
    "Stream",
    "open_source",
    "record",
]
