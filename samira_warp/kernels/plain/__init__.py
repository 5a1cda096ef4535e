"""Plain Warp kernels, one thread a pixel: what the fast ones are compared with and timed against.

Nothing renders with them.
"""
