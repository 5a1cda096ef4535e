"""What is typed for a source, and sources that are ports, cameras and films."""

import socket
import threading

import numpy as np
import pytest
from pythonosc.osc_message_builder import OscMessageBuilder
from takes_written import datagram, write_take

from samira_warp.drive import cameras, open_source
from samira_warp.drive.arkit import NUMBER_OF
from samira_warp.support.errors import UserError


def refusal(text):
    with pytest.raises(UserError) as fault:
        open_source(text)
    return str(fault.value)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("nothing.mp4", "found no such file: nothing.mp4"),
        ("tcp://here:1", "expected a film, a camera (its number or device), a Live Link Face .csv, or udp"),
        ("udp://here", "expected udp://HOST:PORT, such as udp://0.0.0.0:11111, found 'udp://here'"),
        ("udp://here:70000", "expected udp://HOST:PORT"),
        ("udp:11111", "expected udp://HOST:PORT"),
        ("udp://0.0.0.0:11111/path", "expected udp://HOST:PORT"),
    ],
)
def test_what_is_no_source(text, complaint):
    said = refusal(text)
    assert said.startswith("--drive: ")
    assert complaint in said


def test_a_camera_that_is_not_there():
    said = refusal("/dev/video987")
    assert said.startswith("--drive: expected a camera that is there, found /dev/video987: ")


def test_a_port_in_use():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        text = f"udp://127.0.0.1:{taken.getsockname()[1]}"
        assert refusal(text).startswith(f"{text}: expected a port that is free here, found ")


def test_a_text_file_is_no_film(tmp_path):
    (tmp_path / "film.mp4").write_text("once upon a time")
    assert "expected a video" in refusal(str(tmp_path / "film.mp4"))


def test_a_take(tmp_path):
    source = open_source(str(write_take(tmp_path / "take.CSV", [{"JawOpen": 0.5}] * 3)))
    assert (source.live, source.pictures) == (False, False)
    assert len(list(source.frames())) == 3


@pytest.fixture
def port():
    source = open_source("udp://127.0.0.1:0")
    yield source
    source.end()


def send(port, *packets):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as phone:
        for packet in packets:
            phone.sendto(packet, ("127.0.0.1", port.port))


def test_all_apps_at_one_port(port, capsys):
    message = OscMessageBuilder("/W")
    message.add_arg(24)
    message.add_arg(0.75)
    send(
        port,
        datagram({"JawOpen": 0.25}),
        datagram(None),
        b"hello",
        b"again",
        b"jawOpen-50|=head#0,0,0,0,0,0|",
        message.build().dgram,
    )
    jaw = [frame.shapes[NUMBER_OF["jawOpen"]] for frame in port.frames(patience=0.5)]
    assert jaw == [0.25, 0.5, 0.75]
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"warning: {port.name}: a datagram is left out: it begins with b'hello'")


def test_a_port_that_is_silent_ends_when_it_is_told(port):
    got = []
    thread = threading.Thread(target=lambda: got.extend(port.frames()))
    thread.start()
    port.end()
    thread.join(5.0)
    assert not thread.is_alive()
    assert got == []


def test_a_camera_gives_what_its_device_does(film, monkeypatch):
    """A film stands in for the device."""
    opened = []

    def stand_in(kind, device):
        opened.append((kind, device))
        return cameras.av.open(str(film))

    monkeypatch.setattr(cameras, "_opened", stand_in)
    source = open_source("0")
    assert (source.live, source.pictures, source.name) == (True, True, "camera 0")
    shots = list(source.frames())
    assert opened == [("v4l2", "/dev/video0")]
    assert shots[0].picture.shape == (290, 600, 3)
    assert shots[0].picture.dtype == np.uint8
    assert [shot.seconds for shot in shots] == sorted(shot.seconds for shot in shots)
