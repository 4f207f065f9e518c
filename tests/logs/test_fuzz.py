"""Whatever is in a file, reading it gives a result or an error of one line, without a warning."""

import gzip
import os
import random
import re
import struct
import tempfile
import warnings
from pathlib import Path

import pytest
from general import some
from hypothesis import given, settings
from hypothesis import strategies as st

import sixthsense as ss
from sixthsense.config import LaserConfig, load_config
from sixthsense.config.errors import InputError
from sixthsense.logs import open_log
from sixthsense.logs.log import read_relations
from sixthsense.logs.runfolder import read_run
from sixthsense.simulation.scene import load_scene

LASER = LaserConfig(beams=4, fov=1.5)
ROOM = "start = [1, 1, 0]\nradius = 0.2\nwalls = [[0, 0, 4, 0], [4, 0, 4, 2], [4, 2, 0, 2], [0, 2, 0, 0]]\n"
MAP = "image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
IMAGE = b"P5 16 12 255\n" + b"\x00" * 16 + (b"\x00" + b"\xfe" * 14 + b"\x00") * 10 + b"\x00" * 16
CARMEN = b"".join(
    b"ODOM %d 0.5 0.1 0.1 0.2 0 %d nohost 0.5\nFLASER 4 1.0 2.0 3.0 81.8 0 0 0 %d 0.5 0.1 %d.25 nohost 0.5\n"
    % (k, k, k, k)
    for k in range(4)
)
RELATIONS = b"# t1 t2 dx dy dz roll pitch yaw\n1.25 2.25 1 0 0 0 0 0\n1.25 3.25 2 0.1 0 0 0 -0.1\n"
CONFIG = (
    b'preset = "report"\nscene = "office"\nseed = 3\ngoal = [1.0, 2.0]\n[laser]\nbeams = 90\nmount = [0.1, 0, 0.2]\n'
)
NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = [b"nan", b"inf", b"1e308", b"-1e308", b"5e-324", b"0", b"-1", b"9" * 5000, b"0x" + b"f" * 5000, b"1_0", b"[]"]
WORDS = [b"[" * 3000, b"{a=" * 100, b"a." * 100, b'"a\\nb" = 1\n', b"\x00", b"\r", b"\xe2\x80\xa8", b"\xff\xfe",
         b"&a [*a,", b"\xff" * 8, struct.pack("<d", float("nan")), struct.pack("<d", 1e308)]  # fmt: skip


@pytest.fixture(scope="module")
def record(tmp_path_factory) -> bytes:
    """The record of a short run."""
    out = tmp_path_factory.mktemp("run") / "run"
    ss.run("rectangle", task="tour", max_time=1.0, laser={"beams": 4, "fov": 1.5}, out=out, progress=False)
    return (out / "record.mcap").read_bytes()


def written(folder: Path, name: str, data: bytes) -> Path:
    file = folder / name
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(data)
    return file


def read_map(folder: Path, data: bytes, image: bytes = IMAGE) -> object:
    written(folder, "m.pgm", image)
    return load_scene(written(folder, "m.yaml", data))


PARSERS = {
    "scene": (ROOM.encode(), lambda folder, data: load_scene(written(folder, "s.toml", data))),
    "map": (MAP.encode(), read_map),
    "image": (IMAGE, lambda folder, data: read_map(folder, MAP.encode(), data)),
    "carmen": (CARMEN, lambda folder, data: open_log(written(folder, "x.log", data), LASER)),
    "gz": (gzip.compress(CARMEN, mtime=0), lambda folder, data: open_log(written(folder, "x.log.gz", data), LASER)),
    "relations": (RELATIONS, lambda folder, data: read_relations(written(folder, "x.relations", data))),
    "config": (CONFIG, lambda folder, data: load_config(written(folder, "c.toml", data))),
    "record": (None, lambda folder, data: read_run(written(folder, "record.mcap", data).parent, LASER)),
}


def damaged(data: bytes, rng: random.Random) -> bytes:
    """A file damaged in one to four places."""
    for _ in range(rng.randint(1, 4)):
        at = rng.randint(0, len(data))
        end, kind = min(len(data), at + rng.choice((1, 8, 50))), rng.randrange(5)
        spans = [m.span() for m in NUMBER.finditer(data[:20_000])]
        if kind == 0:
            data = data[:at] + data[end:]
        elif kind == 1:
            data = data[:at] + rng.randbytes(rng.randint(1, 20)) + data[end:]
        elif kind == 2:
            data = data[: rng.choice((at, end))] + data[at:]
        elif kind == 3:
            data = data[:at] + rng.choice(WORDS) + data[at:]
        elif spans:
            low, high = rng.choice(spans)
            data = data[:low] + rng.choice(NUMBERS) + data[high:]
    return data


