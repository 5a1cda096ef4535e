"""The README's Python example, run as it is printed."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO

README = Path(__file__).parents[1] / "README.md"


def python_blocks() -> list[str]:
    return re.findall(
        r"^```python\n(.*?)^```", README.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )


def write_hdr(path: Path) -> None:
    pixels = np.linspace(0.1, 2.0, 16 * 32 * 3, dtype=np.float32).reshape(16, 32, 3)
    assert OpenImageIO.ImageBuf(pixels).write(str(path))


def test_the_example_writes_its_picture(tiny_run, tmp_path):
    shutil.copytree(tiny_run, tmp_path / "runs" / "built_in")
    write_hdr(tmp_path / "studio.hdr")
    (example,) = python_blocks()
    done = subprocess.run(
        [sys.executable, "-c", example], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "relit.png").is_file()
    assert done.stdout.startswith("torch.Size([")
