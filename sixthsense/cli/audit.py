"""`sixthsense audit`."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Annotated, Literal

from sixthsense.cli import DONE, FAILED
from sixthsense.cli.options import Arg, Options, Table
from sixthsense.config.errors import InputError

_FORMS = (".png", ".svg", ".pdf")


class Audit(Options):
    """Compare the covariances of a system's poses with its errors.

    Poses of any system, with covariances, are compared with the truth. The answer is the NEES with its band, and the
    factor by which the covariance should be multiplied. Errors along a trajectory are correlated: band and interval
    come from the effective number of samples.
    """

    estimate: Annotated[tuple[str, ...], Arg("ESTIMATE ...", is_positional=True)] = ()
    """ROS bag with PoseWithCovarianceStamped or Odometry; TUM file with --covariance; folder of a run. Several are
    pooled as independent runs."""
    truth: Annotated[tuple[str, ...], Arg("FILE ...")] = ()
    """Bag, TUM file or folder of a run, one for each estimate. By default that of the run."""
    pair: Annotated[str | None, Arg("FILE")] = None
    """Without a truth: another system on the same drive, in the forms of ESTIMATE."""
    covariance: Annotated[tuple[str, ...], Arg("FILE ...")] = ()
    """Covariances of TUM files: in each line a stamp and the 6 or 21 numbers of the upper triangle. With --pair one for
    each system, the estimate's first."""
    topic: str = ""
    """Topic of the estimate in a bag, if there are several."""
    pair_topic: str = ""
    """Topic of the other systems; by default as --topic."""
    truth_topic: str = ""
    """Topic of the truth in a bag, if there are several."""
    frame: Literal["world", "body"] | None = None
    """Whose axes the covariances have; by default the world's, as ROS has it."""
    order: Literal["translation", "rotation"] = "translation"
    """Which comes first in a covariance."""
    align: Literal["none", "all"] | None = None
    """none, the default without --pair. all: by all poses, the degrees of freedom are taken off."""
    time_offset: float = 0.0
    """Seconds to add to the stamps of the estimate."""
    same_start: bool = False
    """Both begin together, by other clocks: stamps count from the first pose of each."""
    figure: Path | None = None
    """Draw errors in their 3-sigma tubes, NEES with its band and chi-square Q-Q: .png, .svg or .pdf."""
    numbers: Annotated[Path | None, Arg("FILE", flag="json")] = None
    """Write all numbers; a page with figures for a file that ends in .html."""
    overwrite: bool = False
    """Replace these files if they exist."""
    require: Literal["consistent"] | None = None
    """Exit code 1 unless the verdict is consistent."""

    def run(self, flags: Table) -> int:
        """Audit the covariances of a system's poses."""
        if not self.estimate:
            raise InputError("estimate", "found nothing", "a bag, a TUM file or the folder of a run, before `truth`")
        _check_outputs(self)
        from sixthsense.auditing.call import audit

        given = self.model_dump(include=set(inspect.signature(audit).parameters) - {"estimate"})
        lists = {"truth": list(self.truth) or None, "covariance": list(self.covariance) or None}
        found = audit(self.estimate[0] if len(self.estimate) == 1 else list(self.estimate), **{**given, **lists})
        print(found)
        if self.numbers is not None:
            found.save(self.numbers)
            print(f"written: {self.numbers}")
        if self.figure is not None:
            found.plot().savefig(self.figure, dpi=150)
            print(f"written: {self.figure}")
        return FAILED if self.require and found.outcome != self.require else DONE


def _check_outputs(options: Audit) -> None:
    """Raise InputError for a file that exists and may not be replaced, and for a figure of another form."""
    for name, file in (("json", options.numbers), ("figure", options.figure)):
        if file is not None and file.exists() and not options.overwrite:
            raise InputError(name, f"{file} exists", "a new file, or `overwrite`")
    figure = options.figure
    if figure is not None and figure.suffix.lower() not in _FORMS:
        raise InputError("figure", f"found {str(figure)!r}", f"a file that ends in {', '.join(_FORMS)}")
