"""Masks of a whole map, drawn again where it has changed."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol

from numpy.typing import NDArray

from sixthsense.slam.mapping.changes import Box, Changes, Revision
from sixthsense.slam.mapping.freespace import Bools


class Masks(NamedTuple):
    """Masks of a grid, (H, W), read-only: snapshots are made of them without a copy."""

    box: Box
    revision: Revision
    seen: Bools
    covered: Bools
    """by the inflation of an obstacle"""


class Source(Protocol):
    """A map that says what is in a box of cells, and where it has changed."""

    @property
    def changes(self) -> Changes:
        """Where it has changed."""
        ...

    def part(self, name: Literal["cover", "seen"], box: Box) -> NDArray[Any]:
        """(H, W) what is kept of the cells in a box."""
        ...


def masks_of(source: Source, box: Box, reach: int, drawn: Masks | None) -> Masks:
    """The masks of a box of cells, from those that were drawn before; `reach` is of the inflation."""
    changes = source.changes
    if drawn is not None and (drawn.box, drawn.revision) == (box, changes.revision):
        return drawn
    since = changes.since(drawn.revision) if drawn is not None and drawn.box == box else None
    if drawn is None or since is None:
        seen, covered = source.part("seen", box), source.part("cover", box) > 0
    else:
        rows, cols = since.grown(reach).within((box.top, box.left), drawn.seen.shape)
        part = Box(box.top + rows.start, box.left + cols.start, box.top + rows.stop, box.left + cols.stop)
        seen, covered = drawn.seen.copy(), drawn.covered.copy()
        seen[rows, cols], covered[rows, cols] = source.part("seen", part), source.part("cover", part) > 0
    seen.flags.writeable = covered.flags.writeable = False
    return Masks(box, changes.revision, seen, covered)
