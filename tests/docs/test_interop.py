"""Whether evo finds in the trajectories of a short run what its metrics say.

What GTSAM, rosbags and map_server read is compared in `tests/record/test_round_trips.py`.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import matplotlib
import pytest

from sixthsense.config import preset
from sixthsense.evaluation.measure import measure
from sixthsense.loop.run import run
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
        trace = run(CONFIG)
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


def test_evo_finds_the_same_absolute_error_as_the_metrics(recorded, evo):
    folder, trace = recorded
    ours = json.loads((folder / "metrics.json").read_text())["ate_rmse_m"]
    assert ours > 1e-4 and evo["checks"]
    assert evo["rmse"] == pytest.approx(ours, abs=1e-6)
    assert evo["poses"] == [len(trace.truths)] * 2 and evo["matched"] == len(trace.truths)


def test_evo_finds_the_same_relative_errors_as_the_metrics(recorded, evo):
    ours = json.loads((recorded[0] / "metrics.json").read_text())
    assert evo["relative"] == pytest.approx({key: ours[key] for key in ours if key.startswith("rpe_")}, rel=1e-3)
    assert len(evo["relative"]) == 8
