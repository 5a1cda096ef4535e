"""Running a TFLite file: pictures in, arrays out."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

import numpy as np

from samira_warp.support.errors import UserError


class Network:
    """A TFLite network with one picture as its input.

    Args:
        content: The file's bytes.
        name: Its name, for messages.
        value_range: The values that the network wants black and white to have. Scores do not tell a wrong
        one. threads: How many run it.

    Raises:
        UserError: The runtime is not installed, or does not take the file.
    """

    def __init__(
        self, content: bytes, *, name: str, value_range: tuple[float, float], threads: int = 1
    ) -> None:
        try:
            from ai_edge_litert.interpreter import Interpreter
        except ImportError as error:
            raise UserError(
                "ai-edge-litert",
                expected="the runtime of the networks (pip install 'samira-warp[track]')",
                found=error,
            ) from error
        try:
            with _quiet():
                self._interpreter = Interpreter(model_content=content, num_threads=threads)
                self._interpreter.allocate_tensors()
        except (ValueError, RuntimeError) as error:
            raise UserError(
                name, expected="a TFLite network that ai-edge-litert runs", found=error
            ) from error
        (given,) = self._interpreter.get_input_details()
        self._input = given["index"]
        self._outputs = {out["name"]: out["index"] for out in self._interpreter.get_output_details()}
        self._low, self._high = value_range
        self.size: int = int(given["shape"][1])
        """Pixels of either side of the picture that it takes."""

    def __call__(self, picture: np.ndarray) -> dict[str, np.ndarray]:
        """Run it.

        Args:
            picture: (S, S, 3) uint8 or float in 0..255, S the network's size.

        Returns:
            Its outputs by name, float32, without the batch's axis.
        """
        values = picture.astype(np.float32) * ((self._high - self._low) / 255.0) + self._low
        self._interpreter.set_tensor(self._input, values[None])
        self._interpreter.invoke()
        return {name: self._interpreter.get_tensor(index)[0] for name, index in self._outputs.items()}


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Keep the runtime from saying on standard error which of its delegates it made."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
