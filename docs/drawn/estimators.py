"""estimators.png: the landmark circle, where the three estimators differ."""

from __future__ import annotations

import numpy as np

from sixthsense.evaluation.metrics import nees_band
from sixthsense.figures import new_axes, plot
from sixthsense.figures.overtime import style_of
from sixthsense.slam.estimators import ESTIMATORS
from sixthsense.testing.circle import STEP_S, follow, simulate

RUNS, STEPS = 5, 1500
WINDOW = 60
"""steps over which the NEES is averaged; a step alone scatters"""


def main() -> None:
    evidence = [simulate(0, run, STEPS) for run in range(RUNS)]
    time_s = STEP_S * np.arange(1, STEPS + 1)
    figure, (left, right) = new_axes(1, 2, 13.0, 5.2)
    right.axhspan(*nees_band(RUNS, 1), color="0.92", label=f"95 % band of a step, {RUNS} runs")
    window = np.ones(WINDOW) / WINDOW
    for k, name in enumerate(ESTIMATORS):
        tracks = [follow(name, one) for one in evidence]
        style = style_of(k) | {"label": name}
        left.plot(time_s, np.sqrt(np.mean([track.position_m**2 for track in tracks], axis=0)), **style)
        mean = np.mean([track.nees_heading for track in tracks], axis=0)
        right.plot(time_s[WINDOW - 1 :], np.convolve(mean, window, "valid"), **style)
    left.set(xlabel="time [s]", ylabel=f"position error, RMS of {RUNS} runs [m]", ylim=(0.0, None))
    right.set(xlabel="time [s]", ylabel=f"NEES of the heading, mean over {WINDOW * STEP_S:.0f} s [1]", ylim=(0.0, None))
    left.legend(frameon=False)
    right.legend(frameon=False)
    plot.save(figure, "estimators.png")


if __name__ == "__main__":
    main()
