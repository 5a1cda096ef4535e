"""metrics.jsonl in a run folder: what a training has logged, one JSON object a line, oldest first."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

METRICS_FILE = "metrics.jsonl"
"""Each line has ``step`` and ``seconds``, the means of the loss's terms since the line before, their sum
``loss``, and ``psnr``, of the training frames; where a preview was made, also ``test_psnr``."""


def read_metrics(run: Path) -> tuple[dict[str, Any], ...]:
    """The lines that a run has written so far, none where it has written none.

    A line that is being written is left for the next time.

    Raises:
        OSError: The file cannot be read.
    """
    path = run / METRICS_FILE
    texts = path.read_text(encoding="utf-8").split("\n")[:-1] if path.is_file() else []
    lines = []
    for text in texts:
        try:
            line = json.loads(text)
        except ValueError:
            continue
        if isinstance(line, dict) and isinstance(line.get("step"), int):
            lines.append(line)
    return tuple(lines)
