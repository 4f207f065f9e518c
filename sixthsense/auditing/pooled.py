"""The runs of an audit, opened, compared with the truth and pooled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from sixthsense.auditing.offset import time_offset_s
from sixthsense.auditing.opening import Source, open_estimate, open_truth
from sixthsense.auditing.options import Options
from sixthsense.auditing.pairing import Errors, aligned, check_is_not_the_truth, errors_of, paired, same_space
from sixthsense.auditing.poses import AuditError, Frame, Poses
from sixthsense.auditing.result import Audit
from sixthsense.auditing.statistics import findings, is_other_frame
from sixthsense.auditing.wording import axis_notes, read_as


class Given(NamedTuple):
    """An estimate with what belongs to it."""

    estimate: Source
    """as the caller gave it"""
    truth: Source | None
    """None: that of the run"""
    covariance: Path | None
    """of a TUM file"""


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


def audited(given: Sequence[Given], options: Options) -> Audit:
    """Audit at least one run; AuditError for runs of which some are planar and some are not."""
    runs = [_compared(one, options) for one in given]
    own, other = [run.errors for run in runs], [run.other for run in runs]
    if len({run.error.shape[1] for run in own}) > 1:
        raise AuditError("estimate: found runs in the plane and in space, allowed: all in one of them")
    first = runs[0].estimate
    frame: Frame = first.frame or "world"
    found = findings(own, options.align, frame)
    several = len(runs) > 1
    notes = [f"{run.estimate.name}: {note}" if several else note for run in runs for note in run.notes]
    notes += [*axis_notes(found), *_other_frame(own, other, options, frame)]
    names = [f"{len(runs)} runs, the first {one.name}" if several else one.name for one in (first, runs[0].truth)]
    words = read_as(frame, found.dof, options.order, options.frame is None and bool(first.frames[0]))
    offsets = tuple(run.offset_s for run in runs if run.offset_s is not None) or None
    return Audit(found, tuple(own), frame, options.align, words, (names[0], names[1]), offsets, tuple(notes))


def _compared(given: Given, options: Options) -> _Compared:
    estimate = open_estimate(given.estimate, given.covariance, options)
    frame: Frame = estimate.frame or "world"
    estimate = replace(estimate, frame=frame)
    truth = open_truth(given.truth, estimate, given.estimate, options)
    offset_s = None
    if options.time_offset is not None:
        plain = same_space(estimate, truth)
        offset_s = time_offset_s(plain[0], plain[1], options.time_offset, options.align, frame)
    pair = paired(estimate, truth, round(1e9 * (offset_s or 0.0)))
    check_is_not_the_truth(pair)
    motion = aligned(pair, options.align, frame)
    own, other = (errors_of(pair, motion, options.align, one) for one in (frame, _other(frame)))
    return _Compared(estimate, truth, own, other, offset_s, pair.notes)


def _other_frame(own: Sequence[Errors], other: Sequence[Errors], options: Options, frame: Frame) -> list[str]:
    if not is_other_frame(own, other):
        return []
    nees = findings(other, options.align, _other(frame)).nees
    return [
        f"the NEES depends on the heading: the covariances may have the axes of the {_other(frame)}, where the NEES is "
        f"{nees:.3g} (frame {_other(frame)})"
    ]


def _other(frame: Frame) -> Frame:
    return "body" if frame == "world" else "world"
