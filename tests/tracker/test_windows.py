"""Long films in windows."""

import pytest
import torch

from samira_warp.tracker import windows as module
from samira_warp.tracker.unknowns import Layout, Unknowns
from samira_warp.tracker.windows import in_windows, windows

LAYOUT = Layout(joints=1, moving=(0,), expressions=1, identities=1, functions=0)


@pytest.mark.parametrize("frames", [1, 30, 750, 751, 1469, 1470, 1471, 5000])
def test_every_frame_is_kept_once_and_solved_with_its_neighbours(frames):
    parts = windows(frames)
    kept = [number for _, keep in parts for number in range(keep.start, keep.stop)]
    assert kept == list(range(frames))
    for solved, keep in parts:
        assert solved.stop - solved.start <= module.WINDOW
        assert keep.start == 0 or keep.start - solved.start == module.OVERLAP // 2
        assert keep.stop == frames or solved.stop - keep.stop == module.OVERLAP // 2


def test_what_is_found_goes_where_it_belongs(monkeypatch):
    monkeypatch.setattr(module, "WINDOW", 10)
    monkeypatch.setattr(module, "OVERLAP", 4)
    start = Unknowns.at_rest(LAYOUT, frames=25, focal=500.0)
    sizes = []

    def fit(rows, unknowns):
        sizes.append(len(unknowns.frames))
        numbers = torch.arange(rows.start, rows.stop, dtype=torch.float64)
        return unknowns.moved(
            numbers[:, None].expand_as(unknowns.frames) - unknowns.frames, 0 * unknowns.subject
        )

    found = in_windows(start, fit)
    assert found.frames[:, 0].tolist() == list(range(25))
    assert max(sizes) == 10
