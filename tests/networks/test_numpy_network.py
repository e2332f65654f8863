"""What the small network computes without torch and SciPy."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.networks.numpy_network import _gelu


@pytest.mark.parametrize(("kind", "rtol"), [(np.float32, 1e-6), (np.float64, 1e-12)])
def test_gelu_is_that_of_scipy(kind, rtol):
    from scipy.special import ndtr

    values = np.random.default_rng(0).normal(scale=4, size=(300, 40)).astype(kind)
    values[0, :3] = 0, 40, -40
    found = _gelu(values)
    assert found.dtype == kind and found.shape == values.shape
    np.testing.assert_allclose(found, values * ndtr(values), rtol=rtol, atol=1e-30)
    np.testing.assert_array_equal(_gelu(values[::2, ::3]), found[::2, ::3])  # in other strides
