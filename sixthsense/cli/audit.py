"""`sixthsense audit`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from sixthsense.cli import DONE, FAILED
from sixthsense.cli.options import OptionalValue, Options, arg, parse, positional
from sixthsense.config import Range
from sixthsense.config.errors import InputError

_FORMS = (".png", ".svg", ".pdf")


def _is_number(text: str) -> bool:
    try:
        return float(text) > 0.0
    except ValueError:
        return False


@dataclass(frozen=True)
class Audit(Options):
    """Compare the covariances of a system's poses with its errors.

    Poses of any system, with covariances, are compared with the truth. The answer is the NEES with its band, and the
    factor by which the covariance should be multiplied. Errors along a trajectory are correlated: band and interval
    come from the effective number of samples.
    """

    estimate: Annotated[tuple[str, ...], positional("ESTIMATE ...")] = ()
    """ROS bag with PoseWithCovarianceStamped or Odometry; TUM file with --covariance; folder of a run. Several are
    pooled as independent runs."""
    truth: Annotated[tuple[str, ...], arg("FILE ...")] = ()
    """Bag, TUM file or folder of a run, one for each estimate. By default that of the run."""
    pair: Annotated[str | None, arg("FILE")] = None
    """Without a truth: another system on the same drive, in the forms of ESTIMATE."""
    covariance: Annotated[tuple[str, ...], arg("FILE ...")] = ()
    """Covariances of TUM files: in each line a stamp and the 6 or 21 numbers of the upper triangle. With --pair one for
    each system, the estimate's first."""
    topic: str = ""
    """Topic of the estimate in a bag, if there are several."""
    pair_topic: str = ""
    """Topic of the other systems; by default as --topic."""
    truth_topic: str = ""
    """Topic of the truth in a bag: one of poses, or /tf."""
    truth_frames: Annotated[tuple[str, str] | None, arg("PARENT CHILD")] = None
    """In /tf; by default those that the estimate names."""
    frame: Literal["world", "body"] | None = None
    """Whose axes the covariances have; by default the world's, as ROS has it."""
    order: Literal["translation", "rotation"] = "translation"
    """Which comes first in a covariance."""
    align: Literal["none", "first", "all"] | None = None
    """none, the default without --pair. first: the first pose becomes the true one, and its covariance counts. all: by
    all poses, the degrees of freedom are taken off."""
    time_offset: Annotated[
        Annotated[float, Range(0.0, open_low=True)] | None,
        arg("[S]"),
        OptionalValue("1", _is_number, "seconds, above 0"),
    ] = None
    """Search an offset of the stamps up to S seconds (1)."""
    same_start: bool = False
    """Both begin together, by other clocks: stamps count from the first pose of each."""
    figure: Path | None = None
    """Draw errors in their 3-sigma tubes, NEES with its band and chi-square Q-Q: .png, .svg or .pdf."""
    json: Path | None = None
    """Write all numbers; a page with figures for a file that ends in .html."""
    overwrite: bool = False
    """Replace these files if they exist."""
    validate: bool = False
    """Only say what cannot be right in the estimates, without a truth: exit code 1 if something cannot."""
    require: Literal["consistent"] | None = None
    """Exit code 1 unless the verdict is consistent."""

    @classmethod
    def main(cls, args: list[str]) -> int:
        """Audit the covariances of a system's poses."""
        options = Audit(**parse(args, Audit)[0])
        if not options.estimate:
            raise InputError("estimate", "found nothing", "a bag, a TUM file or the folder of a run, before `truth`")
        _check_outputs(options)
        from sixthsense.auditing.call import audit

        if options.validate:
            return _validated(options)
        found = audit(
            options.estimate[0] if len(options.estimate) == 1 else list(options.estimate),
            list(options.truth) or None,
            pair=options.pair,
            covariance=list(options.covariance) or None,
            topic=options.topic,
            pair_topic=options.pair_topic,
            truth_topic=options.truth_topic,
            truth_frames=options.truth_frames,
            frame=options.frame,
            order=options.order,
            align=options.align,
            time_offset=options.time_offset,
            same_start=options.same_start,
        )
        print(found)
        if options.json is not None:
            found.save(options.json)
            print(f"written: {options.json}")
        if options.figure is not None:
            found.plot().savefig(options.figure, dpi=150)
            print(f"written: {options.figure}")
        return FAILED if options.require and found.outcome != options.require else DONE


def _validated(options: Audit) -> int:
    """Print what cannot be right in each estimate, or that nothing was found."""
    from sixthsense.auditing.mistakes import WRONG
    from sixthsense.auditing.opening import Options as Reading
    from sixthsense.auditing.opening import open_estimate

    code = DONE
    files: list[Path | None] = [Path(file) for file in options.covariance] or [None] * len(options.estimate)
    if len(files) != len(options.estimate):
        raise InputError("covariance", f"found {len(files)} for {len(options.estimate)} estimates", "one for each")
    for source, file in zip(options.estimate, files, strict=True):
        poses = open_estimate(source, file, Reading(options.topic, frame=options.frame, order=options.order))
        wrong = [note for note in poses.notes if note.startswith(WRONG)]
        for line in poses.notes or ("nothing found that cannot be right",):
            print(f"{poses.name}: {line}")
        code = FAILED if wrong else code
    return code


def _check_outputs(options: Audit) -> None:
    """Raise InputError for a file that exists and may not be replaced, and for a figure of another form."""
    for name, file in (("json", options.json), ("figure", options.figure)):
        if file is not None and file.exists() and not options.overwrite:
            raise InputError(name, f"{file} exists", "a new file, or `overwrite`")
    figure = options.figure
    if figure is not None and figure.suffix.lower() not in _FORMS:
        raise InputError("figure", f"found {str(figure)!r}", f"a file that ends in {', '.join(_FORMS)}")
