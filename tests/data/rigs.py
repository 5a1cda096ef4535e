"""Heads of other joints than FLAME's."""

import numpy as np

SEVEN = ("base", "neck", "head", "jaw", "left_eye", "right_eye", "tongue")
"""FLAME's joints, a head between neck and face, and a tongue; the root has a name of its own."""

SEVEN_PARENTS = (-1, 0, 1, 2, 2, 2, 3)

OTHERS = ("head", "tongue")
"""Those of them that FLAME does not have."""


def with_seven_joints(arrays):
    """A template of FLAME's joints with two more: the upper half of what the neck moves goes with the head,
    some of what the jaw moves with the tongue."""
    root, neck, jaw, left, right = (arrays["weights"][:, joint] for joint in range(5))
    high = arrays["v_template"][:, 1] > 0
    inner = arrays["v_template"][:, 0] > 0
    weights = [root, neck * ~high, neck * high, jaw * ~inner, left, right, jaw * inner]
    rows = arrays["J_regressor"][[0, 1, 2, 2, 3, 4, 2]].copy()
    rows[2] = high / high.sum()
    count = len(arrays["v_template"])
    noise = np.random.default_rng(0).normal(size=(count, 3, 9 * 6))
    return arrays | {
        "weights": np.stack(weights, axis=1),
        "J_regressor": rows.astype(np.float32),
        "posedirs": (1e-4 * noise).astype(np.float32),
        "kintree_table": np.array([SEVEN_PARENTS, range(7)]),
        "joint_names": np.array(SEVEN),
    }


def without_a_jaw(arrays):
    """A template of FLAME's joints but the jaw, whose part goes with the neck."""
    weights = arrays["weights"][:, [0, 1, 3, 4]].copy()
    weights[:, 1] += arrays["weights"][:, 2]
    return arrays | {
        "weights": weights,
        "J_regressor": arrays["J_regressor"][[0, 1, 3, 4]],
        "posedirs": arrays["posedirs"][:, :, :27],
        "kintree_table": np.array([(-1, 0, 1, 1), range(4)]),
        "joint_names": np.array(("root", "neck", "left_eye", "right_eye")),
    }
