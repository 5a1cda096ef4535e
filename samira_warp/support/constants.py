"""Numbers that more than one file relies on, each with its reason."""

ALPHA_MIN = 1.0 / 255.0
"""A Gaussian's alpha below this changes no 8-bit pixel: the pair is skipped, and the tile test is exact for
it (3DGS)."""

ALPHA_MAX = 0.99
"""Alpha is capped here so that 1 / (1 - alpha) in the adjoint of blending stays bounded (3DGS)."""

TRANSMITTANCE_MIN = 1e-4
"""A pixel stops blending before its transmittance would fall below this: what lies behind is invisible
(3DGS)."""

LOW_PASS = 0.1
"""Pixels squared added to the diagonal of the projected covariance: about the variance of a pixel's square,
1/12, over which a picture is a mean (Mip-Splatting)."""

SMOOTHING = 0.2
"""Variance of the smoothing of every Gaussian in space, in squared distances of neighbouring pixels of the
finest training picture: no detail of the model is finer than what training saw (Mip-Splatting)."""

NEAR_PLANE = 0.01
"""Metres; closer centres are culled: the Jacobian of the projection diverges at the camera."""

COVERED_ALPHA = 1.0 / 255.0
"""Below this coverage a pixel has no surface to shade, and its G-buffer means nothing."""

ROUGHNESS_MIN = 0.08
"""GGX at lower roughness is narrower than a texel of the 64-wide specular base."""

DEGENERATE_TRIANGLE = 1e-5
"""A triangle lower than this share of its sides has no normal: float32 leaves its direction good to about one
per cent."""

TRAINING_SIZES = {"cpu": 256, "paper": 512}
"""Pixels of the longer side of training images, by preset of train: check says which pictures are smaller."""
