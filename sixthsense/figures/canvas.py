"""Where a figure is drawn: a new picture, or axes that the caller has."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.figures.picture import Picture
from sixthsense.figures.plot import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    OnAxes = Axes | Sequence[Axes] | NDArray[Any]

WIDTH_IN = 11.0
"""of most figures"""


class FigureError(InputError):
    """A figure that cannot be drawn: one line with its name, what was found and what is allowed."""


class Canvas:
    """A picture that is made when its panels are asked for, or the caller's axes in its place."""

    def __init__(self, what: str, ax: Any = None) -> None:
        """Of the figure named `what`; `ax` is one Axes of matplotlib or several, None for a new picture."""
        self.what = what
        self.given = None if ax is None else _axes(ax)
        self.picture: Picture | None = None

    @property
    def is_one(self) -> bool:
        """Whether the caller has given a single Axes, on which some figures draw their main panel alone."""
        return self.given is not None and len(self.given) == 1

    def panels(self, rows: int, columns: int, width_in: float, height_in: float, **share: Any) -> list[Any]:
        """The axes of the figure, row by row; FigureError if the caller has given another number of them."""
        if self.given is None:
            self.picture = new_figure(width_in, height_in)
            return list(self.picture.subplots(rows, columns, squeeze=False, **share).ravel())
        if len(self.given) != rows * columns:
            raise FigureError(f"ax: found {len(self.given)} axes for {self.what}, allowed: {rows * columns}")
        return self.given

    def entitle(self, title: str, subtitle: str = "") -> None:
        """Write the title over the picture; on the caller's axes a short one over the first, if it has none."""
        if self.given is None:
            assert self.picture is not None
            self.picture.suptitle(f"{title}\n{subtitle}" if subtitle else title, fontsize=10.5 if subtitle else 12.0)
        elif not self.given[0].get_title():
            short = [title.partition(":")[0], subtitle.partition(" — ")[0]] if subtitle else [title]
            self.given[0].set_title("\n".join(short), fontsize=9)

    def label(self, ax: Any) -> None:
        """Add the legend of one panel: above it in a picture, inside on the caller's axes."""
        names = ax.get_legend_handles_labels()[1]
        if not names:
            return
        if self.given is not None:
            ax.legend(frameon=False, fontsize="small")
            return
        columns = max(1, min(4, 120 // (max(map(len, names)) + 8)))
        ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, frameon=False, borderaxespad=0.2)

    def label_below(self, panels: list[Any]) -> None:
        """Add one legend for all panels: below them in a picture, inside the first of the caller's axes."""
        if self.picture is None:
            self.label(panels[0])
            return
        entries = {name: handle for ax in panels for handle, name in zip(*ax.get_legend_handles_labels(), strict=True)}
        columns = max(1, min(5, 130 // (max(map(len, entries), default=0) + 8)))
        self.picture.legend(entries.values(), entries, loc="outside lower center", ncols=columns, frameon=False)


def check_over(what: str, over: str, kinds: Sequence[str]) -> None:
    """Raise FigureError for a figure that is not of these kinds, and for an axis that it is not drawn over."""
    if what not in kinds:
        raise FigureError(f"what: found {shown(what)}, {allowed_names(kinds, nearest(what, kinds))}")
    axes = ("time", "distance") if what in ("error", "nees") else ("time",)
    if over not in axes:
        raise FigureError(f"over: found {shown(over)} for {what}, allowed: {', '.join(axes)}")


def _axes(ax: Any) -> list[Any]:
    """The caller's axes as a list; FigureError for anything else."""
    found = list(ax.ravel()) if hasattr(ax, "ravel") else list(ax) if isinstance(ax, Iterable) else [ax]
    if not found or not all(hasattr(one, "get_legend_handles_labels") for one in found):
        raise FigureError(f"ax: found {shown(ax)}, allowed: Axes of matplotlib, one or several")
    return found
