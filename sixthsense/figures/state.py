"""Figures of a filter's state: covariance ellipses, innovations with their gates, and correlations."""

from __future__ import annotations

from typing import Any

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.evaluation.metrics import landmark_covariances
from sixthsense.figures.plot import CHI2_95, ESTIMATE, OBSERVATION, ellipse, label_plane
from sixthsense.slam.estimators import Estimator


def draw_state(
    ax: Any, estimator: Estimator, color: str = ESTIMATE, label: str | None = None, enlarged: float = 1.0
) -> None:
    """Draw the 95 % ellipses of the position (filled) and of all point landmarks, `enlarged` by a factor."""
    from matplotlib.collections import PolyCollection

    estimate = estimator.estimate()
    means = estimate.landmarks[~estimate.walls]
    covs = landmark_covariances(estimator.joint_covariance(estimate.ids[~estimate.walls].tolist()))
    outlines = [ellipse(mean, enlarged**2 * cov) for mean, cov in zip(means, covs, strict=True)]
    own = ellipse(estimate.pose.position, enlarged**2 * estimate.pose_cov[:2, :2])
    ax.fill(own[:, 0], own[:, 1], color=color, alpha=0.25, linewidth=0.0, zorder=9)
    ax.plot(own[:, 0], own[:, 1], color=color, linewidth=1.2, zorder=9.5, label=label)
    ax.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=color, linewidths=1.2, zorder=6))
    ax.scatter(means[:, 0], means[:, 1], s=5.0, color=color, linewidths=0.0, zorder=6)
    label_plane(ax)


def draw_innovations(ax: Any, pose: Pose, z: Array, predicted: Array, covs: Array, gate: float = CHI2_95) -> None:
    """Draw predicted observations with the gates of their innovations, and the actual observations.

    `z` (m, 2) and `predicted` (k, 2) in the robot's frame at `pose`; `covs` (k, 2, 2); a gate is the ellipse at the
    squared Mahalanobis distance `gate`.
    """
    for k, (mean, cov) in enumerate(zip(predicted, covs, strict=True)):
        outline = pose @ ellipse(mean, gate / CHI2_95 * cov)
        ax.plot(*outline.T, color=ESTIMATE, linewidth=1.1, zorder=5, label="gate" if k == 0 else None)
    ax.scatter(*(pose @ predicted).T, s=12.0, color=ESTIMATE, zorder=5, label="predicted observation")
    style: dict[str, Any] = {"facecolors": "none", "edgecolors": OBSERVATION, "linewidths": 1.8}
    ax.scatter(*(pose @ z).T, s=60.0, zorder=6, label="observation", **style)
    label_plane(ax)


def draw_correlation(ax: Any, cov: Array, title: str = "") -> None:
    """Draw the correlations of a joint covariance (3 + 2k, 3 + 2k): the pose's three rows first, then the landmarks."""
    from matplotlib import colormaps

    sigma = np.sqrt(np.maximum(np.diag(cov), 1e-300))
    colors = colormaps["RdBu_r"].resampled(15)
    image = ax.imshow(cov / np.outer(sigma, sigma), cmap=colors, vmin=-1.0, vmax=1.0, interpolation="nearest")
    ax.figure.colorbar(image, ax=ax, shrink=0.8, label="correlation [1]")
    for lines in (ax.axhline, ax.axvline):
        lines(2.5, color="black", linewidth=0.6)
    ax.set_xticks([1.0, 0.5 * (len(cov) + 2.0)], ["pose", "landmarks"])
    ax.set_yticks([1.0, 0.5 * (len(cov) + 2.0)], ["pose", "landmarks"])
    ax.set_title(title)
