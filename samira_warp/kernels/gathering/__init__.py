"""Sums over lists: gathers whose adjoints are gathers, so that no sum depends on the order of threads."""
