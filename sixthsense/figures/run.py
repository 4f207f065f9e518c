"""A run that draws itself: what `ss.run`, `ss.replay` and `ss.load` return."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.evaluation.measured_run import MeasuredRun
from sixthsense.record.trace import Trace

if TYPE_CHECKING:
    from sixthsense.figures.picture import Picture

__all__ = ["Run", "Trace", "load"]


class Run(MeasuredRun):
    """What `ss.run`, `ss.replay` and `ss.load` return: a record that is measured and drawn on demand.

    In a notebook it shows its map and the metrics that matter most.
    """

    def plot(self, what: str = "map") -> Picture:
        """A figure of the run: "map", "error", "nees", "nis", "stages", "coverage" or "exploration".

        It is one of matplotlib's, shows itself at the end of a notebook's cell, and is written by `.savefig(file)`.
        Raises FigureError, listing what there is, for any other name, and for a figure that this run cannot fill, as
        errors without truth.
        """
        from sixthsense.figures.panels import figure

        return figure(what, [self])

    def __getattr__(self, name: str) -> Any:
        """Attributes of the record, for one version."""
        if name.startswith("_") or name == "trace":
            raise AttributeError(name)
        value = getattr(self.trace, name)
        warnings.warn(f"run.{name} is deprecated, use run.trace.{name}", DeprecationWarning, stacklevel=2)
        return value

    def _repr_html_(self) -> str:
        from sixthsense.figures.panels import card

        return card(self)


def load(folder: str | Path) -> Run:
    """Read a run from its folder, or from the `.partial` that a killed run has left, without estimating again.

        run = ss.load("runs/first")

    Estimates, truth, innovations, times, plans and the map are those that the run recorded, its metrics those that it
    measured. Of a killed run, and of a folder that an earlier version wrote, there is less: `Run.missing` says what is
    not there. `ss.replay(folder)` estimates again from the recorded evidence.

    Raises
    ------
    InputError
        For a folder that is no run's or has recorded nothing, and for a damaged file, naming its line.

    """
    return Run.read(folder)


def _load_of_trace(cls: type[Trace], folder: str | Path) -> Run:
    """Read a run, as `ss.load` does, which has taken this method's place."""
    warnings.warn("ss.Trace.load is deprecated, use ss.load", DeprecationWarning, stacklevel=2)
    return load(folder)


Trace.load = classmethod(_load_of_trace)  # type: ignore[attr-defined]
