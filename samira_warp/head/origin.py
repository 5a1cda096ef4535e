"""Where heads have their origin: in the middle of the skull, as FLAME's has it."""

import numpy as np

EYES = np.array([0.0, 0.035, 0.070])
"""Metres from the origin to the middle between the eyeballs' centres; models of others are moved there."""
