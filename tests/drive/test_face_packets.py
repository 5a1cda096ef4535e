"""Datagrams of phones, as their pages describe and print them."""

import contextlib
import math

import numpy as np
import pytest
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder
from scipy.spatial.transform import Rotation
from takes_written import datagram

from samira_warp.drive.arkit import NUMBER_OF
from samira_warp.drive.live_link_packet import is_live_link, read_live_link
from samira_warp.drive.osc_packet import FACE_CAP_ORDER, OscFace, is_osc
from samira_warp.drive.text_packet import is_text, read_text

PRINTED = (
    "mouthSmile_R-0|eyeLookOut_L-0|eyeLookDown_L-17|jawOpen-12|browInnerUp-20|eyeLookIn_R-6|"
    "=head#-21.488958,-6.038993,-6.6019735,-0.030653415,-0.10287084,-0.6584072|"
    "rightEye#6.0297494,2.4403017,0.25649446|leftEye#6.034903,-1.6660284,-0.17520553|"
)
"""Part of the frame that iFacialMocap's page prints."""


def test_live_link_face():
    packet = datagram({"JawLeft": 0.5, "MouthRight": 0.25, "HeadYaw": 0.3, "RightEyePitch": -0.2})
    assert is_live_link(packet)
    assert not is_osc(packet)
    assert not is_text(packet)
    face = read_live_link(packet, 12.5)
    assert face.seconds == 12.5
    assert face.shapes[NUMBER_OF["jawLeft"]] == 0.5
    assert face.shapes[NUMBER_OF["mouthRight"]] == 0.25
    np.testing.assert_allclose(face.head, [0, 0.3, 0], atol=1e-7)
    np.testing.assert_allclose(face.eyes[1], [0.2, 0, 0], atol=1e-7)
    assert read_live_link(datagram(None), 0.0) is None


@pytest.mark.parametrize("length", range(1, 276, 7))
def test_a_datagram_that_ends_early_is_refused(length):
    whole, header = datagram({}), len(datagram(None))
    if length != header:
        with pytest.raises(ValueError, match="it ends"):
            read_live_link(whole[:length], 0.0)


def test_other_counts_and_values_are_refused():
    header = datagram(None)
    with pytest.raises(ValueError, match="52 values"):
        read_live_link(header + bytes([52]) + bytes(208), 0.0)
    with pytest.raises(ValueError, match="no number"):
        read_live_link(datagram({"JawOpen": math.nan}), 0.0)
    with pytest.raises(ValueError, match="its id has"):
        read_live_link(b"\x06\xff\xff\xff\xff", 0.0)


@pytest.mark.parametrize("marks", ["-", "&"])
def test_ifacialmocap(marks):
    text = (
        PRINTED
        if marks == "-"
        else "|".join(part if "#" in part else part.replace("-", "&") for part in PRINTED.split("|"))
    )
    assert is_text(text.encode())
    face = read_text(text.encode(), 1.0)
    assert face.shapes[NUMBER_OF["jawOpen"]] == 0.12
    assert face.shapes[NUMBER_OF["browInnerUp"]] == 0.2
    down, left, _ = np.degrees(face.eyes).T
    # what the shapes of the same frame say: both look down, the right eye in, to the left
    assert (down > 5).all()
    assert left[1] > 2
    turn = Rotation.from_rotvec(face.head).as_euler("YXZ", degrees=True)
    np.testing.assert_allclose(turn, [-6.038993, -21.488958, -6.6019735], atol=1e-5)


@pytest.mark.parametrize("text", ["a-b|c#1", "jawOpen-x|", "jawOpen-1|=head#1,2|", "mood-3|angle#1,2,3|"])
def test_text_that_is_no_face(text):
    with pytest.raises(ValueError):
        read_text(text.encode(), 0.0)


def osc(address, *values):
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value)
    return builder.build()


def bundle(*messages):
    builder = OscBundleBuilder(IMMEDIATELY)
    for message in messages:
        builder.add_content(message)
    return builder.build().dgram


def test_face_cap():
    assert sorted(FACE_CAP_ORDER) == sorted(NUMBER_OF)
    face = OscFace()
    assert is_osc(osc("/W", 24, 0.5).dgram)
    seen = face.read(osc("/W", 24, 0.5).dgram, 3.0)
    assert seen.shapes[NUMBER_OF["jawOpen"]] == 0.5
    seen = face.read(bundle(osc("/HR", 10.0, 0.0, 0.0), osc("/ELR", 0.0, 5.0), osc("/ERR", 0.0, 5.0)), 4.0)
    assert seen.shapes[NUMBER_OF["jawOpen"]] == 0.5, "what was said before stays"
    np.testing.assert_allclose(np.degrees(seen.head), [10, 0, 0], atol=1e-6)
    np.testing.assert_allclose(np.degrees(seen.eyes), [[0, 5, 0]] * 2, atol=1e-6)
    assert face.read(osc("/HT", 1.0, 2.0, 3.0).dgram, 5.0) is None


def test_vmc():
    face = OscFace()
    assert face.read(osc("/VMC/Ext/Blend/Val", "JawOpen", 0.5).dgram, 0.0) is None, "not applied yet"
    # in Unity's axes y is up and x to the figure's right: a positive turn about y is to its right
    half = math.radians(20.0) / 2
    bone = osc("/VMC/Ext/Bone/Pos", "Head", 0.0, 1.4, 0.0, 0.0, math.sin(half), 0.0, math.cos(half))
    seen = face.read(bundle(osc("/VMC/Ext/Blend/Apply"), bone), 1.0)
    assert seen.shapes[NUMBER_OF["jawOpen"]] == 0.5
    np.testing.assert_allclose(np.degrees(seen.head), [0, -20, 0], atol=1e-4)
    nod = osc("/VMC/Ext/Bone/Pos", "Neck", 0.0, 1.4, 0.0, math.sin(half), 0.0, 0.0, math.cos(half))
    seen = face.read(bundle(nod, osc("/VMC/Ext/Bone/Pos", "Head", *[0.0] * 6, 1.0)), 2.0)
    np.testing.assert_allclose(np.degrees(seen.head), [20, 0, 0], atol=1e-4)  # down


@pytest.mark.parametrize(
    "packet",
    [
        b"/W\0\0,ii",
        b"#bundle\0",
        osc("/W", 99, 1.0).dgram,
        osc("/W", "jaw", 1.0).dgram,
        osc("/HR", 1.0).dgram,
        osc("/VMC/Ext/Bone/Pos", "Head", *[0.0] * 7).dgram,
    ],
)
def test_osc_that_is_no_face(packet):
    with contextlib.suppress(ValueError):
        assert OscFace().read(packet, 0.0) is None
