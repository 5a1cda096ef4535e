"""Sessions and their turns: what is made when, for whom, and what is left out."""

import io
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
import pytest
import torch
from PIL import Image

from samira_warp.geometry.camera import Camera
from samira_warp.stage.viewpoint import HeadPlace
from samira_warp.support.errors import UserError
from samira_warp.view.jobs import snapshot, turned_by, turntable
from samira_warp.view.look import Look
from samira_warp.view.session import Session
from samira_warp.view.sizes import LEAST, MOST, MovingSize, fit
from samira_warp.view.state import Light, Pose, State
from samira_warp.view.turns import Turns

START = State(Look((0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 0.0), 20.0))


class Frames(NamedTuple):
    frames: tuple = (0,) * 10


class Shown(NamedTuple):
    poser: Frames = Frames()


class Theatre:
    """Stands in for a scene: a picture says which state it is of."""

    def __init__(self):
        self.shown, self.made, self.slow = Shown(), [], threading.Event()
        self.slow.set()

    def picture(self, state, sides, *, width, height, detail="full"):
        assert self.slow.wait(10)
        if state.light.name == "broken":
            raise UserError("broken.hdr", expected="a map", found="none")
        if state.light.name == "faulty":
            raise RuntimeError("a fault")
        self.made.append((state, width, height, detail))
        return np.full((height, width, 3), state.pose.frame, np.uint8)

    def splats(self, state, stages, *, detail="full"):
        self.made.append((state, detail))
        return len(self.made)

    def place(self, state):
        return HeadPlace(torch.zeros(3), torch.eye(3))


class Screen:
    def __init__(self):
        self.shown, self.said, self.files, self.frames, self.rested = [], [], {}, [], []

    def show(self, picture, *, quality):
        self.shown.append((picture, quality))

    def show_splats(self, splats, *, background):
        self.shown.append((splats, background))

    def hide_splats(self):
        self.shown.append("hidden")

    def say(self, title, text):
        self.said.append(text)

    def at_frame(self, number):
        self.frames.append(number)

    def settled(self, state, *, height):
        self.rested.append((state, height))

    def download(self, name, content):
        self.files[name] = content


def begin(theatre=None, wake=lambda: None):
    session = Session(theatre or Theatre(), START, Screen(), longest=1024, wake=wake)
    session.see(START.look, width=1600, height=800)
    return session


def settle(session, seconds=10.0):
    """Serve a session until nothing is due."""
    end = time.monotonic() + seconds
    while (due := session.due()) != float("inf"):
        assert time.monotonic() < end
        time.sleep(max(due - time.monotonic(), 0.0))
        session.work()


