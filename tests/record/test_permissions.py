import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sixthsense import cli
from sixthsense.running.warmup import warm_up

NOBODY = 65534
ROOM = "start = [1, 1, 0]\nradius = 0.2\nwalls = [[0, 0, 4, 0], [4, 0, 4, 2], [4, 2, 0, 2], [0, 2, 0, 0]]\n"
MAP = "image: m.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
LOG = "FLASER 3 1 1 2 0 0 0 0 0 0 1 h 1\n"
LASER = "--laser.beams 3 --laser.fov 1"


@pytest.fixture(scope="module")
def place() -> Iterator[Path]:
    """A folder with good input and a run, which any user can enter and write into."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o777)
        os.chdir(folder)
        files = {
            "s.toml": ROOM, "s.scn": "1 1 0 0.2\n0 0 4 0\n", "m.yaml": MAP, "m.pgm": "P2 2 2 255\n0 0 0 255",
            "c.toml": "seed = 1", "x.log": LOG, "r": "1 1 0 0 0 0 0 0\n", "x.bag": "", "x.mcap": "", "x.db3": "",
        }  # fmt: skip
        for name, content in files.items():
            Path(name).write_text(content)
        Path("inside").mkdir()
        Path("inside/s.toml").write_text(ROOM)
        Path("inside/x.log").write_text(LOG)
        Path("locked").mkdir(mode=0o555)
        # All that these commands load is loaded by one who may read it.
        warm_up()
        assert cli.main(["calibrate", "rectangle", "--samples", "20", "--out", "noise.toml"]) == cli.DONE
        assert cli.main(["run", "rectangle", "--max-time", "2", "--out", "good"]) in (cli.DONE, cli.FAILED)
        assert cli.main(["report", "good", "--out", "told"]) == cli.DONE
        for command in ("run s.scn", "run m.yaml", "replay x.bag", "replay x.mcap", "replay x.db3"):
            assert cli.main(command.split()) == cli.BAD_INPUT
        yield Path(folder)
        os.chdir(before)


@contextmanager
def unprivileged() -> Iterator[None]:
    """Within it, the process has the rights of a user whom permissions bind."""
    if os.geteuid() != 0:
        yield
        return
    groups, group = os.getgroups(), os.getegid()
    os.setgroups([])
    os.setegid(NOBODY)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(group)
        os.setgroups(groups)


def content(folder: Path) -> dict[Path, bytes | None]:
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def one_line(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert cli.main(command.split()) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1 and err.startswith("sixthsense: ")
    return err


@pytest.mark.parametrize(
    "command",
    [
        "run rectangle --max-time 1 --out locked/x",
        "run rectangle --max-time 1 --out locked/a/b/x",
        "replay good --out locked/x",
        "calibrate rectangle --samples 20 --out locked/n.toml",
        "report good --out locked/told",
    ],
)
def test_output_into_a_read_only_folder_ends_in_one_line_and_leaves_nothing(command, place, capsys):
    before = content(place)
    with unprivileged():
        said = one_line(command, capsys)
    assert "locked" in said and "Permission denied" in said
    assert content(place) == before


@pytest.mark.parametrize(
    ("command", "file"),
    [
        ("run s.toml", "s.toml"),
        ("run s.scn", "s.scn"),
        ("run m.yaml", "m.yaml"),
        ("run m.yaml", "m.pgm"),
        ("run --config c.toml", "c.toml"),
        (f"replay x.log {LASER}", "x.log"),
        (f"replay x.log --relations r {LASER}", "r"),
        ("replay x.bag", "x.bag"),
        ("replay x.mcap", "x.mcap"),
        ("replay x.db3", "x.db3"),
        ("replay good", "good/config.toml"),
        ("replay good", "good/bag/bag_0.mcap"),
        ("report good", "good/config.toml"),
        ("report good", "good/record.jsonl"),
        ("report good", "good/record.npz"),
        ("report good", "good/landmarks.npz"),
        ("report good", "good/grid.npz"),
        ("report good", "good/metrics.json"),
        ("run inside/s.toml", "inside"),
        (f"replay inside/x.log {LASER}", "inside"),
        ("replay good", "good"),
        ("report good", "good"),
    ],
)
def test_input_that_may_not_be_read_ends_in_one_line_and_leaves_nothing(command, file, place, capsys):
    before, mode = content(place), (place / file).stat().st_mode
    (place / file).chmod(0)
    try:
        with unprivileged():
            said = one_line(command, capsys)
    finally:
        (place / file).chmod(mode)
    assert content(place) == before
    assert Path(file).name in said or Path(file).parts[0] in said
    assert "ermission denied" in said or "unable to open" in said  # as sqlite says it
