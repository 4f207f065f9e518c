"""Which runs a campaign plans, what its folder refuses, and which workers may make its runs; none is made here."""

import dataclasses
import re
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import tomli_w
from settings import changed, flat, nested

import sixthsense as ss
from sixthsense import cli
from sixthsense.campaigns import plan as worker
from sixthsense.campaigns.folder import CampaignRows, check_folder, save_folder
from sixthsense.campaigns.plan import CampaignPlan, campaign_of, config_hash, plan, scene_digest, seed_range
from sixthsense.config import Config, merge
from sixthsense.config.errors import InputError
from sixthsense.evaluation.curves import CURVES
from sixthsense.slam.estimators.ekf import EKF

pytestmark = pytest.mark.usefixtures("here")

AXES = {"scene": ["rectangle"], "estimator": ["ekf"], "preset": ["worn"], "planner": ["astar"]}
FIELDS = {"task": "tour", "max_time": 4.0, "laser": {"mount": [0.1, -0.2, 0.3]}, "features": {"deskew": False}}
SCENE: dict[str, Any] = {
    "start": [-1.0, -1.5, 0.5], "radius": 0.15, "goal": [1.0, 1.25], "region": [-2.0, -3.0, 2.5, 3.5],
    "tour": [[1.0, -1.0], [-1.0, 1.0]], "walls": [[-2.0, 3.0, 2.0, 3.25]], "glass": [[-2.0, -2.5, 2.0, -2.75]],
    "walkers": [{"points": [[0.5, -1.25], [0.5, 1.75]], "speed": 0.8, "pauses": [1.0, 2.0]}],
}  # fmt: skip


@pytest.mark.parametrize("text", ["", "3:3", "4:3", "-1:3", "1:2:3", "a", "0:100001", "1.5"])
def test_what_is_no_range_of_seeds_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"^seeds: found "):
        seed_range(text)
    assert seed_range("7") == range(7, 8) and len(seed_range("1:100001")) == 100_000


def test_a_plan_is_the_product_of_its_axes_each_run_once_and_seed_by_seed() -> None:
    axes = {"scene": ["rectangle", "block"], "estimator": ["ekf", "isam2"], "preset": ["default", "worn"]}
    runs = plan(campaign_of({**AXES, **axes, "planner": ["astar", "astar"]}, [4, 2, 4], FIELDS))
    assert len({(run.scene, run.estimator, run.preset, run.seed) for run in runs.values()}) == len(runs) == 16
    assert [run.seed for run in runs.values()] == 8 * [4] + 8 * [2]
    assert all(config_hash(run) == key for key, run in runs.items())
    for run in runs.values():
        base = merge(ss.preset(run.preset), {**FIELDS, "scene": run.scene, "seed": run.seed})
        assert run == merge(base, {"estimator": run.estimator})
    with pytest.raises(InputError, match="found 100001 runs, allowed: at most 100000"):
        plan(CampaignPlan({axis: tuple(values) for axis, values in AXES.items()}, tuple(range(100_001)), FIELDS))


def test_the_hash_of_a_configuration_tells_every_field() -> None:
    hashes = {config_hash(Config())}
    hashes |= {config_hash(merge(Config(), nested({name: value}))) for name, value in changed().items()}
    assert len(hashes) == 1 + len(flat(Config()))
    assert all(re.fullmatch("[0-9a-f]{16}", one) for one in hashes)


def scene_file(name: str = "hall.toml", **changes: Any) -> str:
    Path(name).write_text(tomli_w.dumps({**SCENE, **changes}))
    return name


@pytest.mark.parametrize("name", SCENE)
def test_the_hash_of_a_scene_tells_all_that_it_holds_and_not_its_name(name: str) -> None:
    others: dict[str, Any] = {"radius": 0.16, "walkers": [{**SCENE["walkers"][0], "speed": 0.9}]}
    value = others.get(name) or (np.array(SCENE[name]) * 1.01).tolist()
    one, again = scene_digest(scene_file()), scene_digest(scene_file("other.toml"))
    assert one == again != scene_digest(scene_file(**{name: value}))


@pytest.fixture
def done() -> CampaignPlan:
    """The folder mc as of two estimators over three seeds in two scenes, whose errors are made up."""
    planned = campaign_of({**AXES, "scene": [scene_file(), "loop"], "estimator": ["ekf", "isam2"]}, range(3), FIELDS)
    save_folder(Path("mc"), check_folder(Path("mc"), planned))
    for key, run in plan(planned).items():
        error = 1.0 + run.seed + 10.0 * (run.estimator == "isam2")
        row = {**worker.row_of(run), "config_hash": key, "outcome": "tour ended", "host": "h", "version": "1"}
        row["ate_rmse_m"] = error
        row |= {f"rpe_{part}_{m}m": error * m for part in ("trans_m", "rot_deg") for m in (1, 2)}
        columns = np.arange(4.0), 0.5 * np.arange(4.0), error, 0.1, 3.0
        curves = pd.DataFrame(dict(zip(CURVES, columns, strict=True)))
        CampaignRows(Path("mc")).add({**row, worker.CURVES: curves})
    return planned


def call(**changes: Any) -> ss.Campaign:
    given: dict[str, Any] = {"estimator": ["ekf", "isam2"], "preset": "worn", "out": "mc", **FIELDS, **changes}
    return ss.campaign(given.pop("scenes", ["hall.toml", "loop"]), seeds=given.pop("seeds", range(3)), **given)


