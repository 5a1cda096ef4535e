import math

import torch

from samira_warp.nets.fourier import fourier_channels, fourier_features


def test_features_are_the_input_then_sines_then_cosines_band_by_band(device, generator):
    bands = 4
    values = (2.0 * torch.rand(2, 3, 5, 7, generator=generator, dtype=torch.float64) - 1.0).to(device)
    features = fourier_features(values, bands=bands)
    assert features.shape == (2, fourier_channels(3, bands=bands), 5, 7)
    expected = [values[:, d] for d in range(3)]
    for function in (torch.sin, torch.cos):
        expected += [function(math.pi * 2**k * values[:, d]) for k in range(bands) for d in range(3)]
    # sin and cos of arguments up to 8 pi, equal but for the rounding of pi 2^k x
    torch.testing.assert_close(features, torch.stack(expected, dim=1), atol=1e-14, rtol=0)


def test_no_bands_keep_the_input(generator):
    values = torch.rand(1, 3, 4, 4, generator=generator)
    assert torch.equal(fourier_features(values, bands=0), values)
