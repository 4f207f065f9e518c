"""The metrics of a run: the meaning and unit of each key, and their table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sixthsense.config.errors import did_you_mean
from sixthsense.evaluation.metrics import RPE_LENGTHS_M
from sixthsense.record.trace import STAGES

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Quantity:
    """The meaning of one metric."""

    group: str
    """heading under which it is shown"""
    unit: str
    """of the value; empty for text, 1 for a number without a unit"""
    meaning: str
    """one short phrase"""


_GROUPS = {
    "Outcome": (
        ("outcome", "", "why the run ended"),
        ("verdict", "", "whether the map is right, judged without truth, and what speaks against it"),
        ("map_wrong_probability", "1", "probability that the map is wrong, judged without truth"),
        ("collisions", "1", "number of collisions with walls"),
        ("touches_by_robot", "1", "touches of a person by the robot's fault: it moved in faster than the person"),
        ("touches_by_walkers", "1", "touches of the robot by a person's fault"),
        ("goal_error_m", "m", "distance of the true position from the goal at the end"),
        ("home_error_m", "m", "distance of the true position from the start at the end"),
        ("coverage", "1", "seen share of the visible area"),
        ("places_left", "1", "places that remained unseen"),
    ),
    "Accuracy": (
        ("ate_rmse_m", "m", "RMSE of the causal position"),
        ("dead_reckoning_ate_rmse_m", "m", "RMSE of the position by odometry alone"),
        ("heading_rmse_rad", "rad", "RMSE of the causal heading"),
        *((f"rpe_trans_m_{m}m", "m", f"RMSE of the translation over {m} m of path") for m in RPE_LENGTHS_M),
        *((f"rpe_rot_deg_{m}m", "°", f"RMSE of the rotation over {m} m of path") for m in RPE_LENGTHS_M),
        ("landmark_rmse_m", "m", "RMSE of corners and wall ends matched to true ones"),
        ("relations_trans_m_mean", "m", "mean translation error against the relations"),
        ("relations_rot_deg_mean", "°", "mean rotation error against the relations"),
    ),
    "Consistency": (
        ("pose_nees_world_mean", "1", "pose NEES, world coordinates; 3 is consistent"),
        ("pose_nees_effective_samples", "1", "independent samples that this correlated NEES is worth"),
        ("landmark_nees_mean", "1", "NEES at the end of the landmarks whose truth is known; 2 is consistent"),
        ("nis_mean_per_dof", "1", "NIS of the matches per degree of freedom; 1 is consistent"),
        ("discarded_share", "1", "share of the observations that the gates discarded"),
    ),
    "Wheels": (
        ("wheel_forward_scale_error", "1", "true distance is (1 + this) times the reported one, as estimated"),
        ("wheel_turn_scale_error", "1", "true turn is (1 + this) times the reported one, plus the drift"),
        ("wheel_drift_rad_per_m", "rad/m", "turn that unequal wheels add per metre"),
    ),
    "Sensor": (
        ("sensor_bearing_scale_error", "1", "tangents of true bearings are 1 + this times those the sensor reports"),
        ("sensor_centre_tangent", "1", "tangent of the true bearing of what the sensor reports on its axis"),
    ),
    "Scans": (
        ("scans", "1", "scans processed"),
        ("keyframes", "1", "scans of these that are keyframes"),
        ("largest_gap_s", "s", "longest time between two successive scans"),
    ),
    "Map and path": (
        ("area_seen_m2", "m²", "area of the cells that were seen"),
        ("landmarks", "1", "landmarks in the map at the end"),
        ("loop_closures_found", "1", "old places found again by the shape of the scans"),
        ("keyframes_passed_before", "1", "keyframes near an earlier or later pass, of a run without loop closures"),
        ("path_length_m", "m", "length of the driven path"),
        ("plans", "1", "planned paths"),
        ("plans_below_margin", "1", "planned paths with less clearance than configured; usual in doors"),
        ("plans_by_astar", "1", "paths planned by A* after the configured planner failed"),
        ("guard_stops", "1", "number of stops by the safety guard"),
    ),
    "Time": (
        ("sim_time_s", "s", "duration by the clock of the source"),
        ("wall_time_s", "s", "computing time of the loop"),
        ("realtime_factor", "1", "time of the source divided by computing time"),
        ("scan_ms_p50", "ms", "processing of a keyframe, median"),
        ("scan_ms_p99", "ms", "processing of a keyframe, 99th percentile"),
        *((f"stage_ms_mean.{stage}", "ms", f"{stage}, mean per keyframe") for stage in STAGES),
    ),
}
"""key, unit and meaning of each metric, by heading"""

QUANTITIES = {key: Quantity(group, unit, meaning) for group, rows in _GROUPS.items() for key, unit, meaning in rows}
"""meaning of every key of `Run.metrics`, in display order"""
UNITS = {key: quantity.unit.removesuffix("1") for key, quantity in QUANTITIES.items()}
"""unit of every key; empty for text and for a number without one"""


class Metrics(dict[str, Any]):
    """The metrics of a run by the keys of `metrics.json`, without keys for what was not measured.

    Values are numbers, except for `outcome` and `verdict`. The dictionary prints as a table with units. `QUANTITIES`
    has the meaning of each key.
    """

    def __missing__(self, key: str) -> Any:
        """KeyError with the nearest name."""
        raise KeyError(f"{key}{did_you_mean(key, self)}")

    def frame(self) -> pd.DataFrame:
        """A row per metric, index `metric`, with `value`, `unit`, `meaning` and `group`; units in `attrs`, too."""
        return side_by_side({"value": self})

    def __repr__(self) -> str:
        return str(as_text(self.frame().drop(columns="meaning")).to_string())

    def _repr_html_(self) -> str:
        return html_of(as_text(self.frame()))


def side_by_side(runs: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """A row per metric, index `metric`: a column for each run, by name, then `unit`, `meaning` and `group`.

    A metric that a run lacks is None. The units are in `attrs["units"]`, too, by metric.
    """
    import pandas as pd

    keys = list(dict.fromkeys([*(key for key in QUANTITIES if any(key in run for run in runs.values())),
                               *(key for run in runs.values() for key in run)]))  # fmt: skip
    known = [QUANTITIES.get(key, Quantity("Other", "", "")) for key in keys]
    columns = {name: pd.Series([run.get(key) for key in keys], keys, dtype=object) for name, run in runs.items()}
    frame = pd.DataFrame(columns, pd.Index(keys, name="metric"))
    frame["unit"] = [UNITS.get(key, "") for key in keys]
    frame["meaning"], frame["group"] = [one.meaning for one in known], [one.group for one in known]
    frame.attrs["units"] = dict(frame["unit"])
    return frame


def as_text(frame: pd.DataFrame) -> pd.DataFrame:
    """A table of metrics for people: in groups, with four significant digits, empty where there is no value."""
    return frame.set_index("group", append=True).swaplevel().map(digits)


def html_of(frame: pd.DataFrame) -> str:
    """A table in HTML with its texts in full; every cell is escaped."""
    import pandas as pd

    with pd.option_context("display.max_colwidth", None):
        return str(frame.to_html(border=0, na_rep="", index_names=False))


def digits(value: Any) -> str:
    """A value as text: a float with four significant digits, everything else as it is; empty for none."""
    if value is None or value != value:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
