"""`Run`, the result of `ss.run`, `ss.replay` and `ss.load`, with its figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, overload

from sixthsense.config.files import path_of
from sixthsense.evaluation.measured_run import MeasuredRun
from sixthsense.record.trace import Trace

if TYPE_CHECKING:
    from sixthsense.core.picture import Picture
    from sixthsense.evaluation.curves import Over
    from sixthsense.figures.canvas import OnAxes

__all__ = ["Run", "Trace", "load"]


class Run(MeasuredRun):
    """The result of `ss.run`, `ss.replay` and `ss.load`: a record with metrics and figures, computed on demand.

    A notebook displays it as its map with the most important metrics.
    """

    @overload
    def plot(self, what: str = "map", *, over: Over = "time", ax: None = None) -> Picture: ...
    @overload
    def plot(self, what: str = "map", *, over: Over = "time", ax: OnAxes) -> None: ...
    def plot(self, what: str = "map", *, over: Over = "time", ax: OnAxes | None = None) -> Picture | None:
        """A figure of the run: "map", "error", "rpe", "nees", "nis", "stages", "coverage" or "exploration".

        The result is a matplotlib figure, which a notebook displays, and which `.savefig(file)` writes. "error" and
        "nees" can be drawn `over` "distance" travelled. On `ax`, one Axes or as many as the figure has panels, it is
        drawn in place and nothing is returned; on one Axes, "error", "nees" and "rpe" draw their main panel alone.

        Raises InputError with the allowed names for any other name, for another number of axes, and for a figure whose
        data the run lacks, such as errors without truth.
        """
        from sixthsense.figures.panels import figure

        return figure(what, [self], over, ax)

    def _repr_html_(self) -> str:
        from sixthsense.figures.panels import card

        return card(self)


def load(folder: str | Path) -> Run:
    """Load a run from its folder, or from the `.partial` folder of a killed run, without estimating again.

        run = ss.load("runs/first")

    Estimates, truth, innovations, times, plans, map and metrics are those that the run recorded. The folder of a killed
    run may be incomplete; `Run.missing` lists the missing parts. `ss.replay(folder)`
    estimates again from the recorded sensor data.

    Raises
    ------
    InputError
        For a folder that is not a run folder or has no record, and for a damaged file, with its line.

    """
    return Run.read(path_of("folder", folder))
