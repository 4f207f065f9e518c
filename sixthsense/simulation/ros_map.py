"""ROS maps (map_server's `.yaml` with an image): wall segments along the outlines of the occupied cells."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from sixthsense.config.errors import InputError, reason_of
from sixthsense.core.geometry import Array, Pose
from sixthsense.simulation.scene_files import checked

_FORMATS = ("PPM", "PNG", "BMP", "JPEG", "TIFF")
_SAVED_UNKNOWN, _SAVED_FREE = 205, 254
"""pixels that map_saver writes for unknown and free cells"""
_MOST_BYTES = 1 << 14  # of the fields; YAML is slow on nested lists
_Origin = Annotated[float, Field(ge=-1e6, le=1e6)]

# Largest distance of a corner of the cells' outline from the simplified outline.
_TOLERANCE_CELLS = 0.5
# The cost of a segment is 1 plus this times the squared distances, in cells, of the outline's corners from it. Above 2,
# so that removing the end of a wall one cell thick (two corners half a cell off, one segment less) raises the cost.
# Below 4, so that one line replaces a staircase (two corners half a cell off for every two segments).
_DEVIATION_COST = 3.0
# Bounds the time on huge maps; few segments span more than some hundred corners.
_LOOK_AHEAD = 2000


class _Map(BaseModel):
    """The fields of a map, whose values are text."""

    image: Annotated[str, Field(min_length=1, max_length=1000)]
    resolution: Annotated[float, Field(ge=1e-4, le=100.0)]
    """metres a cell"""
    origin: tuple[_Origin, _Origin, _Origin]
    """x, y and yaw of the lower left corner"""
    negate: Literal["0", "1", "false", "true", "False", "True", "FALSE", "TRUE"]
    occupied_thresh: Annotated[float, Field(ge=0.0, le=1.0)]
    free_thresh: Annotated[float, Field(ge=0.0, le=1.0)]
    mode: Literal["trinary", "Trinary", "TRINARY"] = "trinary"


def read_map(file: Path, unknown: Literal["wall", "free"]) -> tuple[Array, tuple[str, ...]]:
    """The walls of a map_server map: (N, 2, 2) segments, metres, world frame, solid on the left; and notes on it.

    Cells are solid from `free_thresh` on, so that beams and robots do not leave a building through the holes in a
    scanned wall, nor where the image ends in a corridor; with `unknown` free, cells whose occupancy is above
    `occupied_thresh` alone. The pixel's value is the mean over the image's channels, alpha included, as in Nav2's
    map_server, whose rules of mode trinary hold but for one: a pixel of 205 beside some of 254 is unknown whatever
    `free_thresh` is, since map_saver has written it so. Fields of other programs are ignored. Raises InputError,
    without the map file's name, for a field that is missing or not allowed, such as another mode, and for an image that
    is missing, damaged, huge, entirely free or entirely solid.
    """
    stated = checked(_Map, _read_yaml(file))
    image = file.parent / stated.image
    values = _read_image(file.parent, stated.image)  # (H, W, channels)
    channels = values.shape[2]
    total = values.sum(axis=2, dtype=np.uint16)
    shade = np.arange(255 * channels + 1) / (255.0 * channels)  # mean of each sum, 0 black to 1 white
    occupancy = 1.0 - shade if stated.negate.lower() in ("0", "false") else shade
    is_occupied = occupancy > stated.occupied_thresh
    is_free = (occupancy < stated.free_thresh) & ~is_occupied
    saved, notes = _SAVED_UNKNOWN * channels, []
    if is_free[saved] and (total == saved).any() and (total == _SAVED_FREE * channels).any():
        is_free[saved] = False
        by_nav2 = f"with free_thresh {stated.free_thresh:g} Nav2's map_server takes them as free"
        notes.append(f"pixels of {_SAVED_UNKNOWN} are unknown, as map_saver writes them; {by_nav2}")
    solid = (is_occupied if unknown == "free" else ~is_free)[total[::-1]]  # the image's first row is the map's top
    if solid.all() or not solid.any():
        raise InputError(image, f"all pixels are {'occupied' if solid.all() else 'free'}", "some of both")
    border = np.concatenate([solid[0], solid[-1], solid[1:-1, 0], solid[1:-1, -1]])
    # What lies beyond the image is solid where most of its border is, and a free place is cut off there.
    beyond = int(unknown == "wall" and 0.5 < border.mean() < 1.0)
    cells, cell_ends = outline_corners(np.pad(solid, beyond, constant_values=True))
    corners, ends = simplified(cells.astype(np.float64), cell_ends)
    following = np.arange(1, len(corners) + 1)
    following[ends - 1] = np.concatenate([[0], ends[:-1]])  # the last corner of an outline is followed by its first
    corners_world = Pose(*stated.origin) @ np.asarray((corners - beyond) * stated.resolution, dtype=np.float64)
    return np.stack([corners_world, corners_world[following]], axis=1), tuple(notes)


def _read_yaml(file: Path) -> Any:
    """The fields of a map as text, so that 5e-2 is a number, as in map_server."""
    import yaml

    try:
        if not file.is_file():
            raise InputError("", "no such file")
        if file.stat().st_size > _MOST_BYTES:
            raise InputError("", f"found {file.stat().st_size:,} bytes", "the fields of a map")
        return yaml.load(file.read_bytes(), Loader=yaml.BaseLoader)
    except OSError as error:
        raise InputError("", f"cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, RecursionError) as error:
        raise InputError("", f"is not YAML ({reason_of(error)})") from None


def _read_image(folder: Path, name: str) -> NDArray[np.uint8]:
    """The pixels (H, W, channels), 0 to 255, of an image in a folder, at an absolute path or in a user's home, `~`."""
    from PIL import Image

    try:
        path = folder / Path(name).expanduser()
        if not path.is_file():
            raise FileNotFoundError("no such file")
        with warnings.catch_warnings(category=Image.DecompressionBombWarning, action="error"):
            image = Image.open(path, formats=_FORMATS)
        with image:
            if image.mode.startswith("I"):  # 16 bits, of which map_server keeps the upper 8
                return (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)[:, :, None]
            has_alpha = "A" in image.getbands() or "transparency" in image.info
            pixels = np.asarray(image.convert("RGBA" if has_alpha else "L" if image.mode in ("1", "L") else "RGB"))
            return pixels.reshape(*pixels.shape[:2], -1)
    except Exception as error:  # a damaged image makes its decoder fail with undocumented exceptions
        raise InputError(folder / name, f"not a readable image ({reason_of(error)})", ", ".join(_FORMATS)) from None


