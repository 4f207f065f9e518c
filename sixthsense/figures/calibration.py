"""Figure and file of a calibration: errors of observations of each kind, and errors of odometry (report figure 1)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import Kind
from sixthsense.evaluation.calibrate import Calibration, Errors, as_partial_config, summary
from sixthsense.evaluation.consistency import whitened_errors
from sixthsense.figures.plot import ESTIMATE, LANDMARK, ODOMETRY, TRUTH, ellipse, new_figure, save
from sixthsense.record.writing import whole


def draw_observation_errors(ax: Any, errors: Array, name: str) -> None:
    """Draw errors (N, 2) of observations, metres, robot frame, with the 95 % ellipse of their zero-mean Gaussian."""
    shown = 1e3 * errors
    ax.scatter(shown[:, 0], shown[:, 1], s=9, color=LANDMARK, linewidths=0.0, zorder=3, label="samples")
    if len(shown):
        outline = _draw_ellipse(ax, shown.T @ shown / len(shown))
        mean = shown.mean(axis=0)
        ax.plot(*mean, marker="+", color=TRUTH, markersize=9, linestyle="none", zorder=4, label="sample mean")
        _frame(ax, max(float(np.abs(outline).max()), float(np.percentile(np.abs(shown), 99.5))))
    title = f"{name}, {len(errors)} observations"
    ax.set(xlabel="forward error [mm]", ylabel="lateral error [mm]", title=title)


def draw_propagation_errors(ax: Any, before: Errors, after: Errors) -> None:
    """Draw the whitened errors of forward motion and heading before and after calibration."""
    _draw_ellipse(ax, np.eye(2))
    reach = 4.0
    for errors, color, marker, when in ((before, ODOMETRY, "x", "before"), (after, ESTIMATE, "o", "after")):
        shown, label = whitened_errors(errors.errors, errors.covs)[:, [0, 2]], f"{when}: NEES {errors.mean_nees:.2f}"
        ax.scatter(*shown.T, s=12, color=color, marker=marker, linewidths=0.8, zorder=3, label=label)
        reach = max(reach, float(np.abs(shown).max()))
    _frame(ax, reach)
    ax.set_title(f"odometry, {len(after.errors)} samples")
    ax.set(xlabel="forward error [assumed sigmas]", ylabel="heading error [assumed sigmas]")


def _draw_ellipse(ax: Any, cov: Array) -> Array:
    """Draw the 95 % ellipse of a zero-mean Gaussian with a covariance (2, 2); returns its outline."""
    outline = ellipse(np.zeros(2), cov)
    ax.fill(outline[:, 0], outline[:, 1], color=ESTIMATE, alpha=0.15, linewidth=0.0)
    ax.plot(outline[:, 0], outline[:, 1], color=ESTIMATE, linewidth=1.4, label="95 % ellipse, mean 0")
    return outline


def _frame(ax: Any, reach: float) -> None:
    """Show a square around zero."""
    limits = -1.05 * reach, 1.05 * reach
    ax.set(xlim=limits, ylim=limits, aspect="equal")
    ax.locator_params(nbins=7)


def save_calibration(found: Calibration, file: Path | str, title: str) -> None:
    """Write the figure of a calibration as a PNG (report figure 1)."""
    figure = new_figure(11.0, 4.6)
    corners, ends, propagation = figure.subplots(1, 3)
    draw_observation_errors(corners, found.landmarks[1].of(Kind.CORNER), "corners")
    draw_observation_errors(ends, found.landmarks[1].of(Kind.END), "wall ends")
    draw_propagation_errors(propagation, *found.propagation)
    for ax in (corners, ends, propagation):
        ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, frameon=False, fontsize="small")
    figure.suptitle(title)
    save(figure, file)


def write_calibration(found: Calibration, config: Config, file: Path, title: str) -> None:
    """Write the partial configuration, and the figure as a PNG of the same name; each file is replaced atomically."""
    import tomli_w

    head = [title, *summary(found)]
    text = "".join(f"# {line}\n" for line in head) + "\n" + tomli_w.dumps(as_partial_config(found, config))
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole(file) as written, whole(file.with_suffix(".png")) as drawn:
        save_calibration(found, drawn, title)
        written.write_text(text, encoding="utf-8")
