"""A picture with a slider, in a notebook."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


def slider(draw: Callable[[Any], Any], values: Sequence[Any], start: Any, label: str) -> None:
    """Display `draw(start)` below a slider over `values` that draws again; without ipywidgets the picture alone.

    Raises ValueError for a `start` that is none of the values. Needs IPython, as every notebook does.
    """
    from IPython import display as showing

    display: Any = showing.display
    if start not in values:
        raise ValueError(f"start: found {start!r}, allowed: {', '.join(map(str, values))}")
    try:
        from ipywidgets import SelectionSlider
    except ImportError:
        display(draw(start))
        return
    moved = SelectionSlider(options=list(values), value=start, description=label, continuous_update=False)
    display(moved)
    shown = display(draw(start), display_id=True)
    moved.observe(lambda change: shown.update(draw(change["new"])), names="value")
