"""`ss.audit`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sixthsense.auditing.opening import Source
from sixthsense.auditing.options import Options, Order
from sixthsense.auditing.pairing import Align
from sixthsense.auditing.pooled import Given, audited
from sixthsense.auditing.poses import AuditError, Frame
from sixthsense.auditing.result import Audit


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
    return audited(_matched(estimate, truth, covariance), options)


def _matched(
    estimate: Source | list[Source],
    truth: Source | list[Source] | None,
    covariance: str | Path | list[str | Path] | None,
) -> list[Given]:
    """Each estimate with its truth and its file of covariances; AuditError for another number of them."""
    estimates: Sequence[Source] = estimate if isinstance(estimate, list) else [estimate]
    truths: Sequence[Source | None] = truth if isinstance(truth, list) else [truth] * (truth is not None)
    files = covariance if isinstance(covariance, list) else [] if covariance is None else [covariance]
    if not estimates:
        raise AuditError("estimate: found none, allowed: one or more")
    for name, count in (("truth", len(truths)), ("covariance", len(files))):
        if count not in (0, len(estimates)):
            raise AuditError(f"{name}: found {count} for {len(estimates)} estimates, allowed: one for each, in order")
    nothing = [None] * len(estimates)
    paths = [Path(file) for file in files]
    return [Given(*one) for one in zip(estimates, truths or nothing, paths or nothing, strict=True)]
