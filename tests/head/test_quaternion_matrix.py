import numpy as np
import torch
from scipy.spatial.transform import Rotation

from samira_warp.geometry.rotation import quaternion_to_matrix


def test_unit_quaternions_are_the_matrices_that_scipy_makes_of_them(generator):
    quaternions = torch.nn.functional.normalize(
        torch.randn(4, 50, 4, generator=generator, dtype=torch.float64), dim=2
    )
    expected = Rotation.from_quat(quaternions.roll(-1, dims=2).reshape(-1, 4).numpy()).as_matrix()
    # sums of products of at most 1, in float64
    found = quaternion_to_matrix(quaternions).reshape(-1, 3, 3).numpy()
    np.testing.assert_allclose(found, expected, atol=1e-14)
