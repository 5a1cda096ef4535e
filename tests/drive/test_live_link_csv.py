"""Recordings of Live Link Face: what is read of them, and what is said of those that lack something."""

import numpy as np
import pytest
from takes_written import COLUMNS, write_take

from samira_warp.drive.arkit import NUMBER_OF
from samira_warp.drive.live_link_csv import read_recording
from samira_warp.support.errors import UserError


def refusal(path):
    with pytest.raises(UserError) as fault:
        read_recording(path)
    return str(fault.value)


def test_a_take_is_read_by_its_names(tmp_path, capsys):
    frames = [{"JawOpen": 0.25, "MouthLeft": 0.5, "HeadYaw": 0.3}, {"LeftEyePitch": 0.1}]
    take = read_recording(write_take(tmp_path / "take.csv", frames))
    assert capsys.readouterr().err == ""
    first, second = take.frames
    assert first.shapes[NUMBER_OF["jawOpen"]] == 0.25
    assert first.shapes[NUMBER_OF["mouthLeft"]] == 0.5
    assert np.count_nonzero(first.shapes) == 2
    np.testing.assert_allclose(first.head, [0.0, 0.3, 0.0])  # yaw turns left
    np.testing.assert_allclose(second.eyes, [[-0.1, 0.0, 0.0], [0.0, 0.0, 0.0]], atol=1e-12)  # pitch looks up
    assert second.seconds == pytest.approx(1 / 60)


def test_timecodes_count_frames_of_the_rate_that_the_file_shows(tmp_path):
    take = read_recording(write_take(tmp_path / "take.csv", [{}] * 75, rate=30))
    assert take.frames[-1].seconds == pytest.approx(74 / 30)


def test_rows_without_a_face_are_left_out(tmp_path):
    path = write_take(tmp_path / "take.csv", [{}, {"JawOpen": 1.0}, {}])
    lines = path.read_text().splitlines()
    lines[2] = "17:39:41:01.678,0"
    path.write_text("\n".join(lines))
    take = read_recording(path)
    assert (take.rows, take.numbers) == (3, (0, 2))


def test_missing_and_unknown_columns_are_named(tmp_path, capsys):
    columns = [name for name in COLUMNS if name not in ("JawOpen", "HeadRoll")]
    take = read_recording(write_take(tmp_path / "take.csv", [{"mood": 3.0}], columns=[*columns, "mood"]))
    said = capsys.readouterr().err
    assert "left out: mood" in said
    assert "taken as 0: jawOpen, HeadRoll" in said
    assert take.frames[0].shapes[NUMBER_OF["jawOpen"]] == 0.0


def test_without_angles_nothing_is_said_of_head_and_eyes(tmp_path, capsys):
    take = read_recording(write_take(tmp_path / "take.csv", [{"EyeLookUpLeft": 1.0}], columns=COLUMNS[:52]))
    assert take.frames[0].head is take.frames[0].eyes is None
    assert take.frames[0].gaze[0, 0] < -0.5, "by the shapes the left eye looks up"
    assert "HeadYaw" in capsys.readouterr().err


def test_numbers_in_place_of_timecodes(tmp_path, capsys):
    path = write_take(tmp_path / "take.csv", [{}, {}])
    path.write_text(path.read_text().replace("17:39:41:", "frame "))
    assert read_recording(path).frames[1].seconds == pytest.approx(1 / 60)
    assert "no timecodes that rise" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "found an empty file"),
        ("\n\n", "found an empty file"),
        ("Timecode,BlendshapeCount,JawOpen\n", "found a header alone"),
        ("time,value\n0,1\n", "expected columns of ARKit's shapes, such as eyeBlinkLeft, eyeLookDownLeft"),
        ("JawOpen,jawOpen\n0,1\n", "found two of jawOpen"),
        ("BlendshapeCount,JawOpen\n61,0\n61,wide\n", "row 2, jawOpen: expected a number, found 'wide'"),
        ("BlendshapeCount,JawOpen\n61,nan\n", "row 1, jawOpen: expected a number, found 'nan'"),
        ("BlendshapeCount,JawOpen,JawLeft\n61,1\n", "row 1, jawLeft: expected a number, found nothing"),
        ("BlendshapeCount,JawOpen\n0,0\n0,0\n", "expected rows with a face in them, found none among 2"),
    ],
)
def test_what_cannot_be_read(tmp_path, text, complaint):
    path = tmp_path / "take.csv"
    path.write_text(text)
    said = refusal(path)
    assert said.startswith(str(path))
    assert complaint in said


def test_no_file_and_no_text(tmp_path):
    assert "found no such file" in refusal(tmp_path / "none.csv")
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00\x01")
    assert "expected a table of text" in refusal(tmp_path / "bytes.csv")
