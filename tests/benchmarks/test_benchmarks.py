import importlib
import json
import math
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sixthsense.config import RRTStarConfig, preset
from sixthsense.core.geometry import Pose, point_segment_distance
from sixthsense.core.ray_casting import cast_rays
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.sources.scene import load_scene

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def script(monkeypatch, request) -> ModuleType:
    """The benchmark that the test's parameter names, imported as a script is: its folder first on the path."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module(request.param)


def of(name: str):
    return pytest.mark.parametrize("script", [name], indirect=True)


def all_finite(figures: dict[str, float]) -> bool:
    return all(math.isfinite(value) for value in figures.values())


@of("kernels")
def test_ray_casting_is_compared_with_numpy_and_with_a_plain_reference(script):
    figures = script.raycast_figures(poses=6, checked=3)
    assert set(figures) == {
        "raycast_ms_p50", "raycast_numpy_ms_p50", "raycast_speedup_numpy", "raycast_max_difference_m",
    }  # fmt: skip
    assert all_finite(figures)
    assert figures["raycast_max_difference_m"] < 1e-9


@of("kernels")
def test_the_three_ray_casters_agree_on_hits_and_on_misses(script):
    walls = np.array([[[2.0, -1.0], [2.0, 1.0]], [[-3.0, -9.0], [-3.0, 9.0]], [[0.0, 30.0], [1.0, 30.0]]])
    bearings = np.linspace(-3.0, 3.0, 50)
    ranges = [
        caster(Pose(0.1, 0.2, 0.3), bearings, walls, 5.0)
        for caster in (cast_rays, script.cast_rays_numpy, script.cast_rays_plain)
    ]
    assert 0 < np.isinf(ranges[0]).sum() < 50
    np.testing.assert_allclose(ranges[1], ranges[0], atol=1e-9)
    np.testing.assert_allclose(ranges[2], ranges[0], atol=1e-9)


@of("kernels")
def test_extraction_and_insertion_are_timed_per_scan(script):
    figures = script.scan_figures(poses=4)
    assert set(figures) == {"extract_ms_p50", "extract_ms_p99", "grid_add_ms_p50", "grid_add_ms_p99"}
    assert all_finite(figures)


@of("kernels")
def test_the_heap_and_the_kernel_find_the_same_cost(script):
    figures = script.astar_figures(size=60, grids=2, repeats=1)
    assert set(figures) == {
        "astar_ms_mean", "astar_expansions_mean", "astar_expansions_per_s", "astar_heapq_ms_mean",
        "astar_speedup_heapq", "astar_cost_difference",
    }  # fmt: skip
    assert all_finite(figures)
    assert figures["astar_cost_difference"] < 1e-6


@of("kernels")
def test_the_heap_cuts_no_corner_and_reports_missing_paths(script):
    free = np.zeros((2, 2), dtype=np.bool_)
    assert script.search_heapq(free, 0, 3)[0] == math.sqrt(2.0)
    one_wall = np.array([[False, True], [False, False]])
    assert script.search_heapq(one_wall, 0, 3)[0] == 2.0
    two_walls = np.array([[False, True], [True, False]])
    assert script.search_heapq(two_walls, 0, 3)[0] == math.inf


@of("ekf_scaling")
def test_each_map_size_has_its_time_and_its_passes(script, tmp_path):
    figures = script.scaling_figures((10, 20), repeats=3)
    assert set(figures) == {f"n{n}_m10_{what}" for n in (10, 20) for what in ("ms", "pass_ms", "passes")}
    assert all_finite(figures)
    script.save_figure(tmp_path / "curve.png", figures, (10, 20))
    assert (tmp_path / "curve.png").is_file()


@of("tasks")
def test_a_setting_counts_outcomes_and_reduces_the_runs_metrics(script):
    setting = script.Setting("rectangle", "tour", "default", 2, 3.0)
    figures = script.setting_figures(setting)
    assert figures["rectangle.tour.default.outcome.tour_ended"] == 2
    assert figures["rectangle.tour.default.collisions"] == 0
    wanted = {f"rectangle.tour.default.{key}{suffix}" for _, key, suffix, _ in script.COLUMNS}
    assert wanted - set(figures) == {"rectangle.tour.default.goal_error_m_max"}  # a tour has no last goal
    assert all_finite(figures)
    json.dumps(figures)
    cells = script.row(setting, figures)
    assert cells[:2] == ["rectangle.tour.default", "2 tour ended"]
    assert len(cells) == 2 + len(script.COLUMNS)


@of("calibration")
def test_a_calibration_has_figures_before_and_after(script):
    figures = script.world_figures("worn", 1, 5.0, 20)
    assert figures and all_finite(figures)


@of("tasks")
def test_the_names_of_settings_are_unique(script):
    assert len({setting.name for setting in script.SETTINGS}) == len(script.SETTINGS)


@of("planning")
def test_a_star_is_compared_with_dijkstra_on_true_maps(script):
    drawn = script.true_map(load_scene("rectangle"), 0.1)
    figures = script.optimality_figures({"rectangle": drawn}, 2, 5)
    assert figures["optimality.queries"] == 10
    assert figures["optimality.worst_difference_m"] < 1e-9


@of("planning")
def test_dijkstra_cuts_no_corner(script):
    def costs(blocked):
        space = FreeSpace(np.array(blocked), np.array(blocked), (0.0, 0.0), 1.0)
        return script.dijkstra(script.step_graph(space.blocked), space, np.array([0.5, 0.5]))

    assert costs([[False, False], [False, False]])[1, 1] == math.sqrt(2.0)
    assert costs([[False, True], [False, False]])[1, 1] == 2.0
    assert costs([[False, True], [True, False]])[1, 1] == math.inf


@of("planning")
def test_four_planners_have_their_medians_and_a_row_in_the_table(script):
    drawn = script.true_map(load_scene("rectangle"), 0.1)
    figures = script.comparison_figures({"rectangle": drawn}, 4, RRTStarConfig(iterations=500))
    names = [f"{where}.{way}" for where in ("rectangle", "all") for way in ("astar", "astar_shortcut", "rrtstar")]
    assert all_finite(figures)
    assert figures["all.astar.gave_up"] == 0 and figures["all.astar_shortcut.ratio_median"] == 1.0
    assert figures["all.astar.length_m_median"] >= figures["all.astar_shortcut.length_m_median"]
    lines = script.comparison_rows(figures)
    assert {*names, "all.informed"} <= {line[0] for line in lines}
    assert {len(line) for line in lines} == {len(lines[0])}


@of("planning")
def test_turns_count_in_both_directions(script):
    assert script.turns(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [3.0, 0.0]])) == 0.0
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 1.0]])
    assert script.turns(square) == pytest.approx(math.pi)


@of("planning")
def test_a_replan_has_the_cost_of_a_plan_from_scratch(script):
    drawn = script.true_map(load_scene("apartment"), 0.1)
    figures = script.replan_figures(drawn, 4, 2)
    for where in ("ahead", "anywhere"):
        assert figures[f"replan.{where}.worst_difference_m"] < 1e-9
        assert 0.0 <= figures[f"replan.{where}.found_share"] <= 1.0
    assert all_finite(figures)


@of("planning")
def test_queries_in_willow_garage_are_inside_the_building(script, data_dir):
    drawn = script.true_map(script.willow(data_dir / "maps"), 0.2)
    assert len(drawn.cells) > 1000
    assert (drawn.cells.min(axis=0) > 0).all()


@of("harness")
def test_figures_are_written_as_flat_keys_and_printed_beside_their_targets(script, tmp_path, capsys):
    figures = {"speed": 2.5, "other_ms": 1.0}
    script.print_figures(figures, {"speed": ">= 2"})
    script.write_json(tmp_path / "figures.json", figures)
    script.write_json(None, figures)
    assert json.loads((tmp_path / "figures.json").read_text()) == figures
    lines = capsys.readouterr().out.splitlines()
    assert "NumPy" in lines[0]
    assert [line.split() for line in lines[2:]] == [["speed", "2.5", ">=", "2"], ["other_ms", "1"]]


@of("harness")
def test_functions_are_timed_in_alternation(script):
    calls = []
    ms = script.alternate([1, 2], lambda x: calls.append(("a", x)), lambda x: calls.append(("b", x)))
    assert calls == [("a", 1), ("b", 1), ("a", 2), ("b", 2)]
    assert ms.shape == (2, 2)


@of("deskew")
def test_de_skewing_is_compared_with_instant_and_with_skewed_scans(script):
    config = preset(scene="rectangle", task="tour", max_time=4.0)
    for name, changes in script.SETTINGS.items():
        figures = script.setting_figures(name, config, changes, 1)
        assert all_finite(figures)
        assert {f"{name}.{key}" for _, key in script.COLUMNS} < set(figures)
        assert 0.0 < figures[f"{name}.map_rmse_mm_median"] < 60.0


@of("harness")
@pytest.mark.parametrize("jobs", [1, 2])
def test_pooled_results_are_in_the_order_of_the_items_for_any_number_of_processes(script, jobs):
    assert list(script.pooled(math.sqrt, [9.0, 1.0, 4.0], jobs)) == [3.0, 1.0, 2.0]


@of("harness")
def test_an_option_below_its_bound_ends_the_program_with_one_line(script, capsys):
    parser = script.arguments(None)
    parser.add_argument("--max-time", type=float)
    script.check_at_least(parser, parser.parse_args([]), max_time=1.0)
    with pytest.raises(SystemExit):
        script.check_at_least(parser, parser.parse_args(["--max-time", "0.5"]), max_time=1.0)
    assert "--max-time: found 0.5, allowed: at least 1" in capsys.readouterr().err


@of("shared_evidence")
def test_a_bin_with_few_keyframes_is_left_out_of_the_figure(script):
    tour = np.arange(0.0, 31.5)  # 10 keyframes in each of three bins, and two in the last one
    other = np.delete(tour, np.arange(11, 18))  # few in the second
    middles, rows = script.binned([tour, tour], [tour, 2.0 * tour], np.mean)
    assert middles.tolist() == [5.0, 15.0, 25.0]
    assert rows.tolist() == [[4.5, 14.5, 24.5], [9.0, 29.0, 49.0]]
    assert script.binned([tour, other], [tour, other], np.mean)[0].tolist() == [5.0, 25.0]
    gaps = np.where(tour < 10.0, np.nan, tour)
    assert script.binned([gaps], [gaps], np.mean)[0].tolist() == [15.0, 25.0]


@of("narrow_doors")
def test_the_doors_are_as_wide_as_they_are_said_to_be(script):
    for wider_m, angle, thick in [(0.05, 0.0, False), (0.1, 0.5, True), (0.17, 0.8, True)]:
        scene = script.two_rooms(script.Case(wider_m, angle, thick, 0))
        across = np.array([math.cos(angle), math.sin(angle)])
        for depth in (0.0, 0.5 * script.THICK_M) if thick else (0.0,):
            middle = script.DOOR + depth * across
            assert point_segment_distance(middle, scene.walls).min() == pytest.approx(script.RADIUS_M + 0.5 * wider_m)


@of("covariance_audit")
def test_audits_of_drawn_errors_are_counted(script):
    case = (0.99, 3, 0.5)
    figures = script.case_figures(case, [script.one_audit(seed, case) for seed in range(2)])
    assert figures["right"] == figures["held"] == 2.0 and figures["theory"] == pytest.approx(100.5, abs=0.1)
    assert script.frame_row(0, script.FRAMES[0]) == ("overconfident", True)
    assert script.frame_row(0, script.FRAMES[2]) == ("consistent", False)
