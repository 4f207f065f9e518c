"""Figures as vectors for print, with layers of thousands of marks as pictures in them, so that files stay small."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

_MOST_MARKS = 500  # of one layer that stay vectors
_MOST_CORNERS = 20_000
_DPI = 200  # of what becomes a picture


def save_vectors(figure: Any, file: Path | str) -> None:
    """Write a figure as .svg or .pdf, the same bytes each time; the folder is made if it is missing."""
    from matplotlib import rc_context

    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    for artist in figure.findobj(_is_large):
        artist.set_rasterized(True)
    dateless = {"Date": None} if file.suffix == ".svg" else {"CreationDate": None}
    # Type 42 fonts: journals refuse the other kind.
    with rc_context({"pdf.fonttype": 42, "svg.hashsalt": "sixthsense"}):
        figure.savefig(file, dpi=_DPI, bbox_inches="tight", pad_inches=0.12, metadata=dateless)


def _is_large(artist: Any) -> bool:
    """Whether a layer has more marks, or a line more corners, than are worth keeping as vectors."""
    from matplotlib.collections import Collection
    from matplotlib.lines import Line2D

    if isinstance(artist, Collection):
        return bool(max(len(artist.get_paths()), np.shape(artist.get_offsets())[0]) > _MOST_MARKS)
    return isinstance(artist, Line2D) and np.size(artist.get_xdata()) > _MOST_CORNERS
