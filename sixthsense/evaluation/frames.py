"""A run's trajectory and landmarks as pandas frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.config.extras import pandas
from sixthsense.core.geometry import Array
from sixthsense.evaluation.curves import curves, key_distances, key_poses, key_times

if TYPE_CHECKING:
    import pandas as pd

    from sixthsense.record.trace import Trace

POSE = ("x", "y", "theta")


class Trajectory:
    """The poses of a run at its keyframes, `Run.trajectory`; `frame()` is their table."""

    def __init__(self, trace: Trace) -> None:
        """Show the record of a run."""
        self._trace = trace

    def frame(self) -> pd.DataFrame:
        """A row per keyframe, world frame, metres and radians; ExtraError without pandas.

        `stamp_ns` is the index. `time_s` and `distance_m` are since the first scan; `x`, `y`, `theta` the causal
        estimate after the keyframe's update, `sigma_*` its standard deviations; `*_final` the pose as known at the end;
        `*_true` and `nees`, of the causal pose, where there is truth.
        """
        trace = self._trace
        if not trace.key_stamps_ns:
            return pandas().DataFrame(index=pandas().Index([], name="stamp_ns"))
        columns = {"time_s": key_times(trace), "distance_m": key_distances(trace)}
        poses, covs = key_poses(trace.key_estimates)
        columns |= _columns(poses, "{}")
        columns |= _columns(np.sqrt(np.maximum(np.einsum("kii->ki", covs), 0.0)), "sigma_{}")
        if len(trace.trajectory) == len(poses):  # not of a killed run
            columns |= _columns(trace.trajectory, "{}_final")
        errors = curves(trace)
        if errors is not None:
            columns |= _columns(np.array(trace.key_truths), "{}_true") | {"nees": errors.nees}
        return pandas().DataFrame(columns, index=pandas().Index(trace.key_stamps_ns, name="stamp_ns"))

    def __len__(self) -> int:
        return len(self._trace.key_stamps_ns)

    def __repr__(self) -> str:
        return f"<Trajectory of {len(self)} keyframes, {self._trace.path_length_m:.1f} m; frame() is its table>"


class Landmarks:
    """The landmarks of a run's final map, `Run.landmarks`; `frame()` is their table."""

    def __init__(self, trace: Trace) -> None:
        """Show the record of a run."""
        self._trace = trace

    def frame(self) -> pd.DataFrame:
        """A row per landmark with index `id`, world frame, metres and radians; ExtraError without pandas.

        `kind`; of a point `x`, `y` and their standard deviations `sigma_*`; of a wall its normal's angle `alpha` and
        distance `d` from the origin, theirs, and the ends of its seen part, `from_x` to `to_y`; `observations`, the
        number of them. NaN where a kind has no such column.
        """
        trace, final = self._trace, self._trace.final
        sigmas = np.sqrt(np.maximum(np.diag(trace.joint_cov)[3:], 0.0)).reshape(-1, 2)
        rows = []
        for i, mean, sigma, is_wall in zip(final.ids.tolist(), final.landmarks, sigmas, final.walls, strict=True):
            record, names = trace.records[i], ("alpha", "d") if is_wall else ("x", "y")
            row: dict[str, Any] = {"kind": record.kind.name.lower(), "observations": record.observations}
            row |= dict(zip(names, mean.tolist(), strict=True))
            row |= {f"sigma_{name}": value for name, value in zip(names, sigma.tolist(), strict=True)}
            if is_wall:
                row |= dict(zip(_ENDS, record.extent.ravel().tolist(), strict=True))
            rows.append(row)
        index = pandas().Index(final.ids.tolist(), name="id", dtype="int64")
        return pandas().DataFrame(rows, index=index, columns=_LANDMARK_COLUMNS)

    def __len__(self) -> int:
        return len(self._trace.final.ids)

    def __repr__(self) -> str:
        walls = int(self._trace.final.walls.sum())
        return f"<{len(self)} landmarks, {walls} of them walls; frame() is their table>"


_ENDS = ("from_x", "from_y", "to_x", "to_y")
_LANDMARK_COLUMNS = [
    "kind", "x", "y", "sigma_x", "sigma_y", "alpha", "d", "sigma_alpha", "sigma_d", *_ENDS, "observations"
]  # fmt: skip


def _columns(poses: Array, name: str) -> dict[str, Array]:
    """(K, 3) poses as columns, whose names follow a pattern."""
    return {name.format(part): poses[:, k] for k, part in enumerate(POSE)}
