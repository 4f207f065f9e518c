"""`Run`, the result of `ss.run`, `ss.replay` and `ss.load`, with its figures."""

from __future__ import annotations

import base64
import html
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.config.files import path_of
from sixthsense.evaluation.measured_run import MeasuredRun
from sixthsense.record.trace import Trace

if TYPE_CHECKING:
    from sixthsense.evaluation.curves import Over

__all__ = ["Run", "Trace", "load"]


class Run(MeasuredRun):
    """The result of `ss.run`, `ss.replay` and `ss.load`: a record with metrics and figures, computed on demand.

    It prints as its summary. A notebook displays it as its map with that summary.
    """

    def plot(self, what: str = "map", *, over: Over = "time", ax: Any = None) -> Any:
        """A figure of the run: "map", "error", "rpe", "nees", "nis", "stages", "coverage" or "exploration".

        The result is a matplotlib figure, which a notebook displays, and which `.savefig(file)` writes. "error" and
        "nees" can be drawn `over` "distance" travelled. On `ax`, one Axes or as many as the figure has panels, it is
        drawn in place without a title, and the axes are returned; on one Axes, "error" and "rpe" draw their main panel.

        Raises InputError with the allowed names for any other name, for another number of axes, and for a figure whose
        data the run lacks, such as errors without truth.
        """
        from sixthsense.figures.kinds import plot

        return plot(what, [self.sample(self.name)], None, ax, over)

    def _repr_html_(self) -> str:
        from sixthsense.figures.plot import map_figure

        picture = base64.b64encode(map_figure(self.trace, "", 5.0, legend=False).png(dpi=70.0)).decode()
        lines = "".join(f"<tr><th>{name}</th><td>{html.escape(text)}</td></tr>" for name, text in self.summary.items())
        return (
            f"<div><b>{html.escape(self.title)}</b><br>"
            f'<img alt="map" src="data:image/png;base64,{picture}"><table>{lines}</table></div>'
        )


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
