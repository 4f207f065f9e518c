"""The table at the end of a campaign: per setting the means, their intervals, and how the runs ended."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.campaign.plan import AXES
from sixthsense.core.geometry import Array
from sixthsense.evaluation.metrics import nees_band

if TYPE_CHECKING:
    import pandas as pd

MEANS = (("ATE m", "ate_rmse_m"), ("NIS/dof", "nis_mean_per_dof"), ("coverage", "coverage"))
"""head and column of what is given as a mean with its interval"""

NEES = "pose_nees_world_mean"


def summary(frame: pd.DataFrame) -> list[list[str]]:
    """A head and a row per scene, estimator, preset and planner of a campaign's table.

    Means are over the runs that have measured it, with their 95 % interval by Student's t; the NEES, 3 when
    consistent, is beside the 95 % band of its mean over that many independent runs at one instant (`nees_band`). The
    runs' own time-means scatter less, so that a consistent estimator lies well within it.
    """
    (ate, *rest) = MEANS
    head = [*AXES, "runs", ate[0], "NEES", *(name for name, _ in rest), "outcomes"]
    rows = [head]
    for values, group in frame.groupby(list(AXES), sort=True):
        scene, *others = map(str, values)
        outcomes = ", ".join(f"{count} {outcome}" for outcome, count in group["outcome"].value_counts().items())
        cells = [mean_interval(_measured(group, column)) for _, column in MEANS]
        name = Path(scene).stem if Path(scene).suffix else scene
        nees = mean_band(_measured(group, NEES))
        rows.append([name, *others, str(len(group)), cells[0], nees, *cells[1:], outcomes])
    return rows


def mean_interval(values: Array) -> str:
    """Mean and half-width of its 95 % interval by Student's t; of one value only itself, of none nothing."""
    if len(values) < 2:
        return "".join(f"{value:.3g}" for value in values)
    from scipy.stats import t

    half = float(t.ppf(0.975, len(values) - 1)) * float(values.std(ddof=1)) / math.sqrt(len(values))
    return f"{values.mean():.3g} ± {half:.2g}"


def mean_band(values: Array) -> str:
    """Mean NEES, and whether it lies in the band of so many runs."""
    if len(values) == 0:
        return ""
    low, high = nees_band(len(values))
    mean = float(values.mean())
    return f"{mean:.3g} {'in' if low <= mean <= high else 'not in'} {low:.2f}-{high:.2f}"


def columns(rows: list[list[str]]) -> str:
    """Rows as lines with columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


def _measured(group: Any, column: str) -> Array:
    values = group[column].to_numpy(dtype=np.float64) if column in group else np.zeros(0)
    return np.asarray(values[np.isfinite(values)])
