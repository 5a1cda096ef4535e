"""Any head model that is read: by its file or its folder."""

from __future__ import annotations

from pathlib import Path

from samira_warp.head.flame import read_flame
from samira_warp.head.gnm import is_gnm, read_gnm
from samira_warp.head.ict import is_ict, read_ict
from samira_warp.head.template import HeadTemplate, read_template
from samira_warp.io.npz import names_of
from samira_warp.support.errors import UserError

KNOWN = "a template.npz, FLAME's file, GNM's gnm_head.npz or ICT-FaceKit's folder"


def read_head(path: str | Path) -> HeadTemplate:
    """Read a head model of any kind.

    A template of this project (`read_template`), FLAME with what is beside it (`read_flame`), GNM Head
    (`read_gnm`), or the folder of ICT-FaceKit's light model (`read_ict`).

    Raises:
        UserError: It is none of them, or as in those.
    """
    path = Path(path)
    if path.is_dir():
        if is_ict(path):
            return read_ict(path)
        raise UserError(path, expected=KNOWN, found="another folder")
    if path.suffix.lower() != ".npz":
        return read_flame(path)
    if not path.is_file():
        raise UserError(path, expected=KNOWN, found="no such file")
    names = names_of(path)
    if "n_shape" in names:
        return read_template(path)
    return read_gnm(path) if is_gnm(names) else read_flame(path)


def missing_landmarks(template: HeadTemplate, path: str | Path) -> str | None:
    """What to say of a head that pictures cannot be fitted with; None where it has its landmarks."""
    if template.landmarks is not None:
        return None
    return (
        f"{path}: the head does not say where the face mesh's landmarks lie on it; place them by "
        f"'python tools/place_landmarks.py --head {path} --out template.npz' and give it that file"
    )
