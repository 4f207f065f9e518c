"""`ss.audit`: its runs, opened, compared with the truth and pooled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sixthsense.auditing.hints import hints
from sixthsense.auditing.opening import Options, Order, Source, open_estimate, open_truth
from sixthsense.auditing.pairing import (
    Align,
    Errors,
    Offset,
    aligned,
    check_is_not_the_truth,
    errors_of,
    paired,
    same_space,
    time_offset,
)
from sixthsense.auditing.pairs import Hat, pair_findings, three_cornered_hat
from sixthsense.auditing.poses import Frame, Poses
from sixthsense.auditing.result import Audit, axis_notes, read_as
from sixthsense.auditing.scores import TrajectoryErrors, pooled, scores, trajectory_errors
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
    offset: Offset | None
    trajectory: TrajectoryErrors
    notes: tuple[str, ...]


_ORDINALS = ("first", "second", "third")  # names of systems that are arrays


def audit(
    estimate: Source | list[Source],
    truth: Source | list[Source] | None = None,
    *,
    pair: Source | list[Source] | None = None,
    covariance: str | Path | list[str | Path] | None = None,
    topic: str = "",
    pair_topic: str = "",
    truth_topic: str = "",
    truth_frames: tuple[str, str] | None = None,
    frame: Frame | None = None,
    order: Order = "translation",
    align: Align | None = None,
    time_offset: float | None = None,
) -> Audit:
    """Audit the covariances of any system: whether its errors against the truth are as large as it says.

        print(ss.audit("localization.mcap", "truth.tum", topic="/amcl_pose", align="all"))
        ss.audit((stamps_s, poses, covariances), (truth_stamps_s, truth_poses)).plot()
        print(ss.audit("cartographer.mcap", pair="amcl.mcap").verdict)

    Parameters
    ----------
    estimate
        A ROS bag with PoseWithCovarianceStamped or Odometry, a TUM file with `covariance`, the folder of a run, a run,
        or arrays: stamps in s; poses (N, 3) x y theta, (N, 7) x y z qx qy qz qw, or matrices; covariances (N, 3, 3) or
        (N, 6, 6). A list of them is pooled as independent runs.
    truth
        A bag, a TUM file, the folder of a run, a run, or arrays; a list for a list. By default that of the run.
    pair
        Without a truth: another system on the same drive, with covariances, in the forms of `estimate`; or two of them,
        so that each one's own factor can be told. At least one is overconfident if they differ by more than their
        covariances allow.
    covariance
        With a TUM file: the file with a stamp and the 6 or 21 numbers of the upper triangle in each line. With `pair` a
        list, that of the estimate first.
    topic, pair_topic, truth_topic, truth_frames
        In bags; by default the only topic with poses. "/tf" as truth takes the names of parent and child.
    frame
        "world", the default: the axes of the parent frame, as ROS has it; "body": those of the body.
    order
        "translation" or "rotation": which comes first in a covariance.
    align
        "none", the default without `pair`; "first": the first pose becomes the true one, and its covariance counts;
        "all", the default with `pair`: the motion with the least sum of NEES, whose degrees of freedom are taken off.
    time_offset
        Search an offset of the stamps up to so many seconds, where the mean NEES is least.

    Raises
    ------
    InputError
        In one line, for files that cannot be read, covariances that are none, and poses that cannot be compared.

    """
    options = Options(topic, pair_topic, truth_topic, truth_frames, frame, order, align, time_offset)
    if pair is not None:
        if truth is not None or isinstance(estimate, list):
            raise InputError("pair", "found beside a truth or several estimates", "one estimate, and no truth")
        return _audit_pair([estimate, *(pair if isinstance(pair, list) else [pair])], covariance, options)
    return _audit_truth([_compared(*one, options) for one in _matched(estimate, truth, covariance)], options)


def _audit_truth(runs: list[_Compared], options: Options) -> Audit:
    """The audit of runs beside their truths, which are pooled."""
    align = options.align or "none"
    own, other = [run.errors for run in runs], [run.other for run in runs]
    if len({run.error.shape[1] for run in own}) > 1:
        raise InputError("estimate", "found runs in the plane and in space", "all in one of them")
    first, several = runs[0].estimate, len(runs) > 1
    read: Frame = first.frame or "world"
    found = findings(own, align, read)
    notes = [f"{run.estimate.name}: {note}" if several else note for run in runs for note in run.notes]
    notes += [*axis_notes(found), *_other_frame(own, other, align, read)]
    names = [f"{len(runs)} runs, the first {one.name}" if several else one.name for one in (first, runs[0].truth)]
    words = read_as(read, found.dof, options.order, options.frame is None and bool(first.frames[0]))
    offsets = tuple(run.offset.seconds for run in runs if run.offset is not None) or None
    trajectory = pooled([(len(run.truth), run.trajectory) for run in runs])
    return Audit(
        found, scores(own), tuple(own), read, align, words, (names[0], names[1]), offsets, tuple(notes), trajectory
    )


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
    return _side_by_side(estimate, truth, options.align or "none", options)


def _side_by_side(estimate: Poses, truth: Poses, align: Align, options: Options) -> _Compared:
    frame: Frame = estimate.frame or "world"
    offset, offset_s = None, 0.0
    if options.time_offset is not None:
        plain = same_space(estimate, truth)
        offset = time_offset(plain[0], plain[1], options.time_offset, align, frame)
        offset_s = offset.seconds
    pair = paired(estimate, truth, round(1e9 * offset_s))
    check_is_not_the_truth(pair)
    motion = aligned(pair, align, frame)
    own, other = (errors_of(pair, motion, align, one) for one in (frame, _other(frame)))
    trajectory = trajectory_errors(pair)
    notes = (*pair.notes, *hints(pair, align), *_of_offset(offset))
    return _Compared(estimate, pair.truth, own, other, offset, trajectory, notes)


def _of_offset(offset: Offset | None) -> list[str]:
    if offset is None:
        return []
    return [
        f"the offset is {1e3 * offset.seconds:+.1f} ms with a sigma of {1e3 * offset.sigma_s:.1f} ms; an error along "
        f"the way of {1e3 * offset.along_m:.0f} mm at the mean speed would look the same, and is taken off with it"
    ]


def _audit_pair(sources: list[Source], covariance: str | Path | list[str | Path] | None, options: Options) -> Audit:
    """The audit of two systems, or three, by each other."""
    if len(sources) not in (2, 3):
        raise InputError("pair", f"found {len(sources) - 1}", "one system or two")
    align = options.align or "all"
    if align == "first":
        raise InputError("align", "found first with `pair`", "none or all")
    of_pair = replace(options, topic=options.pair_topic or options.topic)
    systems = [
        replace(found, frame=found.frame or "world", name=_ORDINALS[k] if found.name == "estimate" else found.name)
        for k, (source, _, file) in enumerate(_matched(sources, None, covariance))
        for found in [open_estimate(source, file, of_pair if k else options)]
    ]
    first = _side_by_side(systems[0], systems[1], align, options)
    read: Frame = systems[0].frame or "world"
    found = findings([first.errors], align, read)
    assert first.errors.of_estimate is not None
    hats = () if len(systems) == 2 else _hats(systems, align, options)
    judged = pair_findings(found, first.errors, first.errors.of_estimate, first.truth.positions, hats)
    words = read_as(read, found.dof, options.order, options.frame is None and bool(systems[0].frames[0]))
    names = systems[0].name, " and ".join(system.name for system in systems[1:])
    offsets = None if first.offset is None else (first.offset.seconds,)
    judged_by, told = scores([first.errors]), (first.errors,)
    return Audit(found, judged_by, told, read, align, words, names, offsets, first.notes, None, judged)


def _hats(systems: list[Poses], align: Align, options: Options) -> tuple[Hat, ...]:
    """The factors of three systems, from the differences of two from the first at the stamps that all have."""
    at_second = paired(systems[1], systems[2]).truth
    second, third = (_side_by_side(one, systems[0], align, options).errors for one in (systems[1], at_second))
    second, third = second.at(third.stamps_ns), third.at(second.stamps_ns)
    assert second.of_estimate is not None and third.of_estimate is not None
    covs = second.cov - second.of_estimate, second.of_estimate, third.of_estimate
    return three_cornered_hat(second, third, covs)


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
