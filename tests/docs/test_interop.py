"""Whether programs that are not ours read what a run leaves, a part for each, of one short run.

evo reads the trajectories, GTSAM the factor graph, map_server the map, rosbags and mcap the bag, pandas the tables.
"""

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import yaml
from PIL import Image

from sixthsense.config import preset
from sixthsense.evaluation.measure import measure
from sixthsense.loop.run import run
from sixthsense.record.bag import TOPICS, BagWriter
from sixthsense.record.folder import RunFolder
from sixthsense.record.trace import Trace

CONFIG = preset(task="tour", scene="apartment", estimator="isam2", max_time=30.0, seed=3)

# evo keeps its settings in the home, which is one of the test's own: hence a process of its own.
EVO = """
import json
import sys
from copy import deepcopy as copy
from evo.core import sync
from evo.core.metrics import PoseRelation, Unit
from evo.main_ape import ape
from evo.main_rpe import rpe
from evo.tools import file_interface

truth, estimate = (file_interface.read_tum_trajectory_file(f"{sys.argv[1]}/{n}.tum") for n in ("truth", "estimate"))
poses = truth.num_poses, estimate.num_poses
checks = truth.check()[0] and estimate.check()[0]
truth, estimate = sync.associate_trajectories(truth, estimate)
error = ape(truth, estimate, PoseRelation.translation_part)
pairs = {"delta_unit": Unit.meters, "all_pairs": True, "pairs_from_reference": True}
relative = {
    f"rpe_{name}_{length}m": rpe(copy(truth), copy(estimate), relation, delta=float(length), **pairs).stats["rmse"]
    for name, relation in (("trans_m", PoseRelation.translation_part), ("rot_deg", PoseRelation.rotation_angle_deg))
    for length in (1, 2, 5, 10)
}
print(json.dumps({
    "poses": poses, "matched": truth.num_poses, "checks": bool(checks), "rmse": error.stats["rmse"],
    "relative": relative,
}))
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Trace]:
    folder = tmp_path_factory.mktemp("runs") / "run"
    with RunFolder(folder, CONFIG) as out:
        with BagWriter(out.partial) as bag:
            trace = run(CONFIG, bag)
        out.write(trace, measure(trace))
        out.finish()
    return folder, trace


@pytest.fixture(scope="module")
def evo(recorded, tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What evo makes of the run's folder."""
    pytest.importorskip("evo", reason="needs evo: pip install evo")
    home = tmp_path_factory.mktemp("home")
    # Matplotlib's own folder stays where it is: a new one would first list all fonts.
    environment = os.environ | {"HOME": str(home), "USERPROFILE": str(home), "MPLCONFIGDIR": matplotlib.get_cachedir()}
    done = subprocess.run(
        [sys.executable, "-c", EVO, str(recorded[0])], env=environment, cwd=home, capture_output=True, text=True,
        check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def map_server(file: Path) -> tuple[np.ndarray, float, list[float]]:
    """Occupancy (H, W), row 0 at the bottom, resolution and origin, by the rule on map_server's page for `trinary`."""
    table = yaml.safe_load(file.read_text())
    with Image.open(file.parent / table["image"]) as image:
        shade = np.asarray(image.convert("L"), dtype=float) / 255.0
    occupied = shade if table["negate"] else 1.0 - shade
    cells = np.where(occupied > table["occupied_thresh"], 100, np.where(occupied < table["free_thresh"], 0, -1))
    return cells[::-1], table["resolution"], table["origin"]


def expected_counts(trace: Trace) -> dict[str, int]:
    """Messages per topic."""
    ticks = round((trace.stamps_ns[-1] - trace.stamps_ns[0]) * 1e-9 / CONFIG.robot.control_period_s) + 1
    scans, keyframes, plans = len(trace.stamps_ns), len(trace.key_stamps_ns), len(trace.plans)
    counts = {"/tf_static": 1, "/odom": ticks, "/truth": ticks, "/scan": scans, "/estimate": keyframes, "/plan": plans}
    assert min(counts.values()) > 0
    return counts


# evo


def test_evo_finds_the_same_absolute_error_as_the_metrics(recorded, evo):
    folder, trace = recorded
    ours = json.loads((folder / "metrics.json").read_text())["ate_rmse_m"]
    assert ours > 1e-4
    assert evo["rmse"] == pytest.approx(ours, abs=1e-6)
    assert evo["poses"] == [len(trace.truths)] * 2 and evo["matched"] == len(trace.truths)


def test_evo_finds_the_same_relative_errors_as_the_metrics(recorded, evo):
    ours = json.loads((recorded[0] / "metrics.json").read_text())
    assert evo["relative"] == pytest.approx({key: ours[key] for key in ours if key.startswith("rpe_")}, rel=1e-3)
    assert len(evo["relative"]) == 8


# map_server


def test_the_map_has_a_wall_where_the_robot_saw_one_and_is_free_where_it_drove(recorded):
    """In metres from the file's own origin: no index of ours is used."""
    folder, trace = recorded
    cells, cell_m, (x, y, _) = map_server(folder / "map.yaml")

    def at(points: np.ndarray) -> np.ndarray:
        columns, rows = (np.floor((points - (x, y)) / cell_m).astype(int)).T
        return cells[rows, columns]

    assert np.all(at(np.array(trace.estimates)[:, :2]) == 0)
    rows, columns = np.nonzero(cells == 100)
    centres = np.column_stack([columns, rows]) * cell_m + (x, y) + 0.5 * cell_m
    starts, ends = trace.scene.walls[:, 0], trace.scene.walls[:, 1]
    along = ends - starts
    t = np.einsum("nmk,mk->nm", centres[:, None] - starts, along) / np.einsum("mk,mk->m", along, along)
    gaps = np.linalg.norm(starts + np.clip(t, 0.0, 1.0)[:, :, None] * along - centres[:, None], axis=2).min(axis=1)
    assert np.mean(gaps < 0.1) > 0.95


# rosbags and mcap


def test_rosbags_opens_the_bag_and_finds_every_message(recorded):
    from rosbags.highlevel import AnyReader

    folder, trace = recorded
    with AnyReader([folder / "bag"]) as reader:
        assert {c.topic: c.msgtype for c in reader.connections} == TOPICS
        assert {c.topic: c.msgcount for c in reader.connections} == expected_counts(trace)
        found = [c.topic for c, _, raw in reader.messages() if reader.deserialize(raw, c.msgtype)]
        assert Counter(found) == expected_counts(trace)
        assert (reader.start_time, reader.end_time) == (trace.stamps_ns[0], trace.stamps_ns[-1] + 1)
