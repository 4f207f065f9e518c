"""Joint compatibility branch and bound (JCBB): the largest set of matches that agree with each other.

Neira and Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE Trans. Robotics and
Automation 17(6), 2001.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import solve_triangular

from sixthsense.core.chi_square import chi_square_quantile
from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import stacked_jacobian
from sixthsense.slam.association.matching import Indices, Innovations

_MAX_NODES = 5_000  # visited of the search tree; the best hypothesis so far is then taken

Pair = tuple[int, int]


def jointly_compatible(
    innovation: Innovations, joint: Array, gate: float, probability: float
) -> tuple[Indices, Indices]:
    """The largest set of matches inside a joint chi-square gate; among the largest, the one with the least NIS.

    `joint` (3 + 2k, 3 + 2k) of the pose and the k landmarks; each match must pass the single `gate`,
    too. Returns rows (observations) and columns (landmarks).
    """
    H = stacked_jacobian(innovation.by_pose, innovation.by_landmark)
    predicted = H @ joint @ H.T
    inside = innovation.squared < gate
    options = [np.flatnonzero(row)[np.argsort(innovation.squared[i, row])] for i, row in enumerate(inside)]
    order = sorted((i for i in range(len(options)) if len(options[i])), key=lambda i: len(options[i]))
    gates: Array = np.asarray(chi_square_quantile(probability, 2 * np.arange(1, len(order) + 1)), dtype=np.float64)
    search = _Search(innovation.values, predicted, innovation.noise, options, order, gates)
    search.descend(0, _Hypothesis())
    rows = np.array([i for i, _ in search.best.pairs], dtype=np.int64)
    cols = np.array([j for _, j in search.best.pairs], dtype=np.int64)
    return rows, cols


@dataclass(frozen=True, slots=True)
class _Hypothesis:
    """A set of matches with its joint NIS and the Cholesky factor of the innovations' covariance."""

    pairs: tuple[Pair, ...] = ()
    nis: float = 0.0
    factor: Array = field(default_factory=lambda: np.zeros((0, 0)))
    whitened: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(slots=True)
class _Search:
    values: Array
    predicted: Array
    noise: Array
    options: list[Indices]
    order: list[int]
    gates: Array
    best: _Hypothesis = field(default_factory=_Hypothesis)
    nodes: int = 0

    def descend(self, level: int, hypothesis: _Hypothesis) -> None:
        """Try every landmark for the observation at `level`, then none; branches that cannot beat the best are cut."""
        self.nodes += 1
        count, most = len(hypothesis.pairs), len(self.best.pairs)
        if count > most or (count == most and hypothesis.nis < self.best.nis):
            self.best, most = hypothesis, count
        if level == len(self.order) or self.nodes > _MAX_NODES:
            return
        left = len(self.order) - level
        i, taken = self.order[level], {j for _, j in hypothesis.pairs}
        for j in self.options[i].tolist():
            if j in taken:
                continue
            grown = self._with(hypothesis, i, j)
            if grown.nis <= self.gates[count] and self._may_win(count + left, grown.nis):
                self.descend(level + 1, grown)
        if self._may_win(count + left - 1, hypothesis.nis):
            self.descend(level + 1, hypothesis)

    def _may_win(self, at_most: int, nis: float) -> bool:
        most = len(self.best.pairs)
        return at_most > most or (at_most == most and nis < self.best.nis)

    def _with(self, hypothesis: _Hypothesis, i: int, j: int) -> _Hypothesis:
        """The hypothesis with one more match: its Cholesky factor is extended by two rows."""
        index = np.array([(2 * k, 2 * k + 1) for _, k in hypothesis.pairs], dtype=np.int64).ravel()
        mine = slice(2 * j, 2 * j + 2)
        n = len(index)
        cross = solve_triangular(hypothesis.factor, self.predicted[index, mine], lower=True) if n else np.zeros((0, 2))
        corner = np.linalg.cholesky(self.predicted[mine, mine] + self.noise[i, j] - cross.T @ cross)
        own = solve_triangular(corner, self.values[i, j] - cross.T @ hypothesis.whitened, lower=True)
        factor = np.zeros((n + 2, n + 2))
        factor[:n, :n], factor[n:, :n], factor[n:, n:] = hypothesis.factor, cross.T, corner
        whitened = np.concatenate([hypothesis.whitened, own])
        return _Hypothesis((*hypothesis.pairs, (i, j)), hypothesis.nis + float(own @ own), factor, whitened)
