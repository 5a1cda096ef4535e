"""A live source beside what shows it, and a recorded one, with sources and performers that stand in."""

import math
import queue
import threading
import time

import numpy as np
import pytest
import torch

from samira_warp.drive.arkit import SHAPES, FaceSignal
from samira_warp.drive.performer import Performance, Seen
from samira_warp.drive.recording import ranges, record, sampled
from samira_warp.drive.stream import SILENT, Condition, Stream
from samira_warp.head import FrameParameters
from samira_warp.support.errors import UserError

SECONDS = 10.0


def signal(number):
    return FaceSignal(float(number), np.zeros(len(SHAPES)))


class Source:
    """Gives what is put into its queue; None ends it, an exception is raised."""

    name, live, pictures = "udp://here:1", True, False

    def __init__(self):
        self.items, self.ended = queue.Queue(), threading.Event()

    def frames(self, *, patience=math.inf):
        while (item := self.items.get(timeout=SECONDS)) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item

    def end(self):
        if not self.ended.is_set():
            self.ended.set()
            self.items.put(None)


class Actor:
    """Poses whose translation is the frame's time; a time below 0 shows no face."""

    def __init__(self):
        self.go, self.neutral = threading.Event(), []
        self.go.set()
        self.number = 0

    def see(self, item):
        assert self.go.wait(SECONDS)
        self.number += 1
        lost = item.seconds < 0
        return [Seen(self.number - 1, item.seconds, None if lost else item, "nobody" if lost else "")]

    def close(self):
        return []

    def take_for_neutral(self, seen=None):
        self.neutral.append(seen)

    def perform(self, seen):
        parameters = FrameParameters(torch.full((3,), seen.seconds), torch.zeros(1, 3), torch.zeros(1))
        return Performance(seen.number, seen.seconds, parameters, seen.reason)


def until(holds):
    end = time.monotonic() + SECONDS
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def stream():
    stream = Stream(Source(), Actor())
    yield stream
    stream.end()


def times(poses):
    return [pose.seconds for pose in poses]


def test_the_newest_wins(stream):
    poses = []
    stream._performer.go.clear()
    stream.start(poses.append)
    stream.source.items.put(signal(1))
    until(lambda: stream.condition().came == 1 and stream._newest is None)
    for number in (2, 3, 4):
        stream.source.items.put(signal(number))
    until(lambda: stream.condition().came == 4)
    stream._performer.go.set()
    until(lambda: len(poses) == 2)
    assert times(poses) == [1, 4]
    condition = stream.condition()
    assert (condition.came, condition.shown) == (4, 2)
    assert "2 of 4 frames came too fast and were left out" in condition.words("it")


def test_a_source_that_ends_says_so_and_holds(stream):
    poses = []
    stream.start(poses.append)
    assert stream.condition().words("it") == "Waiting for `it`."
    stream.source.items.put(signal(1))
    stream.source.items.put(None)
    until(lambda: stream.condition().ended)
    assert times(poses) == [1]
    assert stream.latest is poses[-1], "for browsers that come later"
    assert stream.condition().words("it") == "**`it` has ended**. The last pose is held."


def test_a_source_that_fails_says_why(stream, capsys):
    stream.start(lambda pose: None)
    stream.source.items.put(UserError("camera 0", expected="its next picture", found="unplugged"))
    until(lambda: stream.condition().ended)
    assert "unplugged" in stream.condition().words("it")
    assert capsys.readouterr().err == "warning: camera 0: expected its next picture, found unplugged\n"


def test_a_frame_without_a_face_is_told(stream):
    poses = []
    stream.start(poses.append)
    stream.source.items.put(signal(-1))
    until(lambda: poses)
    assert "No face: nobody; the last pose is held" in stream.condition().words("it")


def test_silence_is_told():
    quiet = Condition(came=5, shown=5, rate=20.0, delay=0.03, silence=SILENT + 3.0)
    assert quiet.words("it") == "**`it` has stopped** 4 s ago. The last pose is held."
    assert (
        quiet._replace(silence=0.1).words("it") == "`it` drives: 20 poses a second, 30 ms after their frames."
    )


def test_the_next_frame_after_the_button_knows_another_neutral(stream):
    poses = []
    stream.start(poses.append)
    stream.take_for_neutral()
    stream.source.items.put(signal(1))
    until(lambda: poses)
    assert stream._performer.neutral == [None]


def test_it_ends_while_nothing_comes():
    stream = Stream(Source(), Actor())
    stream.start(lambda pose: None)
    began = time.monotonic()
    stream.end()
    assert time.monotonic() - began < SECONDS
    assert not any(thread.is_alive() for thread in stream._threads)


def put(*items):
    source = Source()
    for item in (*items, None):
        source.items.put(item)
    return source


def test_a_recording_says_what_shows_no_face(capsys):
    frames = record(put(*map(signal, (1, -1, -1, 2, -1))), Actor(), neutral=None)
    assert times(frames) == [1, -1, -1, 2, -1]
    assert "no face in frames 1-2, 4 (the first: nobody); the pose before is held" in capsys.readouterr().err


def test_ctrl_c_ends_a_live_recording_and_nothing_else(capsys):
    frames = record(put(signal(1), KeyboardInterrupt()), Actor(), neutral=None)
    assert times(frames) == [1]
    assert "recorded until Ctrl-C" in capsys.readouterr().err
    dead = put(signal(1), KeyboardInterrupt())
    dead.live = False
    with pytest.raises(KeyboardInterrupt):
        record(dead, Actor(), neutral=None)


def test_recordings_without_a_face_are_refused():
    with pytest.raises(
        UserError, match=r"expected frames that show a face, found none in 2 \(the first: nobody"
    ):
        record(put(signal(-1), signal(-1)), Actor(), neutral=None)
    with pytest.raises(UserError, match="found none in 0"):
        record(put(), Actor(), neutral=None)


def test_a_neutral_frame_has_to_show_a_face():
    actor = Actor()
    record(put(signal(1), signal(2)), actor, neutral=1)
    assert [seen.number for seen in actor.neutral] == [1]
    with pytest.raises(UserError, match="--neutral: expected a frame from 0 to 1 that shows a face, found 1"):
        record(put(signal(1), signal(-1)), Actor(), neutral=1)


def test_frames_of_a_rate():
    frames = [Performance(number, number / 60, None) for number in range(61)]
    chosen = [frame.number for frame in sampled(frames, 25.0)]
    assert len(chosen) == 26
    assert chosen[:6] == [0, 2, 4, 7, 9, 12]
    assert [frame.number for frame in sampled(frames[::6], 20.0)][:4] == [0, 0, 6, 6]


def test_numbers_in_words():
    assert ranges([3, 4, 5, 9, 11, 12]) == "3-5, 9, 11-12"
