"""Following one face through a film: landmarks and irises of every picture, or why there are none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from samira_warp.vision.crops import Square
from samira_warp.vision.cuts import CELLS, colour_histogram
from samira_warp.vision.detector import Detection, detect_faces
from samira_warp.vision.face_shape import roll_of
from samira_warp.vision.iris import LIDS, read_eye
from samira_warp.vision.mesh import POINTS, SettledReading, settle, square_about
from samira_warp.vision.networks import FaceNetworks

PRESENCE = 0.99
"""Of the face mesh, after the sigmoid. Faces have 0.9999 and more; most others have it, too, so that the rest
is geometry's to tell."""

MAX_ROLL = np.radians(75.0)
"""A head that is turned further in the picture's plane belongs to a film that is not upright."""

LEAST_WIDTH = 56.0
"""Pixels between the cheeks: the network's 192 are then filled from a third as many, and a mistake of one of
its pixels is half a millimetre either way. A narrower face has no detail to fit."""

CHECK_EVERY = 12
"""Pictures after which the detector looks again, half a second of a film of 25 a second: whether a face is
still there, and whether a larger one has come."""

LARGER = 1.5
"""By how much a face's box must be larger than that of the one that is followed to be followed instead."""

SAME_PLACE = 0.5
"""A face is the one that is followed when their centres are closer than this share of its size."""

CROP = 1.5
"""Side of the first square about a detected face in longer sides of its box; MediaPipe's own."""

CHEEKS = (234, 454)
"""Points of the mesh at either edge of a face that is seen from before."""


@dataclass(frozen=True)
class FaceTrack:
    """A face in the N pictures of a film. Where it is not seen, numbers are NaN.

    Attributes:
        landmarks: (N, 468, 3) float32 x, y in pixels of the picture, (0, 0) its upper left corner; z in the
            same unit, smaller nearer the camera, 0 about the middle of the head.
        irises: (N, 2, 5, 2) float32 pixels: the subject's left eye (at larger x in a picture that is no
            mirror image), then the right one; the centre; the rim's outer, upper,
            inner and lower point.
        lids: (N, 2, 16, 2) float32 pixels, of the same eyes: the inner corner (0), the lower lid (1 to 7),
            the outer corner (8), the upper lid (9 to 15), both lids from the inner corner on. Of lids these
            are the ones to believe: the mesh's stay open over closed eyes (`samira_warp.vision.openness`).
        presence: (N,) float32 0..1, as the network says; not by itself a reason to believe it.
        seen: (N,) bool.
        reasons: By picture why the face is not seen, else "".
        person: (N,) int32 number of the person who is followed, which changes where another is taken up; -1
            where nobody is seen.
        colours: (N, 64) float32 histogram of the picture's colours, for `samira_warp.vision.cuts`.
        notes: What should be said of the film as a whole.
    """

    landmarks: np.ndarray
    irises: np.ndarray
    lids: np.ndarray
    presence: np.ndarray
    seen: np.ndarray
    reasons: tuple[str, ...]
    person: np.ndarray
    colours: np.ndarray
    notes: tuple[str, ...]


def follow_faces(pictures: Iterable[np.ndarray], networks: FaceNetworks) -> FaceTrack:
    """Find the largest face and follow it.

    A picture at a time: memory holds the results and one picture. Where the face is lost the detector looks
    for it again, and every half second in any case; where there are several, the one that is followed stays
    so while it is in its place and no other is half again as large.

    What a picture shows is refused where two readings of the mesh do not agree (`mesh.settle`), where the
    head is rolled by 75 degrees and more, and where it is narrower than 56 pixels.

    On one core a picture of 512 x 512 takes about 25 ms.

    Args:
        pictures: (H, W, 3) uint8 each, upright, as they are shown.
        networks: What looks at them.
    """
    follower = FaceFollower(networks)
    frames = [follower.look(picture) for picture in pictures]
    return gathered(frames, follower.notes())


@dataclass(frozen=True)
class FaceFrame:
    """What one picture shows: a reading with its irises and lids, or a reason.

    Attributes:
        colours: (64,) float32 histogram of the picture's colours.
        reason: Why no face is seen, else "".
        person: Number of the person who is followed, -1 where nobody is seen.
        reading: Of the mesh, None where no face is seen.
        irises: (2, 5, 2) of both eyes, as `FaceTrack` has them.
        lids: (2, 16, 2) likewise.
    """

    colours: np.ndarray
    reason: str = ""
    person: int = -1
    reading: SettledReading | None = None
    irises: np.ndarray | None = None
    lids: np.ndarray | None = None


