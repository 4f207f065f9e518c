import random
import shutil
import tempfile
import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sixthsense import cli
from sixthsense.config import ConfigError, load_config
from sixthsense.scene import SceneError, load_scene

with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(str(Path(__file__).resolve().parent.parent / "benchmarks"))
    from fuzz import attempt, mutate
    from parsers import PARSERS

SLOW = ("ros1", "mcap", "db3", "run-bag")


@pytest.mark.parametrize("name", PARSERS)
def test_damaged_files_and_noise_make_a_result_or_one_line(name):
    parser = PARSERS[name]
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
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
    ("replay x.bag", {"x.bag": NOISE}, "x.bag: cannot be read as a bag"),
    ("replay x.mcap", {"x.mcap": NOISE}, "x.mcap: cannot be read as a bag"),
    ("replay x.db3", {"x.db3": NOISE}, "x.db3: cannot be read as a bag"),
    ("replay run", {"run/config.toml": ""}, "run/bag/bag_0.mcap: no such file"),
    ("replay run", {"run/config.toml": "", "run/bag/bag_0.mcap": NOISE}, "run/bag/bag_0.mcap: is no MCAP file"),
    ("replay run", {"run/config.toml": NOISE}, "run/config.toml: is not UTF-8 text"),
    ("report run", {"run/config.toml": NOISE}, "run/config.toml: is not UTF-8 text"),
    ("report run", {"run/config.toml": "", "run/bag/bag_0.mcap": NOISE}, "run/bag/bag_0.mcap: is no MCAP file"),
    ("run a\nb.toml", {}, r"scene: found 'a\nb.toml', allowed: a name without line breaks"),
    ("run --out a\udcff", {}, r"--out: found 'a\udcff', allowed: a name without line breaks"),
    ("run --a\nb 1", {}, r"'--a\nb': no such option"),
]


@pytest.mark.parametrize(
    ("line", "files", "said"), BAD_FILES, ids=[f"{k}-{row[0]!r}" for k, row in enumerate(BAD_FILES)]
)
def test_a_bad_file_ends_in_one_line_and_writes_nothing(line, files, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, content in files.items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
    assert said in one_line(line.split(" "), capsys)


def test_a_scene_and_a_configuration_of_deep_or_endless_values_are_refused_in_a_short_line(tmp_path):
    for text in (f"walls{'.a' * 3000} = 1", f"radius = {'[' * 500}{']' * 500}", f"goal = '{'x' * 10**6}'"):
        (tmp_path / "s.toml").write_text(ROOM.split("walls")[0].replace("radius = 0.2", "") + text)
        with pytest.raises(SceneError) as scene:
            load_scene(tmp_path / "s.toml")
        (tmp_path / "c.toml").write_text(text.replace("walls", "preset").replace("radius", "seed"))
        with pytest.raises(ConfigError) as config:
            load_config(tmp_path / "c.toml")
        assert len(str(scene.value)) < 500 and len(str(config.value)) < 500


def test_a_bag_whose_types_lack_their_fields_ends_in_one_line(tmp_path):
    parser = PARSERS["ros1"]
    seed = parser.seeds(tmp_path)[0]
    for field in (b"float32[] ranges", b"float32 angle_min", b"float32 range_max"):
        assert field in seed
        assert not attempt(parser, tmp_path, seed.replace(field, field[:-1] + b"_"))
    shutil.rmtree(tmp_path)
