"""Maps from conditions decay, and nothing else of the network does."""

import torch
from subjects import small_avatar

from samira_warp.nets import MotionSettings
from samira_warp.train.condition_decay import CONDITION_DECAY, decay_conditions


def test_weights_of_conditions_shrink_with_the_rate_and_all_else_stays():
    for hidden in (0, 8):  # an affine map, and an older avatar's perceptron
        settings = MotionSettings(
            width=8, region_width=4, condition_width=hidden, bands=3, displacement_bands=1
        )
        motion = small_avatar(motion=settings).motion
        for parameter in motion.parameters():
            torch.nn.init.normal_(parameter)
        before = {name: value.clone() for name, value in motion.state_dict().items()}
        decay_conditions(motion, rate=1e-3, frames=2)
        shrunk = {name for name, value in motion.state_dict().items() if not torch.equal(value, before[name])}
        assert shrunk
        assert shrunk == {name for name in before if name.startswith("adain.") and name.endswith("weight")}
        for name in shrunk:
            kept = (1.0 - CONDITION_DECAY * 1e-3) ** 2
            torch.testing.assert_close(motion.state_dict()[name], kept * before[name])
