"""`ss.audit`: its runs, opened, compared with the truth and pooled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sixthsense.auditing.opening import Options, Order, Source, open_estimate, open_truth
from sixthsense.auditing.pairing import (
    Align,
    Errors,
    aligned,
    check_is_not_the_truth,
    errors_of,
    paired,
    same_space,
    time_offset_s,
)
from sixthsense.auditing.poses import Frame, Poses
from sixthsense.auditing.result import Audit, axis_notes, read_as
from sixthsense.auditing.statistics import findings, is_other_frame
from sixthsense.config.errors import InputError


@dataclass(frozen=True, slots=True)
class _Compared:
    """One run beside its truth."""

    estimate: Poses
    truth: Poses
    errors: Errors
    other: Errors
    """with the covariances read in the other frame"""
    offset_s: float | None
    notes: tuple[str, ...]


def audit(
    estimate: Source | list[Source],
    truth: Source | list[Source] | None = None,
    *,
    covariance: str | Path | list[str | Path] | None = None,
    topic: str = "",
    truth_topic: str = "",
    truth_frames: tuple[str, str] | None = None,
    frame: Frame | None = None,
    order: Order = "translation",
    align: Align = "none",
    time_offset: float | None = None,
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
    covariance
        With a TUM file: the file with a stamp and the 6 or 21 numbers of the upper triangle in each line.
    topic, truth_topic, truth_frames
        In bags; by default the only topic with poses. "/tf" as truth takes the names of parent and child.
    frame
        "world", the default: the axes of the parent frame, as ROS has it; "body": those of the body.
    order
        "translation" or "rotation": which comes first in a covariance.
    align
        "none"; "first": the first pose becomes the true one, and its covariance counts; "all": the motion with the
        least sum of NEES, whose degrees of freedom are taken off.
    time_offset
        Search an offset of the stamps up to so many seconds, where the mean NEES is least.

    Raises
    ------
    InputError
        In one line, for files that cannot be read, covariances that are none, and poses that cannot be compared.

    """
    options = Options(topic, truth_topic, truth_frames, frame, order, align, time_offset)
    runs = [_compared(*one, options) for one in _matched(estimate, truth, covariance)]
    own, other = [run.errors for run in runs], [run.other for run in runs]
    if len({run.error.shape[1] for run in own}) > 1:
        raise InputError("estimate", "found runs in the plane and in space", "all in one of them")
    first, several = runs[0].estimate, len(runs) > 1
    read: Frame = first.frame or "world"
    found = findings(own, align, read)
    notes = [f"{run.estimate.name}: {note}" if several else note for run in runs for note in run.notes]
    notes += [*axis_notes(found), *_other_frame(own, other, align, read)]
    names = [f"{len(runs)} runs, the first {one.name}" if several else one.name for one in (first, runs[0].truth)]
    words = read_as(read, found.dof, order, frame is None and bool(first.frames[0]))
    offsets = tuple(run.offset_s for run in runs if run.offset_s is not None) or None
    return Audit(found, tuple(own), read, align, words, (names[0], names[1]), offsets, tuple(notes))


def _matched(
    estimate: Source | list[Source],
    truth: Source | list[Source] | None,
    covariance: str | Path | list[str | Path] | None,
) -> list[tuple[Source, Source | None, Path | None]]:
    """Each estimate with its truth and its file of covariances; InputError for another number of them."""
    estimates: Sequence[Source] = estimate if isinstance(estimate, list) else [estimate]
    truths: Sequence[Source | None] = truth if isinstance(truth, list) else [truth] * (truth is not None)
    files = covariance if isinstance(covariance, list) else [] if covariance is None else [covariance]
    if not estimates:
        raise InputError("estimate", "found none", "one or more")
    for name, count in (("truth", len(truths)), ("covariance", len(files))):
        if count not in (0, len(estimates)):
            raise InputError(name, f"found {count} for {len(estimates)} estimates", "one for each, in order")
    nothing = [None] * len(estimates)
    paths = [Path(file) for file in files]
    return list(zip(estimates, truths or nothing, paths or nothing, strict=True))


def _compared(source: Source, true: Source | None, covariance: Path | None, options: Options) -> _Compared:
    estimate = open_estimate(source, covariance, options)
    frame: Frame = estimate.frame or "world"
    estimate = replace(estimate, frame=frame)
    truth = open_truth(true, estimate, source, options)
    offset_s = None
    if options.time_offset is not None:
        plain = same_space(estimate, truth)
        offset_s = time_offset_s(plain[0], plain[1], options.time_offset, options.align, frame)
    pair = paired(estimate, truth, round(1e9 * (offset_s or 0.0)))
    check_is_not_the_truth(pair)
    motion = aligned(pair, options.align, frame)
    own, other = (errors_of(pair, motion, options.align, one) for one in (frame, _other(frame)))
    return _Compared(estimate, truth, own, other, offset_s, pair.notes)


def _other_frame(own: Sequence[Errors], other: Sequence[Errors], align: Align, frame: Frame) -> list[str]:
    if not is_other_frame(own, other):
        return []
    nees = findings(other, align, _other(frame)).nees
    return [
        f"the NEES depends on the heading: the covariances may have the axes of the {_other(frame)}, where the NEES is "
        f"{nees:.3g} (frame {_other(frame)})"
    ]


def _other(frame: Frame) -> Frame:
    return "body" if frame == "world" else "world"
