"""The tabs of the panel, each for one kind of choice."""
