import os
import random
import shutil
import struct
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sixthsense import cli
from sixthsense.config import ConfigError, load_config
from sixthsense.sources.scene import SceneError, load_scene

with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "benchmarks"))
    import bags
    from fuzz import attempt, mutate
    from parsers import PARSERS

SLOW = ("ros1", "mcap", "db3", "run-bag")


@pytest.mark.parametrize("name", PARSERS)
def test_damaged_files_and_random_bytes_give_a_result_or_one_line(name):
    parser = PARSERS[name]
    with tempfile.TemporaryDirectory() as folder:
        seeds = parser.seeds(Path(folder))
        assert all(attempt(parser, Path(folder), seed) for seed in seeds)
        damaged = st.builds(mutate, st.sampled_from(seeds), st.integers(0, 2**32).map(random.Random))

        @settings(
            derandomize=True,
            max_examples=60 if name in SLOW else 120,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
        )
        @given(st.one_of(damaged, damaged, damaged, st.binary(max_size=300)))
        def check(data: bytes) -> None:
            attempt(parser, Path(folder), data)

        check()


def one_line(args: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    before = sorted(Path().rglob("*"))
    assert cli.main(args) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1 and err.startswith("sixthsense: ") and len(err) < 1000
    assert sorted(Path().rglob("*")) == before
    return err.removeprefix("sixthsense: ")


ROOM = "start = [1, 1, 0]\nradius = 0.2\nwalls = [[0, 0, 4, 0], [4, 0, 4, 2], [4, 2, 0, 2], [0, 2, 0, 0]]\n"
MAP = "image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
FLASER = "FLASER 3 1 1 2 0 0 0 0 0 0 1 h 1\n"
NOISE = random.Random(0).randbytes(5000)
BAD_FILES = [
    ("run s.toml", {"s.toml": ROOM.split("walls")[0] + "walls = []"}, "walls: found none, allowed: at least one wall"),
    ("run s.toml", {"s.toml": ROOM.split("walls")[0]}, "walls: found none, allowed: at least one wall"),
    ("run s.toml", {"s.toml": ROOM.replace("[4, 0, 4, 2]", "[4, 0, 4, 0]")}, "walls, entry 2: found a wall of no len"),
    ("run s.toml", {"s.toml": ROOM.replace("[4, 0, 4, 2]", "[4, 0, nan, 2]")}, "walls, entry 2: found [4, 0, nan, 2]"),
    ("run s.toml", {"s.toml": ROOM.replace("4, 2]", f"0x{'f' * 5000}, 2]", 1)}, "an integer of 20000 bits"),
    ("run s.toml", {"s.toml": ROOM + '"a\\nb" = 1'}, r"'a\nb': no such field, allowed: start"),
    ("run s.toml --goal 4 1", {"s.toml": ROOM}, "goal: found (4, 1), 0 m from a wall"),
    ("run s.toml", {"s.toml": NOISE}, "is not UTF-8, allowed: a text file"),
    ("run s.scn", {"s.scn": "1 1 0 0.2\n"}, "line 2: missing, allowed: at least one wall"),
    ("run s.scn", {"s.scn": "1 1 0 0.2\n0 0 0 0\n"}, "line 2: found a wall of no length"),
    ("run s.scn", {"s.scn": "1 1 0 0.2\n0 0 nan 0\n"}, "line 2: found [0.0, 0.0, nan, 0.0], allowed: 4 numbers"),
    ("run s.scn", {"s.scn": NOISE}, "is not UTF-8, allowed: a text file"),
    ("run m.yaml", {"m.yaml": MAP}, "m.pgm: no such image file"),
    ("run m.yaml", {"m.yaml": MAP, "m.pgm": b"GIF89a" + NOISE}, "m.pgm: not a readable image"),
    ("run m.yaml", {"m.yaml": MAP, "m.pgm": NOISE}, "m.pgm: not a readable image"),
    ("run m.yaml", {"m.yaml": MAP, "m.pgm": b"P5 40 40 255\n" + bytes(800)}, "m.pgm: not a readable image"),
    ("run m.yaml", {"m.yaml": MAP, "m.pgm": b"P5 50000 50000 255\n"}, "allowed: 100,000,000 pixels in all"),
    ("run m.yaml", {"m.yaml": MAP, "m.pgm": b"P5 2 2 255\n\xff\xff\xff\xff"}, "found no occupied pixel"),
    ("run m.yaml", {"m.yaml": MAP.replace("m.pgm", '"a\\nb"')}, r"image: found 'a\nb', not a readable image"),
    ("run m.yaml", {"m.yaml": NOISE}, "is not UTF-8, allowed: a text file"),
    ("run m.yaml", {"m.yaml": MAP.replace("[0, 0, 0]", "[" * 3000)}, "found lists over 20 deep, allowed: a table"),
    ("run m.yaml", {"m.yaml": MAP + "#" * 70_000}, "found over 65536 characters, allowed: a table"),
    ("run m.yaml", {"m.yaml": MAP.replace("m.pgm", "9" * 3000)}, "image: found a name of 3000 characters"),
    ("run m.yaml", {"m.yaml": MAP.replace("m.pgm", "9" * 400)}, "not a readable image (File name too long)"),
    ("run m.yaml", {"m.yaml": MAP.replace("m.pgm", "/dev/zero")}, "/dev/zero: is a folder, a pipe or a device"),
    ("replay x.bag", {"x.bag": b"#ROSBAG V2.0" + NOISE.replace(b"\n", b"")}, "x.bag: cannot be read as a bag (File"),
    ("run --config c.toml", {"c.toml": NOISE}, "c.toml: is not UTF-8 text, allowed: a TOML file"),
    ("run --config c.toml", {"c.toml": f"seed{'.a' * 4000} = 1"}, "c.toml: "),
    ("run --config c.toml", {"c.toml": f"seed = 0x{'f' * 5000}"}, "c.toml: seed: found an integer of 20000 bits"),
    (
        "run --config c.toml",
        {"c.toml": f"[laser]\nbeams = 0x{'f' * 5000}"},
        "found an integer of 20000 bits",
    ),
    (
        "run --config c.toml",
        {"c.toml": 'scene = "a\\u0000.toml"'},
        "c.toml: scene: found 'a\\x00.toml', allowed: a text",
    ),
    ("run --config c.toml", {"c.toml": '"a\\nb" = 1'}, r"c.toml: 'a\nb': no such field, allowed: "),
    ("run --config /dev/zero", {}, "/dev/zero: found over 8388608 characters"),
    ("calibrate s.toml --out n.toml", {"s.toml": NOISE}, "is not UTF-8, allowed: a text file"),
    ("replay x.log", {"x.log": NOISE}, "x.log line 1: "),
    ("replay x.log.gz", {"x.log.gz": b"\x1f\x8b" + NOISE}, "x.log.gz: cannot be read (damaged after line 0"),
    ("replay x.log.bz2", {"x.log.bz2": b"BZh9" + NOISE}, "x.log.bz2: cannot be read (damaged after line 0"),
    ("replay x.log", {"x.log": "FLASER 3 1 a 2 0 0 0 0 0 0 1 h 1\n"}, "x.log line 1: found "),
    ("replay x.log --relations r", {"x.log": "", "r": NOISE}, "r line 1: found "),
    ("replay x.log", {"x.log": FLASER.replace("FLASER", "F" * 3000)}, "line 1: found 'FFFF"),
    ("replay x.log --laser.beams 3", {"x.log": FLASER.replace(" 1 h", " 0_.25 h")}, "line 1: found stamp '0_.25'"),
    ("replay x.log --laser.beams 3", {"x.log": FLASER.replace(" 1 h", " 1\x1c h")}, "line 1: found stamp '1"),
    ("replay x.log --laser.beams 3", {"x.log": FLASER.replace("0 0 0 1 h", "1e300 0 0 1 h")}, "'1e300'"),
    ("replay x.bag", {"x.bag": NOISE}, "x.bag: cannot be read as a bag"),
    ("replay x.mcap", {"x.mcap": NOISE}, "x.mcap: cannot be read as a bag"),
    ("replay x.db3", {"x.db3": NOISE}, "x.db3: cannot be read as a bag"),
    ("replay run", {"run/config.toml": ""}, "run/bag/bag_0.mcap: no such file"),
    ("replay run", {"run/config.toml": "", "run/bag/bag_0.mcap": NOISE}, "run/bag/bag_0.mcap: is not an MCAP file"),
    ("replay run", {"run/config.toml": NOISE}, "run/config.toml: is not UTF-8 text"),
    ("report run", {"run/config.toml": NOISE}, "run/config.toml: is not UTF-8 text"),
    ("report run", {"run/config.toml": "", "run/bag/bag_0.mcap": NOISE}, "run/bag/bag_0.mcap: is not an MCAP file"),
    ("run a\nb.toml", {}, r"scene: found 'a\nb.toml', allowed: a name without line breaks"),
    ("run --out a\udcff", {}, r"--out: found 'a\udcff', allowed: a name without line breaks"),
    ("run --a\nb 1", {}, r"'--a\nb': no such option"),
]


@pytest.mark.parametrize(
    ("line", "files", "said"), BAD_FILES, ids=[f"{k}-{row[0]!r}" for k, row in enumerate(BAD_FILES)]
)
def test_an_invalid_file_gives_one_line_and_writes_nothing(line, files, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, content in files.items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
    assert said in one_line(line.split(" "), capsys)


def test_deeply_nested_and_huge_values_are_refused_in_one_short_line(tmp_path):
    for text in (f"walls{'.a' * 3000} = 1", f"radius = {'[' * 500}{']' * 500}", f"goal = '{'x' * 10**6}'"):
        (tmp_path / "s.toml").write_text(ROOM.split("walls")[0].replace("radius = 0.2", "") + text)
        with pytest.raises(SceneError) as scene:
            load_scene(tmp_path / "s.toml")
        (tmp_path / "c.toml").write_text(text.replace("walls", "preset").replace("radius", "seed"))
        with pytest.raises(ConfigError) as config:
            load_config(tmp_path / "c.toml")
        assert len(str(scene.value)) < 500 and len(str(config.value)) < 500


def test_a_bag_with_incomplete_types_is_refused_in_one_line(tmp_path):
    parser = PARSERS["ros1"]
    seed = parser.seeds(tmp_path)[0]
    for field in (b"float32[] ranges", b"float32 angle_min", b"float32 range_max"):
        assert field in seed
        assert not attempt(parser, tmp_path, seed.replace(field, field[:-1] + b"_"))
    shutil.rmtree(tmp_path)


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


ZEROS = 1 << 25
"""bytes that a bomb holds"""


def squeezed(compressor: object) -> bytes:
    block = bytes(1 << 22)
    parts = [compressor.begin()] if hasattr(compressor, "begin") else []
    return b"".join([*parts, *(compressor.compress(block) for _ in range(ZEROS >> 22)), compressor.flush()])


def bombs() -> dict[str, bytes]:
    """Small files with a chunk that decompresses to far more than it says, or that is right."""
    from backports import zstd
    from lz4.frame import LZ4FrameCompressor

    lz4, zst = squeezed(LZ4FrameCompressor()), squeezed(zstd.ZstdCompressor())
    with pytest.MonkeyPatch.context() as other:
        other.setattr(bags.bz2, "compress", lambda chunk: squeezed(bags.bz2.BZ2Compressor()))
        bz2 = bags.bag_of_one(b"\x01" + PARSERS["ros1"].seeds(Path(tempfile.mkdtemp()))[2][2:])
    return {
        "says.mcap": chunked(b"abc", "", 1 << 62), "lies.mcap": chunked(lz4, "lz4", 100), "bz2.bag": bz2,
        "lz4.mcap": chunked(lz4, "lz4", ZEROS), "zstd.mcap": chunked(zst, "zstd", ZEROS),
        "run/bag/bag_0.mcap": chunked(zst, "zstd", 100), "run/config.toml": b"",
    }  # fmt: skip


def test_chunks_that_would_fill_the_memory_are_refused_in_one_line(tmp_path, monkeypatch, capsys):
    from sixthsense.sources.logs import decompress

    monkeypatch.chdir(tmp_path)
    for name, content in bombs().items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_bytes(content)
    monkeypatch.setattr(decompress, "_LARGEST_CHUNK", ZEROS - 1)
    seen = []
    whole = decompress.decompressed
    monkeypatch.setattr(decompress, "decompressed", lambda data, name: seen.append(name) or whole(data, name))
    for name in ("lies.mcap", "lz4.mcap", "zstd.mcap", "bz2.bag"):
        assert f"found a chunk of over {ZEROS - 1} bytes" in one_line(["replay", name], capsys)
    assert sorted(set(seen)) == ["bz2", "lz4", "zstd"]
    assert "says.mcap: cannot be read as a bag" in one_line(["replay", "says.mcap"], capsys)
    assert "before it ends, allowed: a bag of a run" in one_line(["replay", "run"], capsys)


def test_repeated_decompression_of_chunks_is_refused_in_one_line(tmp_path, monkeypatch):
    from sixthsense.sources.logs import decompress

    parser = PARSERS["mcap"]
    seed = parser.seeds(tmp_path)[2]
    assert attempt(parser, tmp_path, seed)
    monkeypatch.setattr(decompress, "_BASE_BUDGET", 0)
    monkeypatch.setattr(decompress, "_BUDGET_PER_BYTE", 0)
    with pytest.raises(ValueError, match="found chunks that hold far more than the file"):
        parser.read(tmp_path, parser.form(seed))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("name", ["x.bag", "x.mcap", "x.db3", "run/bag/bag_0.mcap", "bag/x.mcap", "m.pgm", "x.log"])
def test_a_silent_pipe_and_an_endless_device_are_refused(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for folder in ("run/bag", "bag"):
        Path(folder).mkdir(parents=True)
    Path("run/config.toml").write_text("")
    Path("bag/metadata.yaml").write_text("")
    Path("m.yaml").write_text(MAP)
    command = ["run", "m.yaml"] if name == "m.pgm" else ["replay", name.split("/")[0]]
    os.mkfifo(name)
    assert f"{name}: is a " in one_line(command, capsys)
    Path(name).unlink()
    Path(name).symlink_to("/dev/zero")
    assert f"{name}: is a " in one_line(command, capsys)


@pytest.mark.parametrize("kind", ["ros1", "mcap", "db3", "run-bag"])
@pytest.mark.parametrize(("was", "is_now"), [(0.2, 1e300), (0.2, float("nan")), (0.1, 1e308)])
def test_poses_whose_squares_overflow_are_refused_without_a_warning(kind, was, is_now, tmp_path):
    parser = PARSERS[kind]
    seed = parser.seeds(tmp_path)[-1]
    damaged = seed.replace(struct.pack("<d", was), struct.pack("<d", is_now))
    assert damaged != seed
    assert not attempt(parser, tmp_path, damaged)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("command", ["run x.toml", "run x.scn", "run x.yaml", "run --config x.toml"])
def test_a_pipe_is_refused_as_a_scene_and_as_a_configuration(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    os.mkfifo(command.split()[-1])
    assert f"{command.split()[-1]}: is a pipe" in one_line(command.split(), capsys)


def test_a_range_that_overflows_float32_is_no_return_and_gives_no_warning(tmp_path):
    parser = PARSERS["carmen"]
    assert attempt(parser, tmp_path, parser.seeds(tmp_path)[0].replace(b"81.8", b"1e308"))
