"""The tab of a training that is under way: how far it is, and its curves."""

from __future__ import annotations

import numpy as np
import viser
from viser import uplot

from samira_warp.view.following import Progress

CURVES = ("psnr", "loss", "gaussians")
"""What is drawn of metrics.jsonl; `samira_warp.train.log` writes it."""

COLOUR = "#4dabf7"


class TrainingTab:
    """Curves that grow."""

    def __init__(self, gui: viser.GuiApi, progress: Progress) -> None:
        self._step = gui.add_markdown(progress.words())
        self._plots = {
            name: gui.add_uplot(
                progress.curve(name),
                (uplot.Series(label="step"), uplot.Series(label=name, stroke=COLOUR, width=2)),
                scales={"x": uplot.Scale(time=False), "y": uplot.Scale(auto=True)},
                title=name,
                height=170,
            )
            for name in CURVES
        }

    def show(self, progress: Progress) -> None:
        """Show how far the training is by now."""
        self._step.content = progress.words()
        for name, plot in self._plots.items():
            plot.data = tuple(np.asarray(values) for values in progress.curve(name))
