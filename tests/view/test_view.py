import http.client
import os
import signal
import subprocess
import sys
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from driven import config as driven_config
from driven import mirrored

import sixthsense as ss
from sixthsense.cli import main
from sixthsense.config import preset
from sixthsense.logs.log import Log
from sixthsense.loop.run import run

pytest.importorskip("rerun", reason="needs the viewer: pip install -e '.[view]'")

SHOWN = {
    "true/walls", "true/robot", "true/driven", "robot", "robot/body", "scan", "pose", "grid", "frontiers", "plan",
    "driven", "features/walls", "features/points", "landmarks/points", "landmarks/ellipses", "landmarks/walls",
}  # fmt: skip
PLOTS = {"nees/pose", "nees/low", "nis/per_dof", "timing/update", "timing/grid"}


@pytest.fixture(autouse=True)
def strict(monkeypatch):
    """Rerun raises where it would otherwise warn."""
    monkeypatch.setenv("RERUN_STRICT", "1")


def rows(file: Path) -> dict[str, int]:
    """The entities of a recording, and how many rows each has."""
    from rerun.chunk import RrdReader

    counts: dict[str, int] = {}
    for chunk in RrdReader(str(file)).stream().to_chunks():
        path = str(chunk.entity_path)
        counts[path] = counts.get(path, 0) + chunk.num_rows
    return counts


def test_the_file_of_a_run_has_all_entities(tmp_path):
    file = tmp_path / "deep" / "one.rrd"
    words = ["--max-time", "6", "--seed", "3", "--out", str(tmp_path / "one"), "--view", str(file)]
    assert main(["run", "apartment", *words]) == 0
    counts = rows(file)
    assert set(counts) >= {"/map", *(f"/map/{name}" for name in SHOWN), *(f"/plots/{name}" for name in PLOTS)}
    assert counts["/map/scan"] == 61  # every scan
    assert 5 <= counts["/map/grid"] <= 10  # once a second, and what names its classes
    assert counts["/plots/nis/low"] == counts["/plots/nis/high"] == counts["/plots/nis/per_dof"]


def test_the_view_does_not_change_the_run(tmp_path):
    config = preset(scene="rectangle", task="goal", goal=(1.2, 0.5), estimator="isam2", seed=4)
    with ss.View(tmp_path / "run.rrd") as view:
        watched = run(config, view)
    np.testing.assert_array_equal(watched.estimates, run(config).estimates)
    assert watched.live is None


def test_a_run_works_without_rerun():
    code = (
        "import sys; sys.modules['rerun'] = None; sys.modules['rerun_cli'] = None\n"
        "import sixthsense as ss; from sixthsense.cli import main\n"
        "ss.run(ss.preset(scene='rectangle', max_time=0.5)); ss.View\n"
        "assert main(['scenes']) == 0"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)


def test_the_page_for_browsers_is_on_the_loopback_shows_its_stream_to_it_alone_and_sends_no_usage_statistics():
    from sixthsense.view.viewer import Viewer

    viewer = Viewer("browser")
    try:
        page = urllib.parse.urlsplit(viewer.page)
        assert page.hostname == "127.0.0.1" and urllib.parse.parse_qs(page.query)["url"] == [viewer.stream]
        with urllib.request.urlopen(viewer.page) as answer:
            assert b"<canvas" in answer.read()
        port = int(viewer.stream.rpartition(":")[2].partition("/")[0])
        for origin, is_allowed in ((f"http://{page.netloc}", True), ("http://example.com", False)):
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
            headers = {"Origin": origin, "Access-Control-Request-Method": "POST"}
            connection.request("OPTIONS", "/proxy", headers=headers)
            allowed = connection.getresponse().headers.get("access-control-allow-origin")
            assert (allowed in (origin, "*")) is is_allowed
            connection.close()
        if Path("/proc/net/tcp").is_file():
            listening = [line.split()[1] for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
            for own in (port, page.port):
                assert [where[:8] for where in listening if where.endswith(f":{own:04X}")][:1] == ["0100007F"]
            environment = Path(f"/proc/{viewer._process.pid}/environ").read_bytes().split(b"\0")
            assert {b"CI=1", b"TELEMETRY_ENABLED=false"} <= set(environment)
            assert not any(entry.startswith(b"FORCE_RERUN_ANALYTICS") for entry in environment)
    finally:
        viewer.end()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(viewer.page)


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="needs /proc")
def test_a_run_continues_after_its_viewer_is_closed(tmp_path, monkeypatch):
    monkeypatch.setattr("sixthsense.view.recording._FLUSH_S", 1.0)
    with ss.View("browser") as view:
        pid = view._viewer._process.pid
        for program in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            os.kill(int(program), signal.SIGKILL)
        view._viewer._process.wait()
        trace = run(preset(scene="rectangle", max_time=1.0), view)
    assert trace.estimates


def test_what_speaks_against_the_map_is_shown(tmp_path):
    with ss.View(tmp_path / "run.rrd") as view:
        made = ss.replay(Log(mirrored()), driven_config(), on_tick=view, progress=False)
        view.finish()
    assert made.verdict.level == "broken" and rows(tmp_path / "run.rrd")["/map/doubts"] >= 1
