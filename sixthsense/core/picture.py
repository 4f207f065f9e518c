"""A figure that a notebook displays exactly once, with or without pyplot."""

from __future__ import annotations

import io
from pathlib import Path
from typing import IO

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

MARGIN_IN = 0.12
"""around what is drawn, in a file"""

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
        self.save_bitmap(content, dpi)
        with Image.open(content) as image:
            # The default method, median cut, loses the colours of thin lines in the legend.
            method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
            image.convert("RGB").quantize(256, method, kmeans=1, dither=dither).save(small, "PNG", optimize=True)
        return small.getvalue()

    def save_bitmap(self, file: Path | IO[bytes], dpi: float) -> None:
        """Write a bitmap, PNG for an open file, without what axes of equal aspect leave empty around them.

        It has the pixels of `savefig` with `bbox_inches="tight"`, which draws everything twice to find that box.
        """
        engine, before = self.get_layout_engine(), self.dpi
        self.set_dpi(dpi)
        if engine is not None:
            engine.execute(self)
        box = self.get_tightbbox(self.canvas.get_renderer()).padded(MARGIN_IN)  # type: ignore[attr-defined]
        self.set_layout_engine(None)
        try:
            self.savefig(file, dpi=dpi, bbox_inches=box)
        finally:
            self.set_layout_engine(engine)
            self.set_dpi(before)

    def _repr_png_(self) -> bytes:
        return self.png()
