"""`MeasuredRun`: the record and metrics of a run, in memory or from its folder; its poses and landmarks as frames."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from sixthsense.config.errors import InputError
from sixthsense.config.files import instead_of
from sixthsense.core.geometry import Array
from sixthsense.evaluation.curves import curves, key_nees, key_places, key_poses
from sixthsense.evaluation.groups import Sample
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.results import Metrics
from sixthsense.evaluation.summary import run_summary
from sixthsense.record.store import load_record
from sixthsense.record.trace import Trace
from sixthsense.verdict.verdict import Verdict

if TYPE_CHECKING:
    import pandas as pd

MAX_RUNS = 12  # more panels in a figure are illegible

_METRICS_OF_END = ("wall_time_s", "realtime_factor", "landmarks", "loop_closures", "wheel")
"""prefixes of the metrics that need the end of a record"""


@dataclass(eq=False, repr=False)
class MeasuredRun:
    """A record with its metrics, which are computed on demand or read from the run's folder."""

    name: str
    """of the scene, log or folder"""
    trace: Trace
    """record of the sensor data, estimates and plans"""
    stated: Metrics | None = None
    """its metrics as the folder has them; without these they are computed at their first use"""
    folder: Path | None = None
    """the run's folder; None for a run in memory only"""
    missing: tuple[str, ...] = ()
    """missing parts of the folder's record; `ss.replay(folder)` estimates them again"""

    @property
    def metrics(self) -> Metrics:
        """Errors, consistency, coverage and timing by flat keys, with units; unavailable metrics are left out.

        The dictionary is displayed as a table; `metrics.frame()` converts it to pandas. The metrics are computed once,
        or read from the run's folder.
        """
        return Metrics(self.stated or (self._measured if self.trace.outcome else measure(self.trace)))

    @functools.cached_property
    def _measured(self) -> Metrics:
        return measure(self.trace)

    @property
    def verdict(self) -> Verdict | None:
        """Whether the map is right, and what speaks against it; None while the run goes on, and of a killed run."""
        return self.trace.verdict

    @property
    def trajectory(self) -> pd.DataFrame:
        """The poses at keyframes: a row each, world frame, metres and radians.

        `stamp_ns` is the index. `time_s` and `distance_m` are since the first scan; `x`, `y`, `theta` the causal
        estimate after the keyframe's update, `sigma_*` its standard deviations; `*_final` the pose as known at the end;
        `*_true` and `nees`, of the causal pose, where there is truth.
        """
        import pandas as pd

        trace, index = self.trace, pd.Index(self.trace.key_stamps_ns, name="stamp_ns")
        if not trace.key_stamps_ns:
            return pd.DataFrame(index=index)
        poses, covs = key_poses(trace.key_estimates)
        columns = {"time_s": key_places(trace, "time"), "distance_m": key_places(trace, "distance")}
        columns |= _columns(poses, "{}") | _columns(np.sqrt(np.maximum(np.einsum("kii->ki", covs), 0.0)), "sigma_{}")
        if len(trace.trajectory) == len(poses):  # not of a killed run
            columns |= _columns(trace.trajectory, "{}_final")
        if trace.key_truths:
            columns |= _columns(np.array(trace.key_truths), "{}_true") | {"nees": key_nees(trace)}
        return pd.DataFrame(columns, index=index)

    @property
    def landmarks(self) -> pd.DataFrame:
        """The landmarks of the final map: a row each with index `id`, world frame, metres and radians.

        The columns of `landmarks.csv`, and standard deviations. `kind`; of a point `x`, `y`; of a wall its normal's
        angle `alpha` and distance `d` from the origin, and the ends of its seen part, `from_x` to `to_y`; `cov_*` and
        `sigma_*` of both; `observations`, the number of them. NaN where a kind has no such column.
        """
        import pandas as pd

        from sixthsense.record.exports import LANDMARK_COLUMNS, landmark_rows

        frame = pd.DataFrame(landmark_rows(self.trace), columns=list(LANDMARK_COLUMNS)).set_index("id")
        for name, cov in (("x", "cov_xx"), ("y", "cov_yy"), ("alpha", "cov_alpha_alpha"), ("d", "cov_d_d")):
            frame[f"sigma_{name}"] = np.sqrt(np.maximum(frame[cov].astype(np.float64), 0.0))
        return frame

    def sample(self, name: str) -> Sample:
        """The run under a name, as one of several that are compared."""
        return Sample(name, self.trace.config, lambda: dict(self.metrics), lambda: curves(self.trace), self)

    @property
    def title(self) -> str:
        """Name, scene, estimator, preset, seed and outcome in one line."""
        config = self.trace.config
        named = self.trace.scene is None or Path(config.scene).suffix or config.scene == self.name
        of = "" if named else f"{config.scene} · "
        return f"{self.name}: {of}{config.estimator} · {config.preset} · seed {config.seed} · {self.outcome}"

    @property
    def outcome(self) -> str:
        """Why the run ended; "running" if that is unknown."""
        return str((self.stated or Metrics()).get("outcome") or self.trace.outcome) or "running"

    @property
    def summary(self) -> dict[str, str]:
        """The lines of its summary, label and text: outcome, map, accuracy, consistency, speed."""
        return run_summary(self.metrics)

    def __repr__(self) -> str:
        lines = self.summary
        shown = "; ".join(f"{name} {lines[name]}" for name in ("map", "accuracy") if name in lines)
        lacks = f"; missing: {', '.join(self.missing)}" if self.missing else ""
        return f"<{type(self).__name__} {self.title}; {shown}{lacks}>"

    def __str__(self) -> str:
        return "\n".join([self.title, *(f"{label:12} {text}" for label, text in self.summary.items())])

    @classmethod
    def read(cls, folder: Path | str) -> Self:
        """Read a run folder without estimating again; InputError for a damaged folder or one that is not of a run."""
        folder = Path(folder)
        check_folders([folder])
        trace, lacks, found = load_record(folder)
        if found is None:
            found = {name: value for name, value in measure(trace).items() if not name.startswith(_METRICS_OF_END)}
        return cls(trace.name, trace, Metrics(found), folder, lacks)

    def to_bag(self, out: str | Path) -> Path:
        """Write the record as a ROS 2 bag with MCAP storage, a new folder; InputError for a run without a folder."""
        from sixthsense.record.exports import write_bag

        if self.folder is None:
            raise InputError("run", "found a run in memory", "one with a folder, whose record has what it received")
        write_bag(Path(out), self.folder, self.trace)
        return Path(out)

    def to_g2o(self, out: str | Path) -> Path:
        """Write the factor graph as a g2o file, which GTSAM reads: `record.exports.write_g2o`."""
        from sixthsense.record.exports import write_g2o

        write_g2o(Path(out), self.trace)
        return Path(out)

    def to_gtsam(self, out: str | Path) -> Path:
        """Write all of the factor graph as an NPZ file of arrays, walls included: `record.exports.graph_arrays`."""
        from sixthsense.record.exports import write_graph

        write_graph(Path(out), self.trace)
        return Path(out)

    def to_tum(self, out: str | Path) -> list[Path]:
        """Write the trajectories into a folder: estimate.tum, smoothed.tum and truth.tum."""
        from sixthsense.record.exports import write_trajectories

        return write_trajectories(Path(out), self.trace)

    def to_csv(self, out: str | Path) -> list[Path]:
        """Write tables into a folder: trajectory.csv, landmarks.csv, and places_left.csv of what was left unseen."""
        import pandas as pd

        from sixthsense.navigation.unseen_places import UnseenPlace
        from sixthsense.record.exports import write_landmarks

        files = [Path(out) / name for name in ("trajectory.csv", "landmarks.csv", "places_left.csv")]
        self.trajectory.to_csv(files[0])
        write_landmarks(Path(out), self.trace)
        pd.DataFrame(self.trace.left, columns=list(UnseenPlace.__slots__)).to_csv(files[2], index=False)
        return files


def check_folders(folders: Sequence[Path | str]) -> None:
    """Raise InputError for a folder that is not a run folder, for no folder and for more than `MAX_RUNS`."""
    if not 1 <= len(folders) <= MAX_RUNS:
        raise InputError("runs", f"found {len(folders)}", f"1 to {MAX_RUNS}")
    for folder in map(Path, folders):
        if not (folder / "config.toml").is_file():
            is_campaign = (folder / "campaign.toml").is_file()
            found = "the folder of a campaign" if is_campaign else instead_of(folder, "config.toml")
            raise InputError(folder, f"found {found}", "the folder of a run")


def numbered_names(names: Sequence[str]) -> list[str]:
    """The names, with a number where several are equal."""
    return [f"{name} ({k + 1})" if names.count(name) > 1 else name for k, name in enumerate(names)]


def _columns(poses: Array, name: str) -> dict[str, Array]:
    """(K, 3) poses as columns, whose names follow a pattern."""
    return {name.format(part): poses[:, k] for k, part in enumerate(("x", "y", "theta"))}
