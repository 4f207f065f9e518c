"""Whether the matches of a scan agree with each other, and what the others say of one observation.

All is read off the covariance of all innovations together: the squared innovation of a match given all others follows
from the inverse of that matrix, and so does the innovation of an unmatched observation given the matches.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sixthsense.core.geometry import Array
from sixthsense.slam.association.matching import Indices, Innovations, block_diagonal


def agreed(
    innovation: Innovations, predicted: Array, rows: Indices, cols: Indices, gate: float
) -> tuple[Indices, Indices, Array]:
    """The matches that agree with each other, those that follow from them, and the squared innovations given them.

    Arguments as of `agreeing`. An observation that was not matched, or lost its match, is matched with the landmark
    without a match that it fits best inside the gate, given all matches.
    """
    rows, cols = agreeing(innovation, predicted, rows, cols, gate)
    squared = squared_given(innovation, predicted, rows, cols)
    open_pairs = squared.copy()
    open_pairs[rows], open_pairs[:, cols] = np.inf, np.inf
    while open_pairs.size and open_pairs.min() <= gate:
        i, j = np.unravel_index(int(open_pairs.argmin()), open_pairs.shape)
        rows, cols = np.append(rows, i), np.append(cols, j)
        open_pairs[i], open_pairs[:, j] = np.inf, np.inf
    return rows, cols, squared


def predicted_cov(innovation: Innovations, joint: Array) -> Array:
    """(2k, 2k) covariance of the predicted observations of k landmarks, from the joint one of pose and landmarks."""
    by_pose = innovation.by_pose.reshape(-1, 3)
    turned = block_diagonal(innovation.by_landmark)
    cross = by_pose @ joint[:3, 3:] @ turned.T
    return np.asarray(by_pose @ joint[:3, :3] @ by_pose.T + cross + cross.T + turned @ joint[3:, 3:] @ turned.T)


def agreeing(
    innovation: Innovations, predicted: Array, rows: Indices, cols: Indices, gate: float
) -> tuple[Indices, Indices]:
    """The matches that agree with all others: without the one that these contradict most, again and again.

    `predicted` as of `predicted_cov`; `rows` and `cols` of the matches. The squared innovation of a match given all
    others, which has 2 degrees of freedom, is y^T P^-1 y with its block P of the inverse of the innovations' covariance
    S and its part y of S^-1 times the innovations.
    """
    while len(rows):
        index = blocks(cols)
        inverse = np.linalg.inv(predicted[np.ix_(index, index)] + block_diagonal(innovation.noise[rows, cols]))
        whitened = (inverse @ innovation.values[rows, cols].ravel()).reshape(-1, 2)
        own = inverse.reshape(len(rows), 2, len(rows), 2)[np.arange(len(rows)), :, np.arange(len(rows)), :]
        squared = np.einsum("mi,mi->m", whitened, np.linalg.solve(own, whitened[:, :, None])[:, :, 0])
        worst = int(squared.argmax())
        if squared[worst] <= gate:
            break
        rows, cols = np.delete(rows, worst), np.delete(cols, worst)
    return rows, cols


def squared_given(innovation: Innovations, predicted: Array, rows: Indices, cols: Indices) -> Array:
    """(m, k) squared innovations of all observations against all landmarks, given the matches.

    Infinite where the pair is not plausible. Arguments as of `agreeing`. Those of the matches themselves mean nothing.
    """
    k = len(innovation.by_pose)
    shift, cov = np.zeros(2 * k), predicted
    if len(rows):
        index = blocks(cols)
        root = cho_factor(predicted[np.ix_(index, index)] + block_diagonal(innovation.noise[rows, cols]))
        shift = predicted[:, index] @ cho_solve(root, innovation.values[rows, cols].ravel())
        cov = predicted - predicted[:, index] @ cho_solve(root, predicted[index])
    own = cov.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k), :]
    S = own[None] + innovation.noise
    off = innovation.values - shift.reshape(-1, 2)[None]
    squared = np.einsum("mki,mki->mk", off, np.linalg.solve(S, off[..., None])[..., 0])
    return np.where(np.isfinite(innovation.squared), squared, np.inf)


def blocks(cols: Indices) -> Indices:
    """(2n,) places of the landmarks `cols` (n,) in the vector of predicted observations."""
    return np.asarray((2 * cols[:, None] + np.arange(2)).ravel())
