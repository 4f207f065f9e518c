"""New figures and their axes, legends, and sliders of notebooks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from sixthsense.figures.plot import new_figure

if TYPE_CHECKING:
    from sixthsense.core.picture import Picture

_SHORT_M = 0.1  # lengths below are read in millimetres
_LETTERS_PER_IN = 12  # of a legend


def new_axes(rows: int, columns: int, width_in: float, height_in: float, **share: Any) -> tuple[Picture, list[Any]]:
    """A new figure and its axes, row by row; `sharex` and `sharey` as of matplotlib's `subplots`."""
    figure = new_figure(width_in, height_in)
    return figure, list(figure.subplots(rows, columns, squeeze=False, **share).ravel())


def legend(figure: Any, columns: int = 6) -> Any:
    """Add one legend for all axes below them, and return the figure."""
    entries = {
        label: handle for ax in figure.axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    figure.legend(entries.values(), entries, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def columns_for(ax: Any, panels: int = 1) -> int:
    """Columns of a legend with the names of a panel, in the width of a figure with so many panels side by side."""
    longest = max(map(len, ax.get_legend_handles_labels()[1]), default=0)
    return max(1, min(4, int(_LETTERS_PER_IN * ax.figure.get_figwidth() / panels) // (longest + 8)))


def legend_above(ax: Any) -> None:
    """Add the legend of one panel above it, without a box; one that is wider would push the others aside."""
    above = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2}
    ax.legend(ncols=columns_for(ax, ax.get_gridspec().ncols), frameon=False, fontsize="small", **above)


def in_millimetres(ax: Any) -> None:
    """Label the vertical axis in millimetres, if it is one of metres and all of it is below 0.1 m."""
    from matplotlib.ticker import Formatter

    label, most = ax.get_ylabel(), max(map(abs, ax.get_ylim()))
    if label.endswith("[m]") and label != "y [m]" and most < _SHORT_M:
        ax.set_ylabel(label.removesuffix("[m]") + "[mm]")
        ax.yaxis.set_major_formatter(lambda value, _: Formatter.fix_minus(f"{1e3 * value:.4g}"))


def slider(draw: Callable[[Any], Any], values: Sequence[Any], start: Any, label: str) -> None:
    """Display `draw(start)` below a slider over `values` that draws again; without ipywidgets the picture alone.

    Needs IPython, as every notebook does.
    """
    from IPython import display as showing

    display: Any = showing.display
    try:
        from ipywidgets import SelectionSlider
    except ImportError:
        display(draw(start))
        return
    moved = SelectionSlider(options=list(values), value=start, description=label, continuous_update=False)
    display(moved)
    shown = display(draw(start), display_id=True)
    moved.observe(lambda change: shown.update(draw(change["new"])), names="value")
