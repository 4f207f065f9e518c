"""The tables of README.md and of the site's first page of results: headline figures, and logs beside other systems."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

Rows = Mapping[str, Mapping[str, Any]]
Lines = list[list[str]]


class Log(NamedTuple):
    """A log with what others published of it: translation and rotation against the hand-checked relations."""

    title: str
    cartographer: str
    """Hess et al. 2016"""
    graph_mapping: str
    """Kümmerle et al. 2009"""
    odometry: str


LOGS = {
    "intel": Log(
        "Intel Research Lab", "0.023 ± 0.024 m, 0.45°", "0.031 ± 0.026 m, 1.3°", "7.37 ± 14.3 m, 39°"
    ),
    "fr079": Log("Freiburg 079", "0.045 ± 0.035 m, 0.54°", "0.056 ± 0.042 m", "6.50 ± 13.7 m, 30°"),
}  # fmt: skip
CIRCLE_PUBLISHED = "`ekf` 2.88 (200 runs)"
"""UKF-M's package (Brossard, Barrau and Bonnabel 2020)"""
SCENES = ("apartment", "office")


def values(rows: Rows, key: str, figure: str) -> list[float]:
    """The values of a figure over the seeds of a row."""
    return [value for value in rows[key]["values"][figure] if value is not None]


def mean(rows: Rows, key: str, figure: str, form: str = ".2f") -> str:
    """Mean ± standard error over the seeds."""
    given = np.array(values(rows, key, figure))
    if len(given) == 1:
        return f"{given[0]:{form}}"
    return f"{given.mean():{form}} ± {given.std(ddof=1) / np.sqrt(len(given)):{form}}"


def relations(rows: Rows, log: str) -> str:
    """Translation with its spread over the relations, and rotation."""
    (m,), (spread,), (deg,) = (
        values(rows, f"relations.{log}", name) for name in ("trans_m_mean", "trans_m_std", "rot_deg_mean")
    )
    return f"{m:.3f} ± {spread:.3f} m, {deg:.2f}°"


def beside_others(rows: Rows) -> Lines:
    """Each log here and as others published it."""
    heads = ["log", "here, defaults", "Cartographer", "graph mapping", "raw odometry"]
    return [heads, *([log.title, relations(rows, key), *log[1:]] for key, log in LOGS.items())]


def headline(rows: Rows) -> Lines:
    """What the package reaches, in a line each."""
    explored = [key for key in rows if key.startswith("explore.")]
    outcomes = [outcome for key in explored for outcome in rows[key]["outcomes"]]
    touched = sum(sum(values(rows, key, "collisions")) for key in explored)
    least = min(min(values(rows, key, "coverage")) for key in explored)
    done = f"{outcomes.count('explored')} of {len(outcomes)}, {touched:.0f} collisions, coverage at least {least:.3f}"
    tours = [f"tour.{scene}.ekf-invariant" for scene in SCENES]
    position = [f"{1e3 * np.mean(values(rows, tour, 'ate_m')):.1f} mm" for tour in tours]
    circle = [f"`{name}` {mean(rows, f'circle.{name}', 'nees_heading')}" for name in ("ekf", "ekf-invariant")]
    speed = [f"{values(rows, f'relations.{log}', 'times_real_time')[0]:.0f}" for log in LOGS]
    gtsam = values(rows, "victoria", "graph_error_ratio")[0]
    return [
        ["what", "here", "published"],
        *(
            [f"{log.title}, error of relations", relations(rows, key), f"Cartographer {log.cartographer}"]
            for key, log in LOGS.items()
        ),
        [f"explorations of {len(explored)} scenes", done, ""],
        ["tours of apartment and office: position error", ", ".join(position), ""],
        ["the same: pose NEES (3 is consistent)", ", ".join(mean(rows, tour, "nees") for tour in tours), ""],
        ["landmark circle: heading NEES (1 is consistent)", ", ".join(circle), CIRCLE_PUBLISHED],
        ["Victoria Park: graph error of `isam2` over GTSAM's", f"{gtsam:.4f}", ""],
        ["replay of the two logs, times real time", " and ".join(speed), ""],
    ]
