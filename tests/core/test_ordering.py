"""Sorting within kernels against NumPy."""

import numpy as np
import pytest

from sixthsense.core.ordering import ascending


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 64, 65, 1000])
@pytest.mark.parametrize("kind", [int, float])
def test_the_order_of_values_is_that_of_a_stable_sort(count, kind):
    values = np.random.default_rng(count).integers(0, max(count // 3, 2), count).astype(kind)
    assert np.array_equal(ascending(values), np.argsort(values, kind="stable"))
