"""The figures of merit of a run by their keys, with what they mean, and tables of them for people."""

from __future__ import annotations

import html
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sixthsense.config.extras import pandas
from sixthsense.record.stopwatch import STAGES

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Quantity:
    """What one of the metrics means."""

    group: str
    """heading under which it is shown"""
    unit: str
    """of the value; empty for a word, 1 for a number without one"""
    meaning: str
    """in a few words"""


def _quantities() -> dict[str, Quantity]:
    rows = {
        "Outcome": [
            ("outcome", "", "why the run ended"),
            ("collisions", "1", "times the robot touched a wall"),
            ("goal_error_m", "m", "from the goal to where the robot truly is"),
            ("home_error_m", "m", "from the start to where the robot truly is"),
            ("coverage", "1", "share seen of what can be seen"),
            ("places_left", "1", "places left unseen"),
            ("area_left_m2", "m²", "area of those places"),
        ],
        "Accuracy": [
            ("ate_rmse_m", "m", "error of the causal position, root mean square"),
            ("ate_max_m", "m", "the largest such error"),
            ("dead_reckoning_ate_rmse_m", "m", "the same of odometry alone"),
            ("heading_rmse_rad", "rad", "error of the causal heading, root mean square"),
            ("landmark_rmse_m", "m", "error of the matched corners and loose ends"),
            ("relations_trans_m_mean", "m", "error against the relations, mean of the translations"),
            ("relations_trans_m_std", "m", "their standard deviation"),
            ("relations_rot_deg_mean", "°", "error against the relations, mean of the rotations"),
            ("relations_rot_deg_std", "°", "their standard deviation"),
        ],
        "Consistency": [
            ("pose_nees_world_mean", "1", "pose NEES, world coordinates; 3 is consistent"),
            ("pose_nees_invariant_mean", "1", "pose NEES, right-invariant coordinates; 3 is consistent"),
            ("nis_mean_per_dof", "1", "NIS per degree of freedom; 1 is consistent"),
        ],
        "Map and way": [
            ("landmarks", "1", "landmarks at the end"),
            ("landmarks_culled", "1", "landmarks that were removed"),
            ("walls_merged", "1", "walls that turned out to be others"),
            ("path_length_m", "m", "way driven"),
            ("plans", "1", "paths planned"),
            ("plans_below_margin", "1", "of these, nearer to obstacles than wanted"),
            ("plans_by_astar", "1", "of these, by A* because the planner found none"),
            ("guard_stops", "1", "times the guard stopped the robot"),
        ],
        "Time": [
            ("sim_time_s", "s", "of the source's clock"),
            ("wall_time_s", "s", "of the loop"),
            ("realtime_factor", "1", "the one over the other"),
            ("scan_ms_p50", "ms", "a key scan's processing, median"),
            ("scan_ms_p99", "ms", "99th percentile"),
            ("scan_ms_max", "ms", "the longest"),
            *((f"stage_ms_mean.{stage}", "ms", f"{stage}, mean per key scan") for stage in STAGES),
        ],
    }
    return {key: Quantity(group, unit, meaning) for group, keys in rows.items() for key, unit, meaning in keys}


QUANTITIES = _quantities()
"""what every key of `Trace.metrics` means, in the order in which they are shown"""

_OTHER = Quantity("Other", "", "")

_STYLE = "text-align:left;padding:0 1em 0 0"


def digits(value: Any) -> str:
    """A value with as many digits as a reader wants: four, whole numbers whole."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


class Metrics(dict[str, Any]):
    """The metrics of a run: flat keys, numbers and one word, as `metrics.json` has them; what was not measured lacks.

    A dictionary that shows itself as a table with units. `QUANTITIES` says what each key means.
    """

    def groups(self) -> Iterator[tuple[str, list[str]]]:
        """The headings under which there is something, each with its keys."""
        ordered = sorted(self, key=_rank)
        for group in dict.fromkeys(_of(key).group for key in ordered):
            yield group, [key for key in ordered if _of(key).group == group]

    def frame(self) -> pd.DataFrame:
        """A row per metric, index `metric`, with `value`, `unit`, `meaning` and `group`; ExtraError without pandas."""
        keys = [key for _, keys in self.groups() for key in keys]
        columns: dict[str, list[Any]] = {"value": [self[key] for key in keys]}
        for name in ("unit", "meaning", "group"):
            columns[name] = [getattr(_of(key), name) for key in keys]
        index = pandas().Index(keys, name="metric")
        return pandas().DataFrame(columns, index=index)

    def __repr__(self) -> str:
        width = max(map(len, self), default=0)
        lines = []
        for group, keys in self.groups():
            lines.append(group)
            lines += [f"  {key:{width}}  {digits(self[key])} {_unit(key)}".rstrip() for key in keys]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return html_table(["metric", "value", "meaning"], [self], lambda key: _of(key).meaning)


def html_table(head: Sequence[str], runs: Sequence[Mapping[str, Any]], last: Any = None) -> str:
    """Metrics in groups, one column for each of the `runs`, and one more of what `last` says of a key.

    Everything is escaped. `head` are the columns' names.
    """
    together = Metrics(dict.fromkeys(key for run in runs for key in run))
    row = "<tr>{}</tr>".format
    lines = [row("".join(f'<th style="{_STYLE}">{html.escape(name)}</th>' for name in head))]
    for group, keys in together.groups():
        lines.append(row(f'<th colspan="{len(head)}" style="{_STYLE}">{html.escape(group)}</th>'))
        for key in keys:
            values = [f"{digits(run[key])} {_unit(key)}".rstrip() if key in run else "" for run in runs]
            cells = [key, *values, *([] if last is None else [last(key)])]
            lines.append(row("".join(f'<td style="{_STYLE}">{html.escape(cell)}</td>' for cell in cells)))
    return f"<table>{''.join(lines)}</table>"


def _of(key: str) -> Quantity:
    return QUANTITIES.get(key, _OTHER)


def _unit(key: str) -> str:
    unit = _of(key).unit
    return "" if unit == "1" else unit


_RANKS = {key: rank for rank, key in enumerate(QUANTITIES)}


def _rank(key: str) -> int:
    return _RANKS.get(key, len(_RANKS))