def outline_corners(occupied: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The closed outlines of the occupied cells, the image's border included.

    `occupied` (H, W), row 0 at the bottom. Returns the corners (K, 2) of all outlines in sequence, x and y in cells
    from the lower left corner of the grid, and the end index of each outline. Occupied cells are on the left:
    counter-clockwise around a solid, clockwise around a hole. Cells that touch diagonally are connected, so that no
    ray passes between them.
    """
    cells = np.pad(np.asarray(occupied, dtype=np.uint8), 1)
    around = cells[:-1, :-1] + cells[1:, :-1] + cells[:-1, 1:] + cells[1:, 1:]
    touching = (around == 2) & (cells[:-1, :-1] == cells[1:, 1:])
    corners = np.empty((np.count_nonzero(around % 2) + 2 * np.count_nonzero(touching), 2), np.int64)
    ends = np.empty(len(corners) // 4, np.int64)
    return corners, ends[: _trace(cells, corners, ends)]


def simplified(corners: Array, ends: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Closed outlines of cells with fewer corners: these in sequence, and the end index of each outline.

    The result has the least cost among all polygons through corners and midpoints of an outline's sides that stay
    within half a cell of every corner. The cost is the number of segments plus the weighted squared distances of the
    corners. Midpoints are candidates because a slanted wall is a staircase whose line passes through the midpoints of
    its steps. The shortest path over candidate points and the wedge test of a segment follow Imai and Iri, "Polygonal
    approximations of a curve" (1988).
    """
    kept = []
    for outline in np.split(corners, ends[:-1]):
        points = np.empty((2 * len(outline) + 1, 2))
        points[0:-1:2], points[-1] = outline, outline[0]
        points[1::2] = (points[0:-1:2] + points[2::2]) / 2
        kept.append(points[_cheapest(points, _TOLERANCE_CELLS, _DEVIATION_COST)])
    return np.concatenate(kept), np.cumsum([len(outline) for outline in kept])


@numba.njit(cache=True, error_model="numpy")
def _trace(cells: NDArray[np.uint8], corners: NDArray[np.int64], ends: NDArray[np.int64]) -> int:
    """Write the corners (K, 2) of all outlines in sequence and the end index of each; returns how many outlines.

    `cells` has a free border. No outline has less than four corners.
    """
    rows, columns = cells.shape
    count, outlines, seen = 0, 0, np.zeros((rows, columns), np.bool_)
    for y0 in range(1, rows - 1):
        for x0 in range(1, columns - 1):
            # Every outline has a side that runs right, below an occupied cell. Row by row, the first cell of an
            # outline is at the left end of such a side, which is a corner.
            if cells[y0, x0] == 0 or cells[y0 - 1, x0] != 0 or seen[y0, x0]:
                continue
            y, x, dy, dx = y0, x0, 0, 1
            corners[count, 0], corners[count, 1] = x - 1, y - 1
            count += 1
            while True:
                if dx == 1:
                    seen[y, x] = True
                y, x = y + dy, x + dx
                turn_y, turn_x = dy, dx
                if cells[y + (dy - dx - 1) // 2, x + (dx + dy - 1) // 2] != 0:  # ahead on the right
                    turn_y, turn_x = -dx, dy
                elif cells[y + (dy + dx - 1) // 2, x + (dx - dy - 1) // 2] == 0:  # ahead on the left
                    turn_y, turn_x = dx, -dy
                if turn_x == dx:
                    continue
                dy, dx = turn_y, turn_x
                if y == y0 and x == x0 and dx == 1:
                    break
                corners[count, 0], corners[count, 1] = x - 1, y - 1
                count += 1
            ends[outlines] = count
            outlines += 1
    return outlines


@numba.njit(cache=True, error_model="numpy")
def _cheapest(points: Array, tolerance: float, deviation_cost: float) -> NDArray[np.bool_]:
    """(N + 1,) kept points of a closed outline (N + 1, 2): even ones are corners, the last point is the first."""
    n = points.shape[0] - 1
    cost = np.full(n + 1, np.inf)
    cost[0] = 0.0
    previous = np.zeros(n + 1, np.int64)
    for i in range(n):
        # The wedge of directions, relative to the first one, that pass all corners so far within the tolerance.
        wedge, first, low, high = False, 0.0, -math.pi, math.pi
        far_sq, xx, xy, yy = 0.0, 0.0, 0.0, 0.0
        for j in range(i + 1, min(n, i + _LOOK_AHEAD) + 1):
            dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            distance_sq = dx * dx + dy * dy
            angle = math.atan2(dy, dx)
            turn = (angle - first + math.pi) % (2 * math.pi) - math.pi
            # The wedge constrains the infinite line, so no corner may lie beyond the end of the segment.
            if distance_sq >= far_sq and low <= turn <= high:
                deviation_sq = (xx * dy * dy - 2 * xy * dx * dy + yy * dx * dx) / distance_sq
                total = cost[i] + 1.0 + deviation_cost * deviation_sq
                if total < cost[j]:
                    cost[j], previous[j] = total, i
            if j % 2 == 1:
                continue
            far_sq = max(far_sq, distance_sq)
            xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
            if distance_sq > tolerance * tolerance:
                half = math.asin(tolerance / math.sqrt(distance_sq)) + 1e-9  # for rounding
                if not wedge:
                    wedge, first, turn = True, angle, 0.0
                low, high = max(low, turn - half), min(high, turn + half)
                if low > high:
                    break
    kept, k = np.zeros(n + 1, np.bool_), previous[n]
    kept[k] = True
    while k > 0:
        k = previous[k]
        kept[k] = True
    return kept
