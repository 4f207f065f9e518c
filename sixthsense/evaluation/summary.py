"""A table of many runs: means with confidence intervals and outcomes of each group."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.evaluation.effective import EFFECTIVE, band_of_runs, effective_samples

if TYPE_CHECKING:
    import pandas as pd

MEANS = (("ATE m", "ate_rmse_m"), ("NIS/dof", "nis_mean_per_dof"), ("coverage", "coverage"))
"""heading and column of each metric that is shown as a mean with its interval"""

NEES = "pose_nees_world_mean"


def summary(frame: pd.DataFrame, by: Sequence[str], nees: Sequence[Array | None] = ()) -> list[list[str]]:
    """Summarise a table of runs: a heading, and a row per combination of the values in the columns `by`.

    Means are over the runs that have the metric, with the 95 % interval of Student's t. The mean NEES, 3 for a
    consistent estimator, is followed by the 95 % band of such a mean (`band_of_runs`). `nees` has the NEES along each
    run in the order of the frame, None where it is not known; where that is missing, each run counts as a sample.
    """
    (ate, *rest) = MEANS
    rows = [[*by, "runs", ate[0], "NEES", *(name for name, _ in rest), "outcomes"]]
    numbered = frame.assign(row=range(len(frame)))
    for values, group in numbered.groupby(list(by), sort=True):
        outcomes = ", ".join(f"{count} {outcome}" for outcome, count in group["outcome"].value_counts().items())
        cells = [mean_interval(_measured(group, column)) for _, column in MEANS]
        names = [Path(value).stem if name == "scene" else str(value) for name, value in zip(by, values, strict=True)]
        consistency = mean_band(_measured(group, NEES), _effective(group, nees))
        rows.append([*names, str(len(group)), cells[0], consistency, *cells[1:], outcomes])
    return rows


def mean_interval(values: Array) -> str:
    """Mean and half-width of its 95 % interval (Student's t); a single value alone, and an empty text for none."""
    if len(values) < 2:
        return "".join(f"{value:.3g}" for value in values)
    from scipy.stats import t

    half = float(t.ppf(0.975, len(values) - 1)) * float(values.std(ddof=1)) / math.sqrt(len(values))
    return f"{values.mean():.3g} ± {half:.2g}"


def mean_band(values: Array, samples: float = 0.0) -> str:
    """Mean NEES of runs, and whether it lies in the 95 % band for their effective number of samples."""
    if len(values) == 0:
        return ""
    low, high = band_of_runs(samples, len(values))
    mean = float(values.mean())
    return f"{mean:.3g} {'in' if low <= mean <= high else 'not in'} {low:.2f}-{high:.2f}"


def _effective(group: Any, nees: Sequence[Array | None]) -> float:
    """Effective number of samples of a group's runs: pooled, and not more than each run has; 0 if it is not known."""
    if not nees or NEES not in group or EFFECTIVE not in group:
        return 0.0
    measured = group[group[NEES].notna()]
    known = [one[np.isfinite(one)] for k in measured["row"] if (one := nees[k]) is not None]
    own = _measured(measured, EFFECTIVE)
    complete = len(known) == len(own) == len(measured)
    return min(effective_samples(known), float(own.sum())) if complete else 0.0


def _measured(group: Any, column: str) -> Array:
    values = group[column].to_numpy(dtype=np.float64) if column in group else np.zeros(0)
    return np.asarray(values[np.isfinite(values)])
