"""apparent_corner.png: where the end of a thin and of a thick wall is found, in units of its sigma."""

from __future__ import annotations

import numpy as np

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.figures import new_axes, plot
from sixthsense.slam.features import extract

END = np.array([4.0, 0.6])
THICK_M = 0.25
PLACE = Pose(0.0, 1.35)
SCANS, RANGE_SIGMA_M = 2000, 0.005


def errors(thick_m: float, rng: np.random.Generator) -> Array:
    """(n,) how far beyond its end a wall is found to end, in sigmas, where it is found; one that is so thick."""
    config = preset()
    walls = np.array([[(4.0, -5.0), END], [END, END + np.array([thick_m, 0.0])], [(9.0, -8.0), (9.0, 8.0)]])
    bearings, found = beam_bearings(config.laser), []
    for theta in rng.uniform(-np.pi, np.pi, SCANS):
        pose = Pose(PLACE.x, PLACE.y, float(theta))
        ranges = cast_rays(pose, bearings, walls, config.laser.max_range)
        scan = Scan.from_config(ranges + rng.normal(0.0, RANGE_SIGMA_M, len(ranges)), config.laser)
        for seen in extract(scan, config.assumed, config.features, rng).observations:
            off = pose @ seen.z - END
            if not seen.is_wall and np.hypot(*off) < 0.2:
                turn = np.array([np.sin(pose.theta), np.cos(pose.theta)])  # the world's y axis in the robot's frame
                found.append(off[1] / np.sqrt(turn @ seen.cov @ turn))
    return np.array(found)


def main() -> None:
    rng = np.random.default_rng(0)
    figure, (left, right) = new_axes(1, 2, 12.0, 4.6)
    left.fill([4.0, 4.0, 4.0 + THICK_M, 4.0 + THICK_M], [-0.6, 0.6, 0.6, -0.6], color="0.8")
    left.plot([4.0, 4.0], [-0.6, 0.6], color="black", linewidth=2.0)
    left.plot([4.0, 4.0 + THICK_M], [0.6, 0.6], color="C3", linewidth=2.0, label="its jamb: a beam there, and no end")
    for y in np.arange(0.30, 0.85, 0.07):
        slope = (y - PLACE.y) / (4.0 - PLACE.x)
        is_on_wall, on_jamb_x = y < END[1], 4.0 + (END[1] - y) / slope
        stop = 4.0 if is_on_wall else on_jamb_x if on_jamb_x < 4.0 + THICK_M else 4.6
        left.plot([3.4, stop], [y + slope * (3.4 - 4.0), y + slope * (stop - 4.0)], color="C0", linewidth=0.9)
    left.set(xlabel="x [m]", ylabel="y [m]", xlim=(3.4, 4.6), ylim=(0.25, 0.95))
    left.legend(frameon=False, loc="upper left")
    bins = np.linspace(-3.0, 3.0, 41)
    for thick_m, color in ((0.0, "C0"), (THICK_M, "C3")):
        found = errors(thick_m, rng)
        label = f"{100 * thick_m:.0f} cm thick: mean {found.mean():.2f}, variance {found.var():.2f}"
        right.hist(found, bins, color=color, alpha=0.6, label=label)
    right.set(xlabel="place of the end beyond the true one, over its sigma [1]", ylabel=f"of {SCANS} scans [1]")
    right.set_ylim(top=1.25 * right.get_ylim()[1])  # the legend is above the bars
    right.legend(frameon=False, loc="upper left")
    plot.save(figure, "apparent_corner.png")


if __name__ == "__main__":
    main()