class Own(EKF):
    """An estimator that a campaign can name."""

    @dataclasses.dataclass(frozen=True)
    class Options:
        gain: float = 1.0


REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "another value": (lambda: call(max_time=5.0), "a campaign with max_time = 4.0, found 5.0"),
    "one more field": (lambda: call(keyframes={"turn_rad": 0.2}), "keyframes.turn_rad = the preset's, found 0.2"),
    "another scene of that name": (lambda: (scene_file(glass=[]), call()), "a campaign with .*hall.toml = .*, found "),
    "a file": (lambda: call(out="hall.toml"), "is a file"),
    "a seed below 0": (lambda: call(seeds=[-1]), "^seeds: found -1"),
    "a programs own": (lambda: call(planner="__main__:Own"), "^planner: found __main__:Own, which is of the program"),
    "unknown options": (
        lambda: call(estimator=f"{__name__}:Own", estimator_options={"x": 1}),
        "^estimator_options.x: no such field, allowed: gain",
    ),
    "a goal in a wall": (lambda: call(task="goal", goal=(1.0, 3.1)), r"^goal: found \(1, 3\.1\), .* from a wall"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_campaign_that_contradicts_itself_or_its_folder_is_refused(name: str, done: CampaignPlan) -> None:
    assert len(call()) == 12  # nothing is missing, and none is repeated
    before = {file: file.read_bytes() for file in Path("mc").rglob("*") if file.is_file()}
    ask, said = REFUSED[name]
    with pytest.raises(ss.InputError, match=said):
        ask()
    assert {file: file.read_bytes() for file in Path("mc").rglob("*") if file.is_file()} == before


def planned(monkeypatch: pytest.MonkeyPatch, line: str) -> CampaignPlan:
    """The plan that a command line makes."""
    plans: list[CampaignPlan] = []

    def stop(one: CampaignPlan, *_: Any, **__: Any) -> None:
        plans.append(one)
        raise InputError("campaign", "is planned")

    monkeypatch.setattr("sixthsense.campaigns.call.complete", stop)
    assert cli.main(["campaign", *line.split()]) == cli.BAD_INPUT
    return plans[0]


def test_any_part_is_an_axis_and_without_a_value_follows_from_the_preset(monkeypatch: pytest.MonkeyPatch) -> None:
    line = (
        "loop --seeds 3:5 --preset worn --estimator isam2 --front-end landmarks scan-matching --explorer random --out c"
    )
    one = planned(monkeypatch, line)
    assert one.values["front_end"] == ("landmarks", "scan-matching") and one.values["explorer"] == ("random",)
    assert "extractor" not in one.values and "front_end" not in one.fields
    runs = list(plan(one).values())
    expected = [(seed, name) for seed in (3, 4) for name in ("landmarks", "scan-matching")]
    assert [(run.seed, run.front_end) for run in runs] == expected
    assert {(run.explorer, run.extractor, run.estimator) for run in runs} == {("random", "lines", "isam2")}
    both = campaign_of({"scene": ["loop"], "front_end": ["landmarks", "scan-matching"]}, [3], {})
    assert both.values["estimator"] == ("isam2",) and len(plan(both)) == 2
    with pytest.raises(InputError, match="front_end: found scan-matching with estimator ekf"):
        plan(CampaignPlan({**one.values, "estimator": ("ekf",)}, one.seeds, one.fields))


# An executor of the caller's


class Elsewhere(ThreadPoolExecutor):
    """Workers that make the runs as this process does, but for what they say of themselves."""

    said: Mapping[str, str] = {}

    def submit(self, function: Any, /, *args: Any, **kwargs: Any) -> Any:
        said = self.said if function is worker.described else {}
        return super().submit(lambda: function(*args, **kwargs) | said)


@pytest.mark.parametrize(("said", "refused"), [
    ({"python": "2.7"}, r"^executor: found {'python': '2.7'}, allowed: {'python': '3"),
    ({"rectangle": "another"}, "^executor: found {'rectangle': 'another'}, allowed"),
    (None, "^executor: found no usable sixthsense"),
])  # fmt: skip
def test_workers_of_an_executor_that_would_make_other_runs_are_refused(said: Any, refused: str) -> None:
    with Elsewhere(1) as pool, pytest.raises(InputError, match=refused):
        pool.said = said
        ss.campaign("rectangle", seeds=[3], out="mc", executor=pool, workers=1, progress=False)
    assert not Path("mc").exists()


SHORT: dict[str, Any] = {"task": "tour", "max_time": 2.0, "progress": False, "out": "mc"}


@pytest.mark.usefixtures("compiled")
def test_an_executor_of_the_callers_makes_the_runs_and_is_left_open() -> None:
    with Elsewhere(2) as pool:
        frame = ss.campaign("rectangle", seeds=range(3), executor=pool, workers=2, **SHORT).frame()
        assert pool.submit(dict, a=1).result() == {"a": 1}
    assert frame["seed"].tolist() == [0, 1, 2] and set(frame["outcome"]) == {"tour ended"}


@pytest.mark.usefixtures("compiled")
def test_a_dask_client_makes_the_runs() -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.Client(n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
        done = ss.campaign("rectangle", seeds=range(2), executor=client.get_executor(pure=False), workers=1, **SHORT)
    assert set(done.frame()["outcome"]) == {"tour ended"}
