"""Other sets of matches than the likeliest one-to-one assignment, and which of them explains the scan best.

Faces of a wall that lie a few centimetres beside each other match each other after a shift by one face, and these wrong
matches agree among themselves. Which of both sets the assignment finds depends on the error of the predicted pose. So
it is compared with sets that begin with a rival, a pair that the gate allows as well (Neira and Tardos, "Data
association in stochastic mapping using the joint compatibility test", IEEE Trans. Robotics and Automation 17(6), 2001,
search all of them).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.association.agreement import agreed, blocks, squared_given
from sixthsense.slam.association.matching import Indices, Innovations, assign, assigned, block_diagonal

_MOST = 8
"""rivals that are tried, those that fit best"""


def best_agreed(innovation: Innovations, predicted: Array, gate: float) -> tuple[Indices, Indices, Array]:
    """The set of matches that explains the scan best, and the squared innovations (m, k) of the others given them.

    `predicted` as of `predicted_cov`. A set explains what its joint squared innovation leaves of `gate` per match: an
    observation without a match counts as one that just passes the gate. As in the assignment, a match with a landmark
    that is less certain than another one in the gate explains less by as much.
    """
    best = agreed(innovation, predicted, *assign(innovation, gate), gate)
    inside = innovation.squared < gate
    lacking = _lacking(innovation.log_det, inside)
    most = _explained(innovation, predicted, lacking, best, gate)
    possible = np.count_nonzero(inside.any(axis=1))
    if most >= (gate - 2.0) * possible:  # all are matched, with no more than the mean of a chi-square
        return best
    tried = np.zeros(inside.shape, dtype=np.bool_)
    tried[best[0], best[1]] = True
    rivals = np.argwhere(inside & ~tried)
    nearest = np.argsort(innovation.squared[tuple(rivals.T)], kind="stable")[:_MOST]
    for i, j in rivals[nearest].tolist():
        if tried[i, j]:
            continue
        given = squared_given(innovation, predicted, np.array([i]), np.array([j]))
        given[i], given[:, j] = np.inf, np.inf
        given[i, j] = 0.0
        found = agreed(innovation, predicted, *assigned(given, innovation.log_det, gate), gate)
        tried[found[0], found[1]] = True
        explained = _explained(innovation, predicted, lacking, found, gate)
        if explained > most:
            best, most = found, explained
    return best


def _lacking(log_det: Array, inside: NDArray[np.bool_]) -> Array:
    """(m, k) logarithm of the density of the densest match in the gate over each match's; 0 where none is denser."""
    densest = np.where(inside, log_det, np.inf).min(axis=1, initial=np.inf)
    # Matches that follow from others may lie outside the gate, also of an observation that has none inside.
    return np.asarray(np.maximum(log_det - densest[:, None], 0.0))


def _explained(
    innovation: Innovations,
    predicted: Array,
    lacking: Array,
    matches: tuple[Indices, Indices, Array],
    gate: float,
) -> float:
    """How much less than `gate` per match the joint squared innovation is, less what density the matches lack.

    `lacking` (m, k) as of `_lacking`.
    """
    rows, cols, _ = matches
    index = blocks(cols)
    S = predicted[np.ix_(index, index)] + block_diagonal(innovation.noise[rows, cols])
    stacked = innovation.values[rows, cols].ravel()
    return gate * len(rows) - float(stacked @ np.linalg.solve(S, stacked)) - float(lacking[rows, cols].sum())
