"""All parsers of files, each with small valid inputs as seeds."""

from __future__ import annotations

import bz2
import gzip
import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bags
import numpy as np

from sixthsense.config import LaserConfig

LASER = LaserConfig(beams=4, fov=1.5)
_SCENE = b"""start = [1, 1.5, 0]
radius = 0.2
goal = [3, 1]
tour = [[3, 1], [1, 1]]
region = [0, 0, 4, 2]
walls = [[0, 0, 4, 0], [4, 0, 4, 2], [4, 2, 0, 2], [0, 2, 0, 0]]
[[polygons]]
closed = true
points = [[2.0, 0.5], [2.2, 0.5], [2.1, 0.7]]
"""
_SCN = b"1 1 0 0.2\n0 0 4 0\n4 0 4 2\n4 2 0 2\n0 2 0 0\n"
_MAP = b"""image: m.pgm
resolution: 0.1
origin: [-1.0, 2.0, 0.1]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
mode: trinary
"""
_CARMEN = b"".join(
    b"ODOM %d 0.5 0.1 0.1 0.2 0 %d nohost 0.5\nFLASER 4 1.0 2.0 3.0 81.8 0 0 0 %d 0.5 0.1 %d.25 nohost 0.5\n"
    % (k, k, k, k)
    for k in range(4)
)
_RELATIONS = b"# t1 t2 dx dy dz roll pitch yaw\n1.25 2.25 1 0 0 0 0 0\n1.25 3.25 2 0.1 0 0 0 -0.1\n"
_CONFIG = b"""preset = "report"
scene = "office"
seed = 3
goal = [1.0, 2.0]
max_time = 60.0
[laser]
beams = 90
fov = 6.2
mount = [0.1, 0.0, 0.2]
[features.lines]
ransac_threshold_m = 0.04
[follow]
shortcut = false
"""
_WORDS = b"apartment --seed 3 --laser.beams=90 --goal 1.0 2 --laser.mount 0 0 1e-3 --out x --overwrite --no-realtime"


@dataclass(frozen=True)
class Parser:
    """One parser and its seeds."""

    name: str
    seeds: Callable[[Path], list[bytes]]
    """valid inputs; may write to a folder"""
    read: Callable[[Path, bytes], Any]
    """parses bytes; writes them to a file in the folder if it reads files"""
    wrap: Callable[[bytes], bytes] | None = None
    """applied to inputs that begin with `~`: adds a compression or checksums"""

    def form(self, data: bytes) -> bytes:
        """The bytes passed to the parser."""
        return self.wrap(data[1:]) if self.wrap is not None and data.startswith(b"~") else data


def _written(folder: Path, name: str, data: bytes) -> Path:
    (folder / name).write_bytes(data)
    return folder / name


def _scene(name: str) -> Callable[[Path, bytes], Any]:
    def read(folder: Path, data: bytes) -> Any:
        from sixthsense.sources.scene import load_scene

        return load_scene(_written(folder, name, data))

    return read


def _map(folder: Path, data: bytes) -> Any:
    from sixthsense.sources.scene import load_scene

    _written(folder, "m.pgm", _pgm())
    return load_scene(_written(folder, "m.yaml", data))


def _image(folder: Path, data: bytes) -> Any:
    from sixthsense.sources.scene import load_scene

    _written(folder, "m.pgm", data)
    return load_scene(_written(folder, "m.yaml", _MAP))


def _pixels() -> np.ndarray:
    pixels = np.full((12, 16), 254, np.uint8)
    pixels[[0, -1]] = pixels[:, [0, -1]] = pixels[4:7, 5] = 0
    pixels[8, 3:6] = 205
    return pixels


def _pgm() -> bytes:
    return b"P5 16 12 255\n" + _pixels().tobytes()


def _plain_pgm() -> bytes:
    return b"P2 16 12 255\n" + b" ".join(b"%d" % v for v in _pixels().ravel())