@pytest.mark.parametrize("name", PARSERS)
def test_damaged_files_and_random_bytes_give_a_result_or_one_line(name, record):
    seed, read = PARSERS[name]
    seed = seed or record
    with tempfile.TemporaryDirectory() as folder:
        read(Path(folder), seed)
        files = st.integers(0, 2**32).map(lambda number: damaged(seed, random.Random(number)))

        @settings(some, max_examples=60)
        @given(st.one_of(files, files, files, st.binary(max_size=300)))
        def check(data: bytes) -> None:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                try:
                    read(Path(folder), data)
                except InputError as error:
                    assert len(str(error).splitlines()) == 1 and len(str(error)) < 2000

        check()


NOISE = random.Random(0).randbytes(5000)
SYMBOLS = "8646911284551352320 8646911284551352321"
UNKNOWN = "found no known kind of log"
ODD_FILES = [
    ("run s.toml", {"s.toml": ROOM.split("walls")[0]}, "walls: found none, allowed: at least one wall"),
    ("run m.yaml", {"m.yaml": MAP, "m.pgm": b"P5 50000 50000 255\n"}, "m.pgm: not a readable image ("),
    ("run m.yaml", {"m.yaml": MAP.replace("m.pgm", "/dev/zero")}, "/dev/zero: not a readable image (no such file)"),
    ("replay x.log.gz", {"x.log.gz": b"\x1f\x8b" + NOISE}, "x.log.gz: cannot be read after line 0 ("),
    ("replay run", {"run/config.toml": "", "run/record.mcap": NOISE}, "run/record.mcap: is not an MCAP file"),
    ("replay none.log", {}, "none.log: no such file"),
    ("replay x.bag", {"x.bag": NOISE}, UNKNOWN),
    ("replay x.bag", {"x.bag": b""}, UNKNOWN),
    ("replay x", {"x/notes.txt": "ODOM"}, UNKNOWN),
    ("replay x.log", {"x.log": CARMEN.decode().encode("utf-16")}, UNKNOWN),
    ("replay x.log", {"x.log": b"NMEA $GPGGA\n" * 15_000 + CARMEN}, UNKNOWN),
    ("replay x.bag.gz", {"x.bag.gz": gzip.compress(b"#ROSBAG V2.0\n" + NOISE)}, UNKNOWN),
    ("replay a.db3.zstd", {"a.db3.zstd": b"\x28\xb5\x2f\xfd"}, "zstd -d"),
    ("replay a.clf", {"a.clf": b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n"}, "git lfs pull"),
    ("replay a.clf", {"a.clf": CARMEN.replace(b" 2.0 ", b" 2,0 ")}, "decimal comma"),
    ("replay a.clf --relations r", {"a.clf": CARMEN, "r": b"1,5 2,5 0,1 0,2 0,0 0,0 0,0 0,3\n"}, "decimal commas"),
    ("replay a.g2o", {"a.g2o": f"EDGE_SE2 {SYMBOLS} 1 0 0 1 0 0 1 0 1\n"}, "a symbol of GTSAM"),
    ("replay a.g2o", {"a.g2o": "".join(f"EDGE_SE2 {ends} 1 0 0 1 0 0 1 0 1\n" for ends in ("0 1", "1 2", "3 9"))},
     "found an edge from pose 3 to 9, allowed: from the newest pose, 2"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "files", "said"), ODD_FILES, ids=range(len(ODD_FILES)))
def test_a_file_that_cannot_be_read_is_named_in_a_line_with_what_to_do_and_nothing_is_written(
    line, files, said, tmp_path, monkeypatch, complaint
):
    monkeypatch.chdir(tmp_path)
    for name, content in files.items():
        written(tmp_path, name, content if isinstance(content, bytes) else content.encode())
    told = complaint(*line.split(" "))
    assert said in told and len(told) < 1000


def chunked(data: bytes, compression: str, size: int) -> bytes:
    """An MCAP file of one chunk that says to hold `size` bytes."""

    def record(kind: int, content: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(content)) + content

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    magic = b"\x89MCAP0\r\n"
    head = struct.pack("<QQQI", 0, 10, size, 0) + text(compression) + struct.pack("<Q", len(data))
    end = record(0x0F, bytes(4)) + record(2, bytes(20))
    return magic + record(1, text("ros2") + text("")) + record(6, head + data) + end + magic


def test_chunks_that_would_fill_the_memory_are_refused_in_one_line(here, complaint):
    from lz4.frame import compress

    Path("honest.mcap").write_bytes(chunked(compress(bytes(1 << 25)), "lz4", 1 << 29))
    assert "far more than the file" in complaint("replay", "honest.mcap")
    Path("says.mcap").write_bytes(chunked(b"abc", "", 1 << 62))
    assert "says.mcap: cannot be read as a bag" in complaint("replay", "says.mcap")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize(("name", "command"), [("x.log", "replay x.log"), ("x.mcap", "replay x.mcap"),
                                               ("m.pgm", "run m.yaml"), ("x.toml", "run --config x.toml")])  # fmt: skip
def test_a_silent_pipe_is_refused(name, command, here, complaint):
    Path("m.yaml").write_text(MAP)
    os.mkfifo(name)
    assert f"{name}: " in complaint(*command.split())
