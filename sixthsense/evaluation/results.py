"""The metrics of a run: the meaning and unit of each key, and tables of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sixthsense.config.errors import did_you_mean, pandas
from sixthsense.evaluation.effective import EFFECTIVE
from sixthsense.evaluation.metrics import RPE_LENGTHS_M
from sixthsense.evaluation.tables import digits, html_table, text_table
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


TEXTS = ("outcome", "verdict")
"""keys whose values are texts"""

_REMARKS = {
    "plans_below_margin": "usual: doors leave less room than the margin",
    "loop_closures_refused": "usual: places that look alike",
}
"""why a value that looks alarming is not, in a few words, by key"""


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
        ("area_left_m2", "m²", "total area of these places"),
    ),
    "Accuracy": (
        ("ate_rmse_m", "m", "RMSE of the causal position"),
        ("ate_max_m", "m", "maximum error of the causal position"),
        ("dead_reckoning_ate_rmse_m", "m", "RMSE of the position by odometry alone"),
        ("heading_rmse_rad", "rad", "RMSE of the causal heading"),
        *((f"rpe_trans_m_{m}m", "m", f"RMSE of the translation over {m} m of path") for m in RPE_LENGTHS_M),
        *((f"rpe_rot_deg_{m}m", "°", f"RMSE of the rotation over {m} m of path") for m in RPE_LENGTHS_M),
        ("landmark_rmse_m", "m", "RMSE of corners and wall ends matched to true ones"),
        ("relations_trans_m_mean", "m", "mean translation error against the relations"),
        ("relations_trans_m_std", "m", "standard deviation of the translation error"),
        ("relations_trans_m_max", "m", "largest translation error"),
        ("relations_rot_deg_mean", "°", "mean rotation error against the relations"),
        ("relations_rot_deg_std", "°", "standard deviation of the rotation error"),
    ),
    "Consistency": (
        ("pose_nees_world_mean", "1", "pose NEES, world coordinates; 3 is consistent"),
        ("pose_nees_in_band", "1", "share of keyframes with a pose NEES in its 95 % band; 0.95 is consistent"),
        (EFFECTIVE, "1", "independent samples that this correlated NEES is worth"),
        ("prediction_nees_world_mean", "1", "NEES of the pose before each update; 3 is consistent"),
        ("pose_nees_invariant_mean", "1", "pose NEES, right-invariant coordinates; 3 is consistent"),
        ("landmark_nees_mean", "1", "NEES at the end of the landmarks whose truth is known; 2 is consistent"),
        ("nis_mean_per_dof", "1", "NIS of the matches per degree of freedom; 1 is consistent"),
        ("discarded_share", "1", "share of the observations that the gates discarded"),
    ),
    "Wheels": (
        ("wheel_forward_scale_error", "1", "true distance is (1 + this) times the reported one, as estimated"),
        ("wheel_turn_scale_error", "1", "true turn is (1 + this) times the reported one, plus the drift"),
        ("wheel_drift_rad_per_m", "rad/m", "turn that unequal wheels add per metre"),
        ("wheel_latency_s", "s", "age of odometry at its stamp"),
        ("wheel_forward_scale_sigma", "1", "standard deviation of the estimated wheel_forward_scale_error"),
        ("wheel_turn_scale_sigma", "1", "standard deviation of the estimated wheel_turn_scale_error"),
        ("wheel_drift_sigma_rad_per_m", "rad/m", "standard deviation of the estimated wheel_drift_rad_per_m"),
        ("wheel_latency_sigma_s", "s", "standard deviation of the estimated wheel_latency_s"),
        ("wheel_curve_loss_m_per_rad", "m/rad", "distance that curves are shorter than reported, as estimated"),
        ("wheel_curve_loss_sigma_m_per_rad", "m/rad", "standard deviation of the estimated wheel_curve_loss_m_per_rad"),
    ),
    "Sensor": (
        ("sensor_yaw_rad", "rad", "direction of the sensor beyond the assumed one, as estimated"),
        ("sensor_forward_m", "m", "place of the sensor along the robot's x axis beyond the assumed one, as estimated"),
        ("sensor_bearing_scale_error", "1", "tangents of true bearings are 1 + this times those the sensor reports"),
        ("sensor_centre_tangent", "1", "tangent of the true bearing of what the sensor reports on its axis"),
        ("sensor_yaw_sigma_rad", "rad", "standard deviation of the estimated sensor_yaw_rad"),
        ("sensor_forward_sigma_m", "m", "standard deviation of the estimated sensor_forward_m"),
        ("sensor_bearing_scale_sigma", "1", "standard deviation of the estimated sensor_bearing_scale_error"),
        ("sensor_centre_sigma", "1", "standard deviation of the estimated sensor_centre_tangent"),
    ),
    "Scans": (
        ("scans", "1", "scans processed"),
        ("keyframes", "1", "scans of these that are keyframes"),
        ("largest_gap_s", "s", "longest time between two successive scans"),
    ),
    "Map and path": (
        ("area_seen_m2", "m²", "area of the cells that were seen"),
        ("landmarks", "1", "landmarks in the map at the end"),
        ("landmarks_culled", "1", "landmarks removed from the map"),
        ("walls_merged", "1", "walls merged into older duplicates"),
        ("loop_closures_found", "1", "old places found again by the shape of the scans"),
        ("loop_closures_refused", "1", "places that looked right and were refused: ambiguous, or scans disagreed"),
        ("loop_closures_undone", "1", "loop closures taken back, since later scans contradicted them"),
        ("path_length_m", "m", "length of the driven path"),
        ("plans", "1", "planned paths"),
        ("plans_below_margin", "1", "planned paths with less clearance than configured"),
        ("plans_by_astar", "1", "paths planned by A* after the configured planner failed"),
        ("guard_stops", "1", "number of stops by the safety guard"),
    ),
    "Time": (
        ("sim_time_s", "s", "duration by the clock of the source"),
        ("wall_time_s", "s", "computing time of the loop"),
        ("realtime_factor", "1", "time of the source divided by computing time"),
        ("scan_ms_p50", "ms", "processing of a keyframe, median"),
        ("scan_ms_p99", "ms", "processing of a keyframe, 99th percentile"),
        ("scan_ms_max", "ms", "processing of a keyframe, maximum"),
        *((f"stage_ms_mean.{stage}", "ms", f"{stage}, mean per keyframe") for stage in STAGES),
    ),
}
"""key, unit and meaning of each metric, by heading"""

QUANTITIES = {key: Quantity(group, unit, meaning) for group, rows in _GROUPS.items() for key, unit, meaning in rows}
"""meaning of every key of `Run.metrics`, in display order"""


class Metrics(dict[str, Any]):
    """The metrics of a run by the keys of `metrics.json`, without keys for what was not measured.

    Values are numbers, except for `outcome` and `verdict`. The dictionary prints as a table with units. `QUANTITIES`
    has the meaning of each key.
    """

    def __missing__(self, key: str) -> Any:
        """KeyError with the nearest name."""
        raise KeyError(f"{key}{did_you_mean(key, self)}")

    def groups(self) -> Iterator[tuple[str, list[str]]]:
        """Each heading that has metrics, with their keys."""
        ordered = [key for key in QUANTITIES if key in self] + [key for key in self if key not in QUANTITIES]
        for group in dict.fromkeys(_of(key).group for key in ordered):
            yield group, [key for key in ordered if _of(key).group == group]

    def frame(self) -> pd.DataFrame:
        """A row per metric, index `metric`, with `value`, `unit`, `meaning` and `group`; InputError without pandas."""
        keys = [key for _, keys in self.groups() for key in keys]
        columns: dict[str, list[Any]] = {"value": [self[key] for key in keys]}
        for name in ("unit", "meaning", "group"):
            columns[name] = [getattr(_of(key), name) for key in keys]
        index = pandas().Index(keys, name="metric")
        return pandas().DataFrame(columns, index=index)

    def __repr__(self) -> str:
        def cells(key: str) -> list[str]:
            return [f"  {key}", f"{digits(self[key])} {unit(key)}".rstrip(), _REMARKS.get(key, "") if self[key] else ""]

        return text_table(in_groups([self], cells))

    def _repr_html_(self) -> str:
        return metrics_table(["metric", "value", "meaning"], [self], lambda key: _of(key).meaning)


def metrics_table(
    head: Sequence[str], runs: Sequence[Mapping[str, Any]], last: Callable[[str], str] | None = None
) -> str:
    """The metrics of `runs` as an HTML table with the column names `head`: grouped, a column for each run.

    `last` gives the text of one more column for each key.
    """

    def cells(key: str) -> list[str]:
        values = [f"{digits(run[key])} {unit(key)}".rstrip() if key in run else "" for run in runs]
        return [key, *values, *([] if last is None else [last(key)])]

    return html_table(head, in_groups(runs, cells))


def in_groups(runs: Sequence[Mapping[str, Any]], cells: Callable[[str], list[str]]) -> list[list[str]]:
    """Rows of a table of the metrics that any of `runs` has, each as `cells` of its key, under their headings."""
    rows: list[list[str]] = []
    for group, keys in Metrics(dict.fromkeys(key for run in runs for key in run)).groups():
        rows += [[group], *map(cells, keys)]
    return rows


def unit(key: str) -> str:
    """The unit of a metric; empty for text and for a number without one."""
    return _of(key).unit.removesuffix("1")


def _of(key: str) -> Quantity:
    return QUANTITIES.get(key, Quantity("Other", "", ""))
