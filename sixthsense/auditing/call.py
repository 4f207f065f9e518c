"""`ss.audit`: its runs, opened, compared with the truth and pooled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sixthsense.auditing import pairing
from sixthsense.auditing.mistakes import WRONG, of_errors, of_poses
from sixthsense.auditing.opening import Options, Order, Source, open_estimate, open_truth
from sixthsense.auditing.pairing import Align, Errors, TrajectoryErrors
from sixthsense.auditing.poses import Frame, Poses
from sixthsense.auditing.result import Audit
from sixthsense.auditing.statistics import AXES, findings, is_other_frame, pair_findings
from sixthsense.config.errors import InputError


@dataclass(frozen=True, slots=True)
class _Compared:
    """One run beside its truth."""

    estimate: Poses
    truth: Poses
    errors: Errors
    other: Errors
    """with the covariances read in the other frame"""
    trajectory: TrajectoryErrors
    notes: tuple[str, ...]


def audit(  # noqa: PLR0913
    estimate: Source | list[Source],
    truth: Source | list[Source] | None = None,
    *,
    pair: Source | None = None,
    covariance: str | Path | list[str | Path] | None = None,
    topic: str = "",
    pair_topic: str = "",
    truth_topic: str = "",
    frame: Frame | None = None,
    order: Order = "translation",
    align: Align | None = None,
    time_offset: float = 0.0,
    same_start: bool = False,
) -> Audit:
    """Audit the covariances of any system: whether its errors against the truth are as large as it says.

        print(ss.audit("localization.mcap", "truth.tum", topic="/amcl_pose", align="all"))
        ss.audit((stamps_s, poses, covariances), (truth_stamps_s, truth_poses)).plot()

    Parameters
    ----------
    estimate
        A ROS bag with PoseWithCovarianceStamped or Odometry, a TUM file with `covariance`, the folder of a run, a run,
        or arrays: stamps in s; poses (N, 3) x y theta, (N, 7) x y z qx qy qz qw, or matrices; covariances (N, 3, 3) or
        (N, 6, 6). A list of them is pooled as independent runs.
    truth
        A bag, a TUM file, the folder of a run, a run, or arrays; a list for a list. By default that of the run.
    pair
        Without a truth: another system on the same drive, with covariances; is one of both overconfident?
    covariance
        With a TUM file: a stamp and the 6 or 21 numbers of the upper triangle in each line; with `pair` a list of two.
    topic, pair_topic, truth_topic
        In bags; by default the only topic with poses.
    frame
        "world", the default: the axes of the parent frame, as ROS has it; "body": those of the body.
    order
        "translation" or "rotation": which comes first in a covariance.
    align
        "none", by default; "all", the default with `pair`: the motion with the least sum of NEES, whose degrees of
        freedom are taken off.
    time_offset
        Seconds to add to the stamps of the estimate.
    same_start
        Whether both begin together, by other clocks: stamps count from the first pose of each.

    Raises
    ------
    InputError
        In one line, for files that cannot be read, covariances that are none, and poses that cannot be compared.

    """
    options = Options(
        topic=topic, pair_topic=pair_topic, truth_topic=truth_topic, frame=frame,
        order=order, align=align, time_offset=time_offset, same_start=same_start,
    )  # fmt: skip
    if pair is not None:
        return _judged([_beside_each_other(estimate, truth, pair, covariance, options)], options, is_pair=True)
    return _judged([_beside_truth(*one, options) for one in _matched(estimate, truth, covariance)], options)


def _judged(runs: list[_Compared], options: Options, is_pair: bool = False) -> Audit:
    """The audit of runs beside their truths, which are pooled, or of two systems."""
    align: Align = options.align or ("all" if is_pair else "none")
    first, several = runs[0].estimate, len(runs) > 1
    own, others = [run.errors for run in runs], [run.other for run in runs]
    if len({run.error.shape[1] for run in own}) > 1:
        raise InputError("estimate", "found runs in the plane and in space", "all in one of them")
    read: Frame = first.frame or "world"
    other: Frame = "body" if read == "world" else "world"
    found = findings(own, align, read)
    notes = [f"{run.estimate.name}: {note}" if several else note for run in runs for note in run.notes]
    if not is_pair and is_other_frame(own, others):
        nees = f"{findings(others, align, other).pose.nees:.3g} (frame {other})"
        told = f"the covariances may have the axes of the {other}, where the NEES is {nees}"
        notes.append(f"the NEES depends on the heading: {told}")
    names = [f"{len(runs)} runs, the first {one.name}" if several else one.name for one in (first, runs[0].truth)]
    trajectory = None if is_pair else pairing.pooled([(len(run.truth), run.trajectory) for run in runs])
    judged = pair_findings(found, own[0]) if is_pair else None
    axes, dof = "the world's axes, rotations about fixed axes" if read == "world" else "the body's axes", found.pose.dof
    origin = first.convention if options.frame is None else ""
    words = f"in {axes}{origin}; {options.order} first; SE({2 if dof == 3 else 3}): {', '.join(AXES[read, dof])}"
    return Audit(found, tuple(own), read, align, words, (names[0], names[1]), tuple(notes), trajectory, judged)


def _matched(
    estimate: Source | list[Source],
    truth: Source | list[Source] | None,
    covariance: str | Path | list[str | Path] | None,
) -> list[tuple[Source, Source | None, Path | None]]:
    """Each estimate with its truth and its file of covariances; InputError for another number of them."""
    estimates: Sequence[Source] = estimate if isinstance(estimate, list) else [estimate]
    if not estimates:
        raise InputError("estimate", "found none", "one or more")
    columns: list[list[Any]] = []
    for name, given in (("truth", truth), ("covariance", covariance)):
        each = given if isinstance(given, list) else [given] * (1 if given is not None else len(estimates))
        if len(each) != len(estimates):
            raise InputError(name, f"found {len(each)} for {len(estimates)} estimates", "one for each, in order")
        columns.append(each)
    return [(one, true, file and Path(file)) for one, true, file in zip(estimates, *columns, strict=True)]


def _beside_truth(source: Source, true: Source | None, covariance: Path | None, options: Options) -> _Compared:
    """An estimate beside the truth."""
    estimate = open_estimate(source, covariance, options)
    return _side_by_side(estimate, open_truth(true, estimate, source, options), options.align or "none", options)


def _beside_each_other(
    source: Source | list[Source],
    truth: object,
    second: Source,
    covariance: str | Path | list[str | Path] | None,
    options: Options,
) -> _Compared:
    """Two systems; arrays, which have no name of their own, are the first and the second."""
    if truth is not None or isinstance(source, list):
        raise InputError("pair", "found beside a truth or several estimates", "one estimate, and no truth")
    if isinstance(second, list):
        raise InputError("pair", f"found a list of {len(second)}", "one system")
    systems = []
    for name, (one, _, file) in zip(("first", "second"), _matched([source, second], None, covariance), strict=True):
        of_second = {"topic": options.pair_topic or options.topic} if name == "second" else {}
        opened = open_estimate(one, file, options.replaced(**of_second))
        own_name = name if opened.name == "estimate" else opened.name
        systems.append(replace(opened, frame=opened.frame or "world", name=own_name))
    return _side_by_side(systems[0], systems[1], options.align or "all", options)


def _side_by_side(estimate: Poses, truth: Poses, align: Align, options: Options) -> _Compared:
    frame: Frame = estimate.frame or "world"
    if options.same_start:
        truth = replace(truth, stamps_ns=truth.stamps_ns - truth.stamps_ns[0] + estimate.stamps_ns[0])
    stamps_ns = estimate.stamps_ns + round(1e9 * options.time_offset)
    pair = pairing.paired(replace(estimate, frame=frame, stamps_ns=stamps_ns), truth)
    pairing.check_is_not_the_truth(pair)
    motion = pairing.aligned(pair, align, frame)
    own, other = (pairing.errors_of(pair, motion, one) for one in (frame, "body" if frame == "world" else "world"))
    seen = (*pair.notes, *of_poses(pair, align))  # errors of poses that cannot be right show nothing of covariances
    wrong = [f"{WRONG}: {one}" for one in of_errors(own)] if truth.covs is None and WRONG not in str(seen) else []
    return _Compared(estimate, pair.truth, own, other, pairing.trajectory_errors(pair), (*seen, *wrong))
