"""A figure that a notebook displays exactly once, with or without pyplot."""

from __future__ import annotations

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_NOTEBOOK_DPI = 75.0


class Picture(Figure):
    """A Matplotlib figure without window system and global state, so that pyplot does not show it a second time."""

    def __init__(self, width_in: float, height_in: float) -> None:
        """Make an empty figure; sizes in inches."""
        super().__init__(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasAgg(self)

    def png(self, dpi: float = _NOTEBOOK_DPI) -> bytes:
        """The content of a PNG file with a palette, which keeps notebooks small."""
        from PIL import Image

        content, small = io.BytesIO(), io.BytesIO()
        # Axes of equal aspect leave margins that the layout cannot remove.
        self.savefig(content, format="png", dpi=dpi, bbox_inches="tight", pad_inches=0.12)
        with Image.open(content) as image:
            # The default method, median cut, loses the colours of thin lines in the legend.
            method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
            image.convert("RGB").quantize(256, method, kmeans=1, dither=dither).save(small, "PNG", optimize=True)
        return small.getvalue()

    def _repr_png_(self) -> bytes:
        return self.png()
