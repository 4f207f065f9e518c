"""What can be audited, opened as told: bags, TUM files, folders of runs, and arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from sixthsense.auditing.mistakes import WRONG, of_estimate
from sixthsense.auditing.pairing import Align
from sixthsense.auditing.poses import Frame, Poses, Stamps, check_covariances, poses_from
from sixthsense.config.errors import InputError
from sixthsense.config.section import Section
from sixthsense.core.arguments import as_array
from sixthsense.evaluation.curves import key_poses
from sixthsense.evaluation.measured_run import MeasuredRun
from sixthsense.logs import kind_of
from sixthsense.logs.diagnose import findings_of
from sixthsense.logs.finding import KINDS
from sixthsense.logs.log import Odometry, ascending, matched
from sixthsense.logs.text_lines import read_covariances, read_trajectory, unit_of

if TYPE_CHECKING:
    from sixthsense.record.trace import Trace

Order = Literal["translation", "rotation"]
Source = str | Path | MeasuredRun | Sequence[ArrayLike]
"""a bag, a TUM file, the folder of a run, a run, or arrays: stamps, poses and, of an estimate, covariances"""

_ROUNDED_S = 1e-5
"""of a covariance and its pose: decimals of a stamp in seconds since 1970 that a float holds end at 0.2 us"""
_FORMS = "(N, 3) x y theta, (N, 7) x y z qx qy qz qw, or (N, 3, 3) or (N, 4, 4) matrices"


class Options(Section):
    """How the sources are read and compared; InputError for a value that is not allowed."""

    topic: str = ""
    """of the estimate in a bag; by default the only one with covariances"""
    pair_topic: str = ""
    """the same of the other system; by default as `topic`"""
    truth_topic: str = ""
    """of the truth in a bag"""
    frame: Frame | None = None
    """whose axes the covariances have; by default that of the format, and else the world's"""
    order: Order = "translation"
    """which half of a covariance is first"""
    align: Align | None = None
    """how the estimate is brought into the frame of the truth; by default not, and by all poses into that of a pair"""
    time_offset: Annotated[float, Field(ge=-1e9, le=1e9)] = 0.0
    """added to the stamps of the estimate, s"""
    same_start: bool = False
    """whether both begin together: stamps count from the first pose of each"""


def open_estimate(source: Source, covariance: Path | None, options: Options) -> Poses:
    """The poses of an estimate, with covariances in the order translation, rotation.

    Notes of a run are what its verdict has found of its log, such as where the laser is mounted.
    """
    if run := _run_of(source):
        name, trace = run
        if not trace.key_estimates:
            raise InputError(name, "found no keyframe", "a run with estimates")
        stamps_ns = np.array(trace.key_stamps_ns, dtype=np.int64)
        causes = trace.verdict.causes if trace.verdict else ()
        notes = tuple(cause.sentence for cause in causes if cause.name in KINDS)
        poses = replace(poses_from(name, stamps_ns, *key_poses(trace.key_estimates)), frame="world", notes=notes)
    elif isinstance(source, (str, Path)):
        poses = _estimate_of_file(Path(source), covariance, options.topic)
    else:
        poses = _of_arrays("estimate", source, ("stamps", "poses", "covariances"))
    assert poses.covs is not None
    check_covariances(poses)
    if options.order == "rotation":
        half = 2 if poses.covs.shape[1] == 3 else 3
        poses = replace(poses, covs=np.roll(poses.covs, (half, half), axis=(1, 2)))
    notes = *poses.notes, *(f"{WRONG}: {mistake}" for mistake in of_estimate(poses))
    return replace(poses, notes=notes, frame=options.frame or poses.frame)


def open_truth(source: Source | None, estimate: Poses, of: Source, options: Options) -> Poses:
    """The true poses; without a source those of the run that is audited."""
    if run := _run_of(of if source is None else source):
        name, trace = run
        if not trace.truths:
            raise InputError(name, "found a run without truth", "a truth from elsewhere")
        return poses_from(name, np.array(trace.stamps_ns, dtype=np.int64), np.array(trace.truths))
    if source is None:
        raise InputError("truth", "found nothing", f"the true poses of {estimate.name}")
    if not isinstance(source, (str, Path)):
        return _of_arrays("truth", source, ("stamps", "poses"))
    path = Path(source)
    if kind_of(path) == "bag":
        from sixthsense.logs.rosbag import read_poses

        own = estimate.name.removeprefix(f"{path} ")
        found = read_poses(path, options.truth_topic, False, [own])
        return poses_from(f"{path} {found.topic}", found.stamps_ns, found.poses)
    notes: list[str] = []
    return _noted(poses_from(str(path), *read_trajectory(_file(path), notes)), notes)


