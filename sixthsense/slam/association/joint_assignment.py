"""The set of matches that explains a scan best.

A match is worth what its squared innovation, given the matches before it, leaves of the gate, less a penalty. The sum
over a set does not depend on the order: it is the gate per match less the joint squared innovation and the penalties.
An observation without a match counts as one that just passes the gate. So a set of matches that contradict each other
is worth less than the largest part of it that agrees, and of two sets that agree among themselves the one that explains
more is taken. Neira and Tardos, "Data association in stochastic mapping using the joint compatibility test", IEEE
Trans. Robotics and Automation 17(6), 2001, search all sets for the largest; here a beam of the best ones is kept.

Several pieces of one wall may be matched with it.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

BEAM = 12
"""sets of matches that are kept from one observation to the next"""


class Pairs(NamedTuple):
    """Innovations of m observations against k landmarks."""

    values: Array
    """(m, k, 2)"""
    noise: Array
    """(m, k, 2, 2) covariances of the observations about the predictions"""
    predicted: Array
    """(2k, 2k) covariance of the predictions of all landmarks"""


class _Matches(NamedTuple):
    """Matches in several sets, each with what it adds to the Cholesky factor of the innovations of its set."""

    landmark: Indices
    """(n,)"""
    rows: Array
    """(n, 2, 2s) of the factor"""
    whitened: Array
    """(n, 2) innovation"""


@numba.njit(cache=True, error_model="numpy")
def best_matches(pairs: Pairs, may_match: Mask, penalty: Array, walls: Mask, gate: float) -> Indices:
    """(m,) landmark of each observation in the best set of matches; -1: none.

    `may_match` and `penalty`, at least 0, are (m, k); `walls` (k,) marks the landmarks that may have several matches.
    Observations with few options come first.
    """
    m, k = may_match.shape
    options = np.array([may_match[i].sum() for i in range(m)])
    steps = int(np.count_nonzero(options))
    chains, lengths, worths = np.empty((BEAM, steps), np.int64), np.zeros(BEAM, np.int64), np.zeros(BEAM)
    matches = _empty(BEAM * steps, 2 * steps)
    observation = np.empty(BEAM * steps, np.int64)
    new_worths, changes = np.empty(BEAM * (1 + k)), np.empty((BEAM * (1 + k), 2), np.int64)
    row, own = np.empty((2, 2 * steps)), np.empty(2)
    sets, count = 1, 0
    for _ in range(steps):
        i, found = 0, 0
        for n in range(m):
            if options[n] > 0 and not 0 < options[i] <= options[n]:
                i = n
        options[i] = 0  # it has had its turn
        for h in range(sets):
            chain = chains[h, : lengths[h]]
            new_worths[found], changes[found, 0], changes[found, 1] = worths[h], h, -1
            found += 1
            for j in range(k):
                if may_match[i, j] and (walls[j] or not _is_taken(j, matches.landmark, chain)):
                    worth = gate - _extend(pairs, i, j, matches, chain, row, own) - penalty[i, j]
                    if worth > 0.0:
                        new_worths[found], changes[found, 0], changes[found, 1] = worths[h] + worth, h, j
                        found += 1
        left, old_chains, old_lengths, sets = new_worths[:found], chains.copy(), lengths.copy(), min(found, BEAM)
        for place in range(sets):
            best = np.argmax(left)
            worths[place], left[best] = left[best], -np.inf
            h, j = changes[best]
            n = old_lengths[h]
            for q in range(n):
                chains[place, q] = old_chains[h, q]
            lengths[place] = n
            if j >= 0:
                _extend(pairs, i, j, matches, chains[place, :n], row, own)
                _keep(matches, count, j, n, row, own)
                observation[count], chains[place, n], lengths[place] = i, count, n + 1
                count += 1
    out = np.full(m, -1)
    for match in chains[0, : lengths[0]]:
        out[observation[match]] = matches.landmark[match]
    return out


@numba.njit(cache=True, error_model="numpy")
def squared_given(pairs: Pairs, asked: Mask, matched: Indices) -> Array:
    """(m, k) squared innovations of the pairs `asked`, given the matches of (m,); infinite for the others.

    Those of the matches themselves mean nothing.
    """
    m, k = asked.shape
    most = int(np.sum(matched >= 0))
    matches, chain = _empty(most, 2 * most), np.arange(most)
    row, own = np.empty((2, 2 * most + 2)), np.empty(2)
    n = 0
    for i in range(m):
        if matched[i] >= 0:
            _extend(pairs, i, matched[i], matches, chain[:n], row, own)
            _keep(matches, n, matched[i], n, row, own)
            n += 1
    out = np.full((m, k), np.inf)
    for i in range(m):
        for j in range(k):
            if asked[i, j]:
                out[i, j] = _extend(pairs, i, j, matches, chain, row, own)
    return out


@numba.njit(cache=True, error_model="numpy")
def _empty(count: int, columns: int) -> _Matches:
    return _Matches(np.empty(count, np.int64), np.empty((count, 2, columns)), np.empty((count, 2)))


@numba.njit(cache=True, error_model="numpy")
def _keep(matches: _Matches, place: int, j: int, n: int, row: Array, own: Array) -> None:
    """Keep a match with landmark `j` that follows `n` others."""
    matches.landmark[place] = j
    for a in range(2):
        for b in range(2 * n + 2):
            matches.rows[place, a, b] = row[a, b]
        matches.whitened[place, a] = own[a]


@numba.njit(cache=True, error_model="numpy")
def _is_taken(j: int, landmarks: Indices, chain: Indices) -> bool:
    taken = False
    for match in chain:
        taken |= landmarks[match] == j
    return taken


@numba.njit(cache=True, error_model="numpy")
def _extend(pairs: Pairs, i: int, j: int, matches: _Matches, chain: Indices, row: Array, own: Array) -> float:
    """Squared innovation of observation `i` of landmark `j`, given the matches in `chain` (n,).

    Fills `row` (2, at least 2n + 2) with its rows of the Cholesky factor and `own` (2,) with its whitened innovation.
    """
    n = len(chain)
    predicted, noise = pairs.predicted, pairs.noise[i, j]
    y0, y1 = pairs.values[i, j, 0], pairs.values[i, j, 1]
    s00 = predicted[2 * j, 2 * j] + noise[0, 0]
    s10 = predicted[2 * j + 1, 2 * j] + noise[1, 0]
    s11 = predicted[2 * j + 1, 2 * j + 1] + noise[1, 1]
    for place in range(n):
        match = chain[place]
        other, factor = 2 * matches.landmark[match], matches.rows[match]
        for a in range(2):
            column = 2 * place + a
            v0, v1 = predicted[2 * j, other + a], predicted[2 * j + 1, other + a]
            for b in range(column):
                v0 -= row[0, b] * factor[a, b]
                v1 -= row[1, b] * factor[a, b]
            v0 /= factor[a, column]
            v1 /= factor[a, column]
            row[0, column], row[1, column] = v0, v1
            y0 -= v0 * matches.whitened[match, a]
            y1 -= v1 * matches.whitened[match, a]
            s00 -= v0 * v0
            s10 -= v0 * v1
            s11 -= v1 * v1
    row[0, 2 * n], row[0, 2 * n + 1] = np.sqrt(s00), 0.0
    row[1, 2 * n] = s10 / row[0, 2 * n]
    row[1, 2 * n + 1] = np.sqrt(s11 - row[1, 2 * n] ** 2)
    own[0] = y0 / row[0, 2 * n]
    own[1] = (y1 - row[1, 2 * n] * own[0]) / row[1, 2 * n + 1]
    return float(own[0] * own[0] + own[1] * own[1])
