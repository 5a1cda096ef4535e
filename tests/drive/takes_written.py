"""Takes and datagrams as the apps write them, by what their pages say; the package has no hand in it."""

import struct

EYE = ("Blink", "LookDown", "LookIn", "LookOut", "LookUp", "Squint", "Wide")

BEFORE_JAW = [f"Eye{what}{side}" for side in ("Left", "Right") for what in EYE]
AFTER_MOUTH = [
    "MouthSmileLeft",
    "MouthSmileRight",
    "MouthFrownLeft",
    "MouthFrownRight",
    "MouthDimpleLeft",
    "MouthDimpleRight",
    "MouthStretchLeft",
    "MouthStretchRight",
    "MouthRollLower",
    "MouthRollUpper",
    "MouthShrugLower",
    "MouthShrugUpper",
    "MouthPressLeft",
    "MouthPressRight",
    "MouthLowerDownLeft",
    "MouthLowerDownRight",
    "MouthUpperUpLeft",
    "MouthUpperUpRight",
    "BrowDownLeft",
    "BrowDownRight",
    "BrowInnerUp",
    "BrowOuterUpLeft",
    "BrowOuterUpRight",
    "CheekPuff",
    "CheekSquintLeft",
    "CheekSquintRight",
    "NoseSneerLeft",
    "NoseSneerRight",
    "TongueOut",
    "HeadYaw",
    "HeadPitch",
    "HeadRoll",
    "LeftEyeYaw",
    "LeftEyePitch",
    "LeftEyeRoll",
    "RightEyeYaw",
    "RightEyePitch",
    "RightEyeRoll",
]

# the app's files have right before left in these, its datagrams Unreal's order
COLUMNS = [
    *BEFORE_JAW,
    *[
        "JawForward",
        "JawRight",
        "JawLeft",
        "JawOpen",
        "MouthClose",
        "MouthFunnel",
        "MouthPucker",
        "MouthRight",
        "MouthLeft",
    ],
    *AFTER_MOUTH,
]
SENT = [
    *BEFORE_JAW,
    *[
        "JawForward",
        "JawLeft",
        "JawRight",
        "JawOpen",
        "MouthClose",
        "MouthFunnel",
        "MouthPucker",
        "MouthLeft",
        "MouthRight",
    ],
    *AFTER_MOUTH,
]


def write_take(path, frames, *, columns=COLUMNS, rate=60):
    """A CSV file of frames, each a dict of values by column."""
    lines = [",".join(["Timecode", "BlendshapeCount", *columns])]
    for number, values in enumerate(frames):
        code = f"17:39:{41 + number // rate:02d}:{number % rate:02d}.678"
        lines.append(",".join([code, "61", *(f"{values.get(name, 0.0):.8f}" for name in columns)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def datagram(values, *, name="me", device="A1B2", frame=7):
    """What Live Link Face sends of a frame; None for one without a face."""
    parts = [b"\x06"]
    for text in (device, name):
        parts += [struct.pack(">I", len(text)), text.encode()]
    parts.append(struct.pack(">ifii", frame, 0.25, 60, 1))
    if values is not None:
        parts.append(struct.pack(">B61f", 61, *(values.get(column, 0.0) for column in SENT)))
    return b"".join(parts)
