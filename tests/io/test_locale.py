"""Names that the locale has no characters for."""

import os
import subprocess
import sys

import numpy as np
import pytest

from samira_warp.io.images import read_image, write_png
from samira_warp.support.errors import UserError

USE = """
import os, sys
from pathlib import Path
import numpy as np
from samira_warp.io.images import image_size, read_image, text_line, write_exr, write_png
from samira_warp.light import Environment
from samira_warp.support.errors import UserError

folder = Path(sys.argv[1])
assert sys.getfilesystemencoding() == "ascii", sys.getfilesystemencoding()
write_png(folder / "a.png", np.full((4, 8, 3), 0.2))
write_exr(folder / "a.exr", np.ones((4, 8, 3)))
assert image_size(folder / "a.png") == (8, 4)
assert np.allclose(read_image(folder / "a.png", channels=3), 0.2)
assert np.allclose(read_image(folder / "a.exr", channels=1), 1.0)
assert Environment.load(folder / "a.exr", size=16).specular.mean() > 0.99
assert text_line(folder.name, width=200, height=20).min() < 0.5
try:
    read_image(folder / "gone.png", channels=3)
except UserError as error:
    print(error, file=sys.stderr)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have names in Unicode")
def test_pictures_of_any_name_are_read_and_written_in_the_c_locale(tmp_path):
    folder = tmp_path / "Zoë и кот"
    folder.mkdir()
    settings = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [sys.executable, "-c", USE, str(folder)], capture_output=True, env={**os.environ, **settings}
    )
    assert done.returncode == 0, done.stderr.decode()
    assert sorted(path.name for path in folder.iterdir()) == ["a.exr", "a.png"]
    assert b"gone.png: expected an image file, found no such file" in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have names in Unicode")
def test_a_name_that_is_no_utf_8_is_refused(tmp_path):
    path = tmp_path / os.fsdecode(b"caf\xe9.png")
    with pytest.raises(OSError, match=r"cannot be written: expected a file's name in UTF-8"):
        write_png(path, np.zeros((2, 2, 3)))
    path.write_bytes(b"anything")
    with pytest.raises(UserError, match="expected a file's name in UTF-8"):
        read_image(path, channels=3)
