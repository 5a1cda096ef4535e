"""The learned parts: image encoder, conditioning layers and the semantic-adaptive motion network."""

from samira_warp.nets.conditioning import AdaptiveInstanceNorm, Conditions, ConditionStatistics
from samira_warp.nets.encoder import encode_reference
from samira_warp.nets.fourier import fourier_features
from samira_warp.nets.modulation import RegionModulators
from samira_warp.nets.motion import MotionNetwork, MotionSettings

__all__ = [
    "AdaptiveInstanceNorm",
    "ConditionStatistics",
    "Conditions",
    "MotionNetwork",
    "MotionSettings",
    "RegionModulators",
    "encode_reference",
    "fourier_features",
]