def test_a_picture_is_quick_first_and_fine_when_it_rests():
    session = begin()
    settle(session)
    (_, wide, high, detail), (_, wider, higher, finer) = session.scene.made
    assert (wide, high, detail) == (MOST, MOST // 2, "quick")
    assert (wider, higher, finer) == (1024, 512, "rest")
    assert [quality for _, quality in session.screen.shown] == [80, 92]
    assert session.screen.rested == [(session.state, 800)]
    session.change(lambda state: state)
    assert session.due() == float("inf")


def test_splats_are_sent_when_they_change_and_not_while_the_camera_moves():
    session = begin()
    settle(session)
    session.screen.shown.clear()
    session.scene.made.clear()
    session.change(lambda state: replace(state, splats=True, background="black"))
    settle(session)
    assert [detail for _, detail in session.scene.made] == ["quick", "rest"]
    assert session.screen.shown == [(1, "black"), (2, "black")]
    # the camera alone: nothing until it rests, then highlights where it sees them
    look = START.look._replace(fov=30.0)
    session.see(look, width=1600, height=800)
    session.work()
    assert len(session.screen.shown) == 2
    settle(session)
    assert session.scene.made[2:] == [(replace(session.state, look=look), "rest")]
    session.change(lambda state: replace(state, light=replace(state.light, rotate=5.0)))
    settle(session)
    assert [detail for _, detail in session.scene.made[3:]] == ["quick", "rest"]
    # another avatar in the same state
    session.refresh()
    settle(session)
    assert len(session.scene.made) == 7
    # pictures again: the first is there before the splats are gone
    session.screen.shown.clear()
    session.change(lambda state: replace(state, splats=False))
    settle(session)
    picture, hidden, finer = session.screen.shown
    assert (picture[1], hidden, finer[1]) == (80, "hidden", 92)


def test_choices_that_were_overtaken_are_not_shown():
    session = begin()
    for frame in range(1, 8):
        session.change(lambda state, frame=frame: replace(state, pose=Pose(frame)))
    settle(session)
    assert {state.pose.frame for state, *_ in session.scene.made} == {7}


def test_a_sequence_plays_by_the_clock_and_stops():
    session = begin()
    session.play(200.0)  # faster than pictures are asked for below: frames are left out
    end = time.monotonic() + 0.3
    while time.monotonic() < end:
        session.work()
        time.sleep(0.02)
    session.play(0.0)
    settle(session)
    frames = session.screen.frames
    assert len(set(frames)) > 2
    assert all(0 <= frame < 10 for frame in frames)
    assert session.screen.rested[-1][0].pose.frame == frames[-1]


def test_a_mistake_and_a_fault_are_said_and_not_tried_again(capsys):
    session = begin()
    for name, said in (
        ("broken", "broken.hdr: expected a map, found none"),
        ("faulty", "RuntimeError: a fault"),
    ):
        session.change(lambda state, name=name: replace(state, light=Light(name)))
        settle(session)
        assert session.screen.said[-1] == said
    assert "a fault" in capsys.readouterr().err
    session.change(lambda state: replace(state, light=Light()))
    settle(session)
    assert session.screen.rested[-1][0].light == Light()


def test_sessions_take_turns_and_the_gone_are_not_served():
    theatre, turns = Theatre(), Turns()
    one, other = begin(theatre, turns.wake), begin(theatre, turns.wake)
    other.change(lambda state: replace(state, pose=Pose(5)))
    theatre.slow.clear()
    turns.join(one)
    turns.join(other)
    turns.start()
    try:
        theatre.slow.set()
        end = time.monotonic() + 10
        while not (one.screen.rested and other.screen.rested):
            assert time.monotonic() < end
            time.sleep(0.01)
        assert {int(picture[0, 0, 0]) for picture, _ in one.screen.shown} == {0}
        assert {int(picture[0, 0, 0]) for picture, _ in other.screen.shown} == {5}
        turns.leave(other)
        turns.leave(other)
        count = len(other.screen.shown)
        other.change(lambda state: replace(state, pose=Pose(6)))
        done = threading.Event()
        turns.between(done.set)
        assert done.wait(10)
        assert len(other.screen.shown) == count
        assert turns.sessions() == [one]
    finally:
        turns.end()


def test_a_snapshot_is_a_file_of_twice_the_size():
    session = begin()
    session.begin(snapshot(session))
    settle(session)
    image = Image.open(io.BytesIO(session.screen.files["snapshot.png"]))
    assert image.size == (3200, 1600)
    assert [size for _, *size, detail in session.scene.made if detail == "full"] == [[3200, 1600]]


@pytest.mark.parametrize("turning", ["camera", "light"])
def test_a_film_is_one_turn(turning, tmp_path):
    session = begin()
    session.begin(turntable(session, turning=turning, seconds=1.0))
    settle(session)
    path = tmp_path / "film.mp4"
    path.write_bytes(session.screen.files["turntable.mp4"])
    with av.open(str(path)) as film:
        assert sum(1 for _ in film.decode(video=0)) == 25
        assert (film.streams.video[0].width, film.streams.video[0].height) == (720, 360)
    assert not Path("turntable.mp4").exists()


def test_a_turned_camera_keeps_its_distance_and_what_it_looks_at():
    place = HeadPlace(torch.tensor([0.1, 0.2, 0.0]), torch.eye(3))
    for degrees in (0.0, 90.0, 200.0):
        turned = turned_by(START, degrees, turning="camera", place=place).look.camera(64, 64)
        start = START.look.camera(64, 64)
        # the head's middle is seen where it was: one rounding of float32 at a metre
        torch.testing.assert_close(
            turned.image_points(place.center), start.image_points(place.center), rtol=1e-5, atol=1e-4
        )
    quarter = turned_by(START, 90.0, turning="camera", place=place).look.position
    assert quarter == pytest.approx((1.1, 0.0, 0.1))
    assert turned_by(START, 30.0, turning="light", place=place).light.rotate == 30.0


def test_the_moving_size_follows_the_time_and_stays_within_bounds():
    size = MovingSize()
    for _ in range(30):
        size.took(1.0)
    assert size.side == LEAST
    for _ in range(30):
        size.took(0.001)
    assert size.side == MOST
    for _ in range(40):  # a machine on which the time is that of the area, 512 in four times what is wanted
        size.took(4.0 / 15.0 * (size.side / 512) ** 2)
    assert size.side in (LEAST, LEAST + 32)


@pytest.mark.parametrize(
    ("window", "longer", "wanted"),
    [
        ((1600, 800), 1024, (1024, 512)),
        ((300, 200), 512, (300, 200)),
        ((1, 1), 256, (1, 1)),
        ((3, 3000), 256, (1, 256)),
    ],
)
def test_a_picture_fits_its_window(window, longer, wanted):
    assert fit(*window, longer=longer) == wanted


def test_a_look_is_read_from_any_camera():
    camera = Camera(torch.eye(4), 50.0, 50.0, 10.0, 30.0, width=40, height=60)
    look = Look.of(camera)
    assert look.position == pytest.approx((0, 0, 0))
    assert look.camera(40, 60).cx == 20.0