def _png(inner: bytes) -> bytes:
    """A PNG with valid checksums; `inner` is its header and its rows."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", inner[:13])
        + chunk(b"IDAT", zlib.compress(inner[13:]))
        + chunk(b"IEND", b"")
    )


def _png_seeds(folder: Path) -> list[bytes]:
    from PIL import Image

    rows = b"".join(b"\x00" + row.tobytes() for row in _pixels())
    inner = struct.pack(">IIBBBBB", 16, 12, 8, 0, 0, 0, 0) + rows
    coloured = io.BytesIO()
    Image.fromarray(_pixels()).convert("RGBA").save(coloured, "PNG")
    return [_png(inner), b"~" + inner, coloured.getvalue()]


def _log(name: str) -> Callable[[Path, bytes], Any]:
    def read(folder: Path, data: bytes) -> Any:
        from sixthsense.sources.logs import open_log

        return _sound(open_log(_written(folder, name, data), LASER))

    return read


def _sound(log: Any) -> Any:
    """The log, after a check that all its numbers are usable."""
    poses = [pose.array() for tick in log.ticks for pose in (tick.odometry, tick.truth) if pose is not None]
    assert np.abs(poses).max() <= 1e10
    assert np.all(np.diff([tick.stamp_ns for tick in log.ticks]) > 0)
    for scan in log.scans:
        assert np.all(scan.ranges >= 0.0) and np.isfinite([scan.angle_min, scan.angle_increment]).all()
    return log


def _relations(folder: Path, data: bytes) -> Any:
    from sixthsense.sources.logs.relations import read_relations

    return read_relations(_written(folder, "some.relations", data))


def _config(folder: Path, data: bytes) -> Any:
    from sixthsense.config import load_config, save_config

    config = load_config(_written(folder, "c.toml", data))
    save_config(config, folder / "again.toml")
    assert load_config(folder / "again.toml") == config
    return config


def _words(folder: Path, data: bytes) -> Any:
    from sixthsense.cli.common import parse_command
    from sixthsense.cli.options import parse_positionals
    from sixthsense.cli.run import Run

    # A shell passes arguments in this encoding.
    args = [word.replace("\0", "") for word in data.decode("utf-8", "surrogateescape").split(" ")]
    if args[0] == "report":
        return parse_positionals(args, {"out": Path, "overwrite": bool})
    return parse_command(Run, "scene", "default", args)


def _run_bag(folder: Path, data: bytes) -> Any:
    from sixthsense.sources.logs.runfolder import read_run

    (folder / "bag").mkdir(exist_ok=True)
    _written(folder, "bag/bag_0.mcap", data)
    return _sound(read_run(folder, LASER))


def _plain(*seeds: bytes) -> Callable[[Path], list[bytes]]:
    return lambda folder: list(seeds)


PARSERS = {
    parser.name: parser
    for parser in (
        Parser("scene-toml", _plain(_SCENE), _scene("s.toml")),
        Parser("scene-scn", _plain(_SCN), _scene("s.scn")),
        Parser("map-yaml", _plain(_MAP), _map),
        Parser("map-pgm", _plain(_pgm(), _plain_pgm()), _image),
        Parser("map-png", _png_seeds, _image, _png),
        Parser("carmen", _plain(_CARMEN), _log("x.log")),
        Parser("carmen-gz", _plain(gzip.compress(_CARMEN, mtime=0), b"~" + _CARMEN), _log("x.log.gz"), gzip.compress),
        Parser("carmen-bz2", _plain(bz2.compress(_CARMEN), b"~" + _CARMEN), _log("x.log.bz2"), bz2.compress),
        Parser("relations", _plain(_RELATIONS), _relations),
        Parser("config", _plain(_CONFIG), _config),
        Parser("words", _plain(_WORDS, b"report run-1 --out x --overwrite"), _words),
        Parser("ros1", bags.foreign("bag"), _log("x.bag"), bags.bag_of_one),
        Parser("mcap", bags.foreign("mcap"), _log("x.mcap"), bags.mcap),
        Parser("db3", bags.foreign("db3"), _log("x.db3"), bags.database),
        Parser("run-bag", bags.of_a_run, _run_bag, bags.mcap),
    )
}
