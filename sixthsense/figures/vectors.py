"""Figures as vector graphics for print, with large layers rasterised to keep files small."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

_MOST_MARKS = 500  # in a vector layer
_MOST_CORNERS = 20_000  # in a vector line
_DPI = 200  # of rasterised layers


def save_vectors(figure: Any, file: Path | str) -> None:
    """Write a figure as .svg or .pdf with reproducible bytes; a missing folder is made."""
    from matplotlib import rc_context

    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    for artist in figure.findobj(_is_large):
        artist.set_rasterized(True)
    dateless = {"Date": None} if file.suffix == ".svg" else {"CreationDate": None}
    # Journals require Type 42 fonts.
    with rc_context({"pdf.fonttype": 42, "svg.hashsalt": "sixthsense"}):
        figure.savefig(file, dpi=_DPI, bbox_inches="tight", pad_inches=0.12, metadata=dateless)


def _is_large(artist: Any) -> bool:
    """Whether a layer has too many marks, or a line too many corners, for vector graphics."""
    from matplotlib.collections import Collection
    from matplotlib.lines import Line2D

    if isinstance(artist, Collection):
        return bool(max(len(artist.get_paths()), np.shape(artist.get_offsets())[0]) > _MOST_MARKS)
    return isinstance(artist, Line2D) and np.size(artist.get_xdata()) > _MOST_CORNERS
