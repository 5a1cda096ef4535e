"""From a video to a dataset: frames, mattes, tracking, pseudo-albedo."""
