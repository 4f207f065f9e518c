import numpy as np
import pytest

from sixthsense.slam.estimators.triangle import selected


def lower(matrix: np.ndarray) -> np.ndarray:
    return np.asfortranarray(np.where(np.tri(len(matrix), dtype=bool), matrix, np.nan))


def symmetric(n: int) -> np.ndarray:
    half = np.random.default_rng(n).standard_normal((n, n))
    return half + half.T


@pytest.mark.parametrize("index", [[], [0], [2, 3, 7], list(range(9))])
def test_selected_rows_and_columns_are_those_of_the_whole_matrix(index: list[int]) -> None:
    full, places = symmetric(9), np.array(index, dtype=np.int64)
    found = selected(lower(full).T, places).T
    assert found.flags.f_contiguous
    assert np.array_equal(np.tril(found), np.tril(full[np.ix_(places, places)]))