@dataclass
class FaceFollower:
    """Who is followed, from picture to picture, one at a time (`follow_faces`).

    Attributes:
        networks: What looks at the pictures.
        landmarks: (468, 3) of the last picture that showed the face; None where it did not.
        place: (3,) centre and size of the face when it was last seen.
        person: Number of the person who is followed, -1 before the first.
        number: How many pictures were looked at.
        most: Of faces in one picture.
        several: Numbers of the pictures with more than one.
    """

    networks: FaceNetworks
    landmarks: np.ndarray | None = None
    place: np.ndarray | None = None
    person: int = -1
    number: int = 0
    most: int = 0
    several: list[int] = field(default_factory=list)

    def look(self, picture: np.ndarray) -> FaceFrame:
        """Read a picture; call in order."""
        colours = colour_histogram(picture)
        reading, reason = self._followed(picture), ""
        if reading is None:
            reading, reason = self._found(picture)
        self.number += 1
        if reading is None:
            self.landmarks = None
            return FaceFrame(colours, reason)
        self.landmarks = reading.landmarks
        square = square_about(reading.landmarks)
        self.place = np.array([square.x, square.y, square.side / CROP])
        eyes = [read_eye(self.networks.iris, picture, reading.landmarks, left=left) for left in (True, False)]
        return FaceFrame(
            colours,
            person=self.person,
            reading=reading,
            irises=np.stack([eye.iris for eye in eyes]),
            lids=np.stack([eye.lids for eye in eyes]),
        )

    def notes(self) -> tuple[str, ...]:
        """What should be said of the film."""
        if not self.several:
            return ()
        return (
            f"up to {self.most} faces in a picture (the first time in picture {self.several[0] + 1}): "
            "the largest is followed, and stays so while another is less than half again as large",
        )

    def _followed(self, picture: np.ndarray) -> SettledReading | None:
        """The face where it was in the picture before, unless the detector should look."""
        if self.landmarks is None:
            return None
        if self.number % CHECK_EVERY == 0 and not self._confirmed(picture):
            return None
        reading = settle(self.networks.mesh, picture, square_about(self.landmarks))
        return None if refusal(reading) else reading

    def _confirmed(self, picture: np.ndarray) -> bool:
        """Whether the detector sees the face too, and no larger one. One that sees none proves nothing."""
        faces = self._detect(picture)
        if not faces:
            return True
        same = [face for face in faces if self._in_place(face)]
        return bool(same) and max(face.size for face in faces) < LARGER * max(face.size for face in same)

    def _found(self, picture: np.ndarray) -> tuple[SettledReading | None, str]:
        """The face that was followed, where it is near its place, or the largest that passes."""
        faces = sorted(self._detect(picture), key=lambda face: -face.size)
        nearby = [face for face in faces if self._in_place(face) and face.size * LARGER > faces[0].size]
        reason = "no face is found"
        for face in [*nearby, *(face for face in faces if face not in nearby)]:
            reading = self._read(picture, face)
            refused = refusal(reading)
            if not refused:
                self.person += face not in nearby
                return reading, ""
            reason = refused if reason == "no face is found" else reason
        return None, reason

    def _read(self, picture: np.ndarray, face: Detection) -> SettledReading:
        """A face as it is detected or the other way up, whichever way it settles with the higher score.

        The detector takes the mouth of a face that stands on its head for the eyes; two in 50 of such squares
        settle, with scores that are a little lower than those of faces.
        """
        x, y = (face.box[:2] + face.box[2:]) / 2
        squares = [Square(float(x), float(y), CROP * face.size, face.roll + turn) for turn in (0.0, np.pi)]
        readings = [settle(self.networks.mesh, picture, square) for square in squares]
        return min(readings, key=lambda reading: (not reading.settled, -reading.presence))

    def _detect(self, picture: np.ndarray) -> list[Detection]:
        faces = detect_faces(self.networks.detector, picture)
        if len(faces) > 1:
            self.several.append(self.number)
            self.most = max(self.most, len(faces))
        return faces

    def _in_place(self, face: Detection) -> bool:
        if self.place is None:
            return False
        x, y = (face.box[:2] + face.box[2:]) / 2
        return bool(np.hypot(x - self.place[0], y - self.place[1]) < SAME_PLACE * self.place[2])


def refusal(reading: SettledReading) -> str:
    """Why a reading of the mesh is no face to be used, or ""."""
    landmarks = reading.landmarks
    width = float(np.linalg.norm(landmarks[CHEEKS[0]] - landmarks[CHEEKS[1]]))
    roll = np.degrees(roll_of(landmarks))
    if reading.presence < PRESENCE or not reading.settled:
        return "what was taken for a face does not hold when it is looked at twice"
    if abs(roll) > np.degrees(MAX_ROLL):
        return f"the head is rolled by {roll:.0f} degrees: the picture is not upright"
    if width < LEAST_WIDTH:
        return f"the face is {width:.0f} pixels wide, which is less than {LEAST_WIDTH:.0f}"
    return ""


def gathered(frames: Sequence[FaceFrame], notes: tuple[str, ...] = ()) -> FaceTrack:
    """What pictures show, one after the other, as a film's."""
    count = len(frames)
    landmarks = np.full((count, POINTS, 3), np.nan, np.float32)
    irises = np.full((count, 2, 5, 2), np.nan, np.float32)
    lids = np.full((count, 2, LIDS, 2), np.nan, np.float32)
    presence = np.zeros(count, np.float32)
    for number, frame in enumerate(frames):
        if frame.reading is not None:
            landmarks[number], presence[number] = frame.reading.landmarks, frame.reading.presence
            irises[number], lids[number] = frame.irises, frame.lids
    return FaceTrack(
        landmarks,
        irises,
        lids,
        presence,
        seen=np.array([frame.reading is not None for frame in frames], bool),
        reasons=tuple(frame.reason for frame in frames),
        person=np.array([frame.person for frame in frames], np.int32),
        colours=np.array([frame.colours for frame in frames], np.float32).reshape(count, CELLS),
        notes=notes,
    )