def _estimate_of_file(path: Path, covariance: Path | None, topic: str) -> Poses:
    if kind_of(path) == "bag":
        from sixthsense.logs.rosbag import read_poses

        found = read_poses(path, topic)
        poses = poses_from(f"{path} {found.topic}", found.stamps_ns, found.poses, found.covs)
        return replace(poses, frame="world", convention=" (the convention of ROS)")
    path = _file(path)
    if covariance is None:
        form = "a file with a stamp and 6 or 21 numbers of the upper triangle in each line"
        raise InputError("covariance", f"found nothing for {path}", form)
    notes: list[str] = []
    stamps, values = read_trajectory(path, notes)
    cov_stamps, covs = read_covariances(covariance, notes)
    rows = matched(1e-9 * cov_stamps, 1e-9 * stamps)
    has = rows >= 0
    if not has.any():
        raise InputError(covariance, f"found no stamp of {path}", "the stamps of its poses")
    off_s = 1e-9 * float(np.abs(cov_stamps[rows[has]] - stamps[has]).max())
    if not has.all() or off_s > _ROUNDED_S:
        count = f"{np.count_nonzero(has):,} of {len(has):,} poses"
        notes.append(f"{count} have a covariance within half a period, {off_s:.3g} s away at most")
    return _noted(poses_from(str(path), stamps[has], values[has], covs[rows[has]]), notes)


def _noted(poses: Poses, notes: list[str]) -> Poses:
    return replace(poses, notes=(*notes, *poses.notes))


def _file(path: Path) -> Path:
    if not path.exists():
        raise InputError(path, "no such file")
    if path.is_dir():
        kinds = "a ROS bag (.bag, .mcap, .db3, or a folder with metadata.yaml), a TUM file, the folder of a run"
        raise InputError(path, "found a folder", kinds)
    if kind_of(path) == "graph":
        raise InputError(path, "found a graph of poses, which has no stamps", "a trajectory with stamps, as a TUM file")
    return path


def _run_of(source: Source | None) -> tuple[str, Trace] | None:
    """Name and record of a run or of the folder of one; None for any other source."""
    if isinstance(source, MeasuredRun):
        return source.name, source.trace
    if isinstance(source, (str, Path)) and kind_of(Path(source)) == "run":
        from sixthsense.record.store import load_record

        return str(Path(source)), load_record(source).trace
    return None


def _of_arrays(what: str, given: Any, names: tuple[str, ...]) -> Poses:
    """Poses from the caller's arrays; InputError names the array, what was expected and what was found."""
    if isinstance(given, (bytes, dict)) or not hasattr(given, "__len__") or len(given) != len(names):
        there = f"{len(given)} of them" if isinstance(given, (tuple, list)) else type(given).__name__
        raise InputError(what, f"found {there}", f"a file, a run, or arrays ({', '.join(names)})")
    stamps_ns, notes = _nanoseconds(what, given[0])
    try:
        poses = as_array(f"{what} poses", given[1], ("N", "n", "n") if np.ndim(given[1]) == 3 else ("N", "n"))
        if poses.shape[1:] not in ((3,), (7,), (3, 3), (4, 4)):
            raise ValueError(f"{what} poses: expected {_FORMS}, got shape {poses.shape}")
        covs = None
        if len(names) == 3:
            size = 6 if np.shape(given[2])[-1:] == (6,) else 3
            covs = as_array(f"{what} covariances", given[2], ("N", size, size), finite=False)
        if len(stamps_ns) == 0 or any(len(one) != len(stamps_ns) for one in (poses, covs) if one is not None):
            raise ValueError(f"{what}: expected as many stamps as poses and covariances, at least one")
    except ValueError as error:
        raise InputError("", str(error)) from None
    if covs is not None and covs.shape[1] == 6 and poses.shape[1:] in ((3,), (3, 3)):
        raise InputError(f"{what} covariances", "found 6 x 6 of planar poses", "3 x 3")
    for fault in findings_of((), Odometry(ascending(stamps_ns), poses)) if poses.shape[1:] == (3,) else ():
        if fault.action == "refused" and fault.kind != "odometry_unit":  # which a truth tells better
            raise InputError(f"{what} poses", f"found {fault.text}", "metres and radians")
    return _noted(poses_from(what, stamps_ns, poses, covs), notes)


def _nanoseconds(what: str, given: Any) -> tuple[Stamps, list[str]]:
    """Stamps (N,), ns, of seconds or parts of them since 1970, and of times and durations of NumPy and pandas."""
    import pandas as pd

    try:
        times = pd.Index(given if getattr(given, "ndim", 1) == 1 else as_array(f"{what} stamps", given, ("N",)))
        if times.dtype.kind not in "mM":
            seconds = as_array(f"{what} stamps", given, ("N",))
    except (ValueError, TypeError) as error:
        raise InputError("", str(error)) from None
    if times.dtype.kind in "mM":
        if times.hasnans:
            raise InputError(f"{what} stamps", "found one that is no time (NaT)", "times")
        return np.asarray(times.as_unit("ns").asi8), []
    parts, unit = unit_of(seconds)
    notes = [] if parts == 1 else [f"{what}: stamps as large as {seconds.max():.0f} are taken as {unit}"]
    if times.dtype.kind in "iu":
        return np.asarray(given, dtype=np.int64) * (10**9 // parts), notes
    if np.abs(seconds).max(initial=0.0) * (1e9 / parts) > np.iinfo(np.int64).max:
        raise InputError(f"{what} stamps", f"found {seconds.max():g}", "seconds")
    return np.round(seconds * (1e9 / parts)).astype(np.int64), notes
