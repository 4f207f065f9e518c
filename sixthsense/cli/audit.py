"""`sixthsense audit`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from sixthsense.cli.common import wants_help
from sixthsense.cli.exits import DONE, FAILED
from sixthsense.cli.options import OptionalValue, UsageError, parse_positionals
from sixthsense.cli.shown import arg

USAGE = """\
usage: sixthsense audit ESTIMATE ... [--truth TRUTH ...] [options]

Are the covariances of a system's poses as large as its errors? Poses of any
system, with covariances, are compared with the truth. The answer is the NEES
with its band, and the factor by which the covariance should be multiplied.
Errors along a trajectory are correlated: band and interval come from the
effective number of samples.

  ESTIMATE              ROS bag with PoseWithCovarianceStamped or Odometry; TUM
                        file with --covariance; folder of a run. Several are
                        pooled as independent runs.
  --truth FILE ...      Bag, TUM file or folder of a run, one for each estimate.
                        By default that of the run.
  --covariance FILE ... Of TUM files: in each line a stamp and the 6 or 21
                        numbers of the upper triangle.
  --topic NAME          Of the estimate in a bag, if there are several.
  --truth-topic NAME    Of the truth in a bag: a topic of poses, or /tf.
  --truth-frames PARENT CHILD
                        In /tf; by default those that the estimate names.
  --frame world|body    Whose axes the covariances have; by default the world's,
                        as ROS has it.
  --order translation|rotation
                        Which comes first in a covariance; by default the
                        translation.
  --align none|first|all
                        By default none. first: the first pose becomes the true
                        one, and its covariance counts. all: by all poses, the
                        degrees of freedom are taken off.
  --time-offset [S]     Search an offset of the stamps up to S seconds (1).
  --figure FILE         Draw errors in their 3-sigma tubes, NEES with its band
                        and chi-square Q-Q: .png, .svg or .pdf.
  --json FILE           Write all numbers.
  --overwrite           Replace these files if they exist.
  --require consistent  Exit code 1 unless the verdict is consistent.
"""

_Files = tuple[tuple[str], ...]
OWN: dict[str, Any] = {
    "truth": Annotated[_Files, arg(metavar="FILE")],
    "covariance": Annotated[_Files, arg(metavar="FILE")],
    "topic": str,
    "truth-topic": str,
    "truth-frames": Annotated[tuple[str, str], arg(metavar="PARENT CHILD")],
    "frame": Literal["world", "body"],
    "order": Literal["translation", "rotation"],
    "align": Literal["none", "first", "all"],
    "time-offset": Annotated[float, arg(metavar="S")],
    "figure": Path,
    "json": Path,
    "overwrite": bool,
    "require": Literal["consistent"],
}

_FORMS = (".png", ".svg", ".pdf")


def command(args: list[str]) -> int:
    """Audit the covariances of a system's poses."""
    if wants_help(args):
        print(USAGE, end="")
        return DONE
    offset = OptionalValue("1", _is_number, "seconds, above 0")
    estimates, given = parse_positionals(args, {**OWN, "time-offset": offset})
    if not estimates:
        raise UsageError("estimate: found nothing, allowed: a bag, a TUM file or the folder of a run, before --truth")
    wanted = given.get("require", "consistent")
    if wanted != "consistent":
        raise UsageError(f"--require: found {wanted!r}, allowed: consistent")
    if "time-offset" in given and not _is_number(given["time-offset"]):
        raise UsageError(f"--time-offset: found {given['time-offset']!r}, allowed: seconds, above 0")
    _check_outputs(given)
    from sixthsense.auditing.call import audit

    found = audit(
        list(estimates),
        [file for (file,) in given["truth"]] if "truth" in given else None,
        covariance=[file for (file,) in given["covariance"]] if "covariance" in given else None,
        topic=given.get("topic", ""),
        truth_topic=given.get("truth-topic", ""),
        truth_frames=tuple(given["truth-frames"]) if "truth-frames" in given else None,
        frame=given.get("frame"),
        order=given.get("order", "translation"),
        align=given.get("align", "none"),
        time_offset=float(given["time-offset"]) if "time-offset" in given else None,
    )
    print(found)
    if "json" in given:
        found.save(given["json"])
        print(f"written: {given['json']}")
    if "figure" in given:
        found.plot().savefig(given["figure"], dpi=150)
        print(f"written: {given['figure']}")
    return FAILED if "require" in given and found.outcome != "consistent" else DONE


def _check_outputs(given: dict[str, Any]) -> None:
    """Raise UsageError for a file that exists and may not be replaced, and for a figure of another form."""
    for name in ("json", "figure"):
        file: Path | None = given.get(name)
        if file is not None and file.exists() and not given.get("overwrite", False):
            raise UsageError(f"--{name}: {file} exists, allowed: a new file, or --overwrite")
    figure: Path | None = given.get("figure")
    if figure is not None and figure.suffix.lower() not in _FORMS:
        raise UsageError(f"--figure: found {str(figure)!r}, allowed: a file that ends in {', '.join(_FORMS)}")


def _is_number(text: str) -> bool:
    try:
        return float(text) > 0.0
    except ValueError:
        return False
