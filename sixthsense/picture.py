"""A figure that shows itself in a notebook, once, whether or not pyplot was ever imported."""

from __future__ import annotations

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_NOTEBOOK_DPI = 75.0
_NOTEBOOK_COLORS = 128


class Picture(Figure):
    """One of matplotlib's figures, of no window system and no global state, so that pyplot does not show it again."""

    def __init__(self, width_in: float, height_in: float) -> None:
        """Make an empty one, in inches."""
        super().__init__(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasAgg(self)

    def png(self, dpi: float = _NOTEBOOK_DPI) -> bytes:
        """The picture as the content of a PNG file."""
        content = io.BytesIO()
        # Equal axes leave room that the layout has not foreseen; cut it off, and cut no title.
        self.savefig(content, format="png", dpi=dpi, bbox_inches="tight", pad_inches=0.12)
        return content.getvalue()

    def _repr_png_(self) -> bytes:
        """The same with a palette, a third of the size: drawings have few colours, and a notebook keeps its figures."""
        from PIL import Image

        content = io.BytesIO()
        with Image.open(io.BytesIO(self.png())) as image:
            image.convert("RGB").quantize(_NOTEBOOK_COLORS).save(content, "PNG", optimize=True)
        return content.getvalue()
