"""Which runs a campaign plans, what its folder refuses, and which workers may make its runs; none is made here."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import tomli_w
from settings import changed, flat, nested

import sixthsense as ss
from sixthsense import campaigns, cli
from sixthsense.campaigns import CampaignPlan, CampaignRows, worker
from sixthsense.campaigns.folder import check_folder, read_folder, save_folder
from sixthsense.campaigns.plan import campaign_of, config_hash, plan, scene_digest, seed_range
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
    assert (
        scene_digest(scene_file())
        == scene_digest(scene_file("other.toml"))
        != scene_digest(scene_file(**{name: value}))
    )


# Folders


@pytest.fixture
def done() -> CampaignPlan:
    """The folder mc as of two estimators over three seeds in two scenes, whose errors are made up."""
    planned = campaign_of({**AXES, "scene": [scene_file(), "loop"], "estimator": ["ekf", "isam2"]}, range(3), FIELDS)
    save_folder(Path("mc"), check_folder(Path("mc"), planned))
    for key, run in plan(planned).items():
        error = 1.0 + run.seed + 10.0 * (run.estimator == "isam2")
        row = {**worker.row_of(run), "config_hash": key, "outcome": "tour ended", "host": "h", "version": "1"}
        row |= {
            "ate_rmse_m": error,
            **{f"rpe_{part}_{m}m": error * m for part in ("trans_m", "rot_deg") for m in (1, 2)},
        }
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
    "another folder": (lambda: (Path("a").mkdir(), Path("a/b").touch(), call(out="a")), "not a campaign folder"),
    "no seed": (lambda: call(seeds=[]), r"^seeds: found \(\)"),
    "a seed below 0": (lambda: call(seeds=[-1]), "^seeds: found -1"),
    "one number": (lambda: call(seeds=3), "^seeds: found 3"),
    "a seed as a field": (lambda: call(seed=1), "^seed: found for a campaign, allowed: seeds"),
    "an own estimator": (lambda: call(estimator=[lambda start, cov: None]), "^estimator: found .*<lambda>, allowed"),
    "a programs own": (lambda: call(planner="__main__:Own"), "^planner: found __main__:Own, which is of the program"),
    "unknown options": (
        lambda: call(estimator=f"{__name__}:Own", estimator_options={"x": 1}),
        "^estimator_options.x: no such option, allowed: gain",
    ),
    "no worker": (lambda: call(workers=0), "^workers: found 0, allowed: 1 to 1024"),
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


@pytest.mark.parametrize(("old", "new", "said"), [
    ("[scenes]", "[scenes", "is not TOML"), ("[fields", "[other", "campaign.toml: fields"),
    ('loop = "', 'loop = 3 # "', "scenes.loop: found 3, allowed: a text"),
])  # fmt: skip
def test_a_damaged_table_of_a_campaign_is_named(done: CampaignPlan, old: str, new: str, said: str) -> None:
    text = Path("mc/campaign.toml").read_text()
    assert old in text
    Path("mc/campaign.toml").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=said):
        ss.load_campaign("mc")


def test_the_folder_keeps_the_scenes_of_earlier_commands(done: CampaignPlan) -> None:
    more = campaign_of({**AXES, "scene": ["block"], "estimator": ["ekf-invariant"]}, [7], FIELDS)
    save_folder(Path("mc"), check_folder(Path("mc"), more))
    assert read_folder(Path("mc")).scenes == done.digests() | more.digests()


def test_a_campaign_is_compared_in_groups_over_its_seeds(done: CampaignPlan, explored: ss.Run) -> None:
    made = ss.load_campaign("mc")
    lines = ss.compare(made).plot("error", by=["scene", "estimator"]).axes[0].get_lines()
    assert [line.get_label() for line in lines] == [
        "hall · ekf, 3 runs", "hall · isam2, 3 runs", "loop · ekf, 3 runs", "loop · isam2, 3 runs"
    ]  # fmt: skip
    assert [line.get_ydata()[0] for line in lines] == [2.0, 12.0, 2.0, 12.0]
    together = ss.compare({"study": made, "alone": explored})
    assert len(together) == 13 and len(together.runs) == 1
    assert together.frame().loc["study"].groupby("estimator")["ate_rmse_m"].median().tolist() == [2.0, 12.0]
    sample = next(one for one in made.samples("mc") if one.config.seed == 2 and one.config.estimator == "isam2")
    assert sample.config == merge(
        ss.preset("worn"), {**FIELDS, "estimator": "isam2", "seed": 2, "scene": sample.config.scene}
    )
    assert sample.curves().time_s.tolist() == [0.0, 1.0, 2.0, 3.0]


# The command


def planned(monkeypatch: pytest.MonkeyPatch, line: str) -> CampaignPlan:
    """The plan that a command line makes."""
    plans: list[CampaignPlan] = []
    monkeypatch.setattr(campaigns, "complete", lambda one, *_, **__: plans.append(one))
    assert cli.main(["campaign", *line.split()]) == cli.DONE
    return plans[0]


def test_any_part_is_an_axis_and_without_a_value_follows_from_the_preset(monkeypatch: pytest.MonkeyPatch) -> None:
    line = (
        "loop --seeds 3:5 --preset worn --estimator isam2 --front-end landmarks scan-matching --explorer random --out c"
    )
    one = planned(monkeypatch, line)
    assert one.values["front_end"] == ("landmarks", "scan-matching") and one.values["explorer"] == ("random",)
    assert "extractor" not in one.values and "front_end" not in one.fields
    runs = list(plan(one).values())
    assert [(run.seed, run.front_end) for run in runs] == [
        (seed, name) for seed in (3, 4) for name in ("landmarks", "scan-matching")
    ]
    assert {(run.explorer, run.extractor, run.estimator) for run in runs} == {("random", "lines", "isam2")}
    both = campaign_of({"scene": ["loop"], "front_end": ["landmarks", "scan-matching"]}, [3], {})
    assert both.values["estimator"] == ("isam2",) and len(plan(both)) == 2
    with pytest.raises(InputError, match="front_end: found scan-matching with estimator ekf"):
        plan(CampaignPlan({**one.values, "estimator": ("ekf",)}, one.seeds, one.fields))
