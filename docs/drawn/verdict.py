"""verdict.png: the share of keyframes that are off, over the probability that they were told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from sixthsense.figures import new_axes, plot
from sixthsense.figures.plot import ESTIMATE

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results.json"


def main() -> None:
    values = json.loads(RESULTS.read_text())["rows"]["reliability"]["values"]
    told, share, error = (
        np.array([values[f"{name}_{k}"][0] for k in range(5) if f"p_{k}" in values]) for name in ("p", "share", "error")
    )
    figure, (ax,) = new_axes(1, 1, 6.0, 5.0)
    ax.plot([0.0, 1.0], [0.0, 1.0], color="0.6", label="calibrated")
    ax.errorbar(told, share, 2.0 * error, color=ESTIMATE, marker="o", capsize=3.0, label="keyframes, 2 standard errors")
    ax.set(xlabel="probability told", ylabel="share of keyframes off", xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    ax.legend(loc="upper left", frameon=False)
    plot.save(figure, "verdict.png")


if __name__ == "__main__":
    main()
