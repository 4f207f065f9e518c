"""A figure that shows itself in a notebook, once, whether or not pyplot was ever imported."""

from __future__ import annotations

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_NOTEBOOK_DPI = 75.0


class Picture(Figure):
    """One of matplotlib's figures, of no window system and no global state, so that pyplot does not show it again."""

    def __init__(self, width_in: float, height_in: float) -> None:
        """Make an empty one, in inches."""
        super().__init__(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasAgg(self)

    def png(self, dpi: float = _NOTEBOOK_DPI) -> bytes:
        """The content of a PNG file, with a palette: drawings have few colours, and a notebook keeps every byte."""
        from PIL import Image

        content, small = io.BytesIO(), io.BytesIO()
        # Equal axes leave room that the layout has not foreseen; cut it off, and cut no title.
        self.savefig(content, format="png", dpi=dpi, bbox_inches="tight", pad_inches=0.12)
        with Image.open(content) as image:
            # Not the default: a median cut loses the colours of a legend's thin lines.
            method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
            image.convert("RGB").quantize(256, method, kmeans=1, dither=dither).save(small, "PNG", optimize=True)
        return small.getvalue()

    def _repr_png_(self) -> bytes:
        return self.png()
