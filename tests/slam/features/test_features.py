import math

import numpy as np
import pytest
from predicted import predict_walls
from scanned import box, look

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmark_kernels import innovations_of
from sixthsense.core.landmarks import Kind
from sixthsense.core.laser import Scan
from sixthsense.slam.features import extract
from sixthsense.slam.features.endpoints import free_end, intersect
from sixthsense.slam.features.line_fit import LaserSigmas, fit_line, parallel_line
from sixthsense.slam.features.lines import LineRules, fit_lines
from sixthsense.slam.features.partition import partition, split


def corners():
    """The default with the report's landmarks."""
    return preset(features={"landmarks": "corners"})


# A room with a doorway between two stub walls, and a cupboard.
WALLS = np.concatenate([box(0, 0, 6, 4), [[(3, 0), (3, 1.5)], [(3, 2.5), (3, 4)]], box(4.5, 2.5, 0.5, 0.5)])
LANDMARKS = np.unique(np.concatenate([WALLS.reshape(-1, 2)]), axis=0)


def scan_from(pose, config, rng=None, sigma=0.01, walls=WALLS):
    return look(pose, walls, config.laser, 0.0 if rng is None else sigma, rng)


def free_poses(rng, count):
    while count:
        pose = Pose(rng.uniform(0.3, 5.7), rng.uniform(0.3, 3.7), rng.uniform(-math.pi, math.pi))
        in_cupboard = 4.2 < pose.x < 5.3 and 2.2 < pose.y < 3.3
        if not in_cupboard and abs(pose.x - 3) > 0.2:
            count -= 1
            yield pose


def test_a_range_jump_splits_the_scan_and_a_missing_return_is_in_no_piece():
    ranges = np.array([1.0, 1.1, 3.0, 3.1, np.inf, 3.2, 3.3])
    offset, pieces, cyclic = partition(ranges, np.full(7, 0.01), 0.01, False, 1.0, 0.0, 0.01)
    assert (offset, pieces.tolist(), cyclic) == (0, [[0, 2], [2, 4], [5, 7]], False)


def test_a_closed_scan_begins_at_a_break_so_that_no_piece_straddles_the_seam():
    ranges, spacing = np.array([3.0, 3.0, 1.0, 1.0, 3.0, 3.0]), 2 * math.pi / 6
    offset, pieces, cyclic = partition(ranges, np.full(6, spacing), spacing, True, 1.0, 0.0, 0.01)
    covered = [[(offset + k) % 6 for k in range(a, b)] for a, b in pieces]
    assert sorted(map(sorted, covered)) == [[0, 1, 4, 5], [2, 3]] and not cyclic
    offset, pieces, cyclic = partition(np.ones(6), np.full(6, spacing), spacing, True, 1.0, 0.0, 0.01)
    assert cyclic and pieces.tolist() == [[0, 6]]


def reference_split(points, first, last, epsilon):
    """The report's algorithm 1, as it is written there."""
    chord = points[last] - points[first]
    offset = points[first + 1 : last] - points[first]
    length = math.hypot(*chord)
    away = np.abs(offset[:, 0] * chord[1] - offset[:, 1] * chord[0]) / length if length > 1e-9 else np.hypot(*offset.T)
    if len(away) == 0 or away.max() <= epsilon:
        return [first, last]
    index = first + 1 + int(np.argmax(away))
    return reference_split(points, first, index, epsilon)[:-1] + reference_split(points, index, last, epsilon)


def test_splitting_agrees_with_the_recursion_of_the_report():
    rng = np.random.default_rng(0)
    for _ in range(200):
        points = np.cumsum(rng.normal(size=(rng.integers(2, 60), 2)), axis=0)
        if rng.random() < 0.2:
            points[-1] = points[0]
        expected = reference_split(points, 0, len(points) - 1, 0.5)
        assert split(points, 0, len(points) - 1, 0.5).tolist() == expected


def test_a_line_is_fitted_without_the_returns_that_are_far_from_it():
    rng, rules = np.random.default_rng(1), LineRules(0.02, 6, 0.2, 0.0)
    for _ in range(30):
        alpha, d = rng.uniform(-math.pi, math.pi), rng.uniform(0.5, 4.0)
        n, t = np.array([math.cos(alpha), math.sin(alpha)]), np.array([-math.sin(alpha), math.cos(alpha)])
        points = d * n + np.linspace(-2, 2, 40)[:, None] * t + rng.normal(0, 0.004, (40, 1)) * n
        far = rng.choice(40, 3, replace=False)
        points[far] += 0.05 * n
        lines, where, owner = fit_lines(points, np.array([[0, 40]]), rules, LaserSigmas(0.004, 0.0))
        assert len(lines) == len(where) == 1 and set(np.flatnonzero(owner < 0)) >= set(far)
        assert abs(wrap_angle(lines[0, 0] - alpha)) < 0.004 and abs(lines[0, 1] - d) < 0.004


@pytest.mark.parametrize("sigma_bearing", [0.0, 0.002])
@pytest.mark.parametrize("span", [(-1.2, 1.2), (0.3, 1.3), (-0.2, 0.1)])
def test_the_covariance_of_a_line_is_that_of_its_errors(span, sigma_bearing):
    rng, sigma = np.random.default_rng(3), 0.01
    alpha, d = 2.9, 1.5
    bearings = alpha + np.arange(*span, math.radians(1.0))
    nees, errors = [], []
    for _ in range(1500):
        hit = bearings + rng.normal(0, sigma_bearing, len(bearings))
        ranges = d / np.cos(hit - alpha) + rng.normal(0, sigma, len(bearings))
        points = np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)], axis=1)
        fit = fit_line(points, np.arange(len(points)), LaserSigmas(sigma, sigma_bearing))
        error = np.array([wrap_angle(fit[0] - alpha), fit[1] - d])
        cov = np.array([[fit[2], fit[3]], [fit[3], fit[4]]])
        nees.append(error @ np.linalg.solve(cov, error))
        errors.append(error / np.sqrt(np.diag(cov)))
    assert np.mean(nees) == pytest.approx(2.0, abs=0.3)  # sigma of the mean: 0.05
    assert np.abs(np.mean(errors, axis=0)).max() < 0.15  # bias below a seventh of a sigma


def numeric_cov(function, fits):
    """First-order covariance of a point made of lines, by finite differences."""
    total = np.zeros((2, 2))
    for k, fit in enumerate(fits):
        jacobian = np.zeros((2, 2))
        for column in range(2):
            ahead = [f.copy() for f in fits]
            ahead[k][column] += 1e-6
            jacobian[:, column] = (function(*ahead)[:2] - function(*fits)[:2]) / 1e-6
        total += jacobian @ np.array([[fit[2], fit[3]], [fit[3], fit[4]]]) @ jacobian.T
    return total


def test_the_covariance_of_a_corner_agrees_with_finite_differences():
    rng = np.random.default_rng(4)
    for _ in range(50):
        fits = []
        for alpha in rng.uniform(-3, 3) + np.array([0.0, rng.uniform(0.5, 2.5)]):
            factor = rng.normal(size=(2, 2)) * 0.01
            cov = factor @ factor.T
            fits.append(np.array([alpha, rng.uniform(0.5, 3), cov[0, 0], cov[0, 1], cov[1, 1]]))
        found = intersect(*fits)
        assert np.allclose(numeric_cov(intersect, fits), [[found[2], found[3]], [found[3], found[4]]], atol=1e-7)


def test_a_free_end_lies_half_a_spacing_beyond_the_last_beam_with_the_sigma_of_a_uniform_spacing():
    spacing = math.radians(1.0)
    line = np.array([0.0, 2.0, 0.0, 0.0, 0.0])  # the wall x = 2, known exactly
    found = free_end(line, 0.3, spacing, 0.0)
    assert found[:2] == pytest.approx([2.0, 2.0 * math.tan(0.3 + 0.5 * spacing)])
    gap = 2.0 * (math.tan(0.3 + spacing) - math.tan(0.3))
    assert found[2] == pytest.approx(0.0, abs=1e-12) and math.sqrt(found[4]) == pytest.approx(gap / 12**0.5, rel=1e-3)
    line[2:] = [1e-4, 2e-5, 1e-4]
    exact = numeric_cov(lambda fit: free_end(fit, 0.3, spacing, 0.0), [line])
    across = free_end(line, 0.3, spacing, 0.0)
    assert across[2] == pytest.approx(exact[0, 0], rel=1e-3)


def observations_and_truth(config, rng, poses, sigma):
    for pose in poses:
        features = extract(scan_from(pose, config, rng, sigma), config.assumed, config.features)
        for observation in features.observations:
            world = pose @ observation.z
            nearest = LANDMARKS[np.argmin(np.linalg.norm(LANDMARKS - world, axis=1))]
            yield observation, pose.inverse() @ nearest - observation.z


def test_landmarks_are_correct_and_their_covariance_is_consistent():
    """Over a thousand scans: no false landmark, and a NEES of 2 for either kind."""
    config, rng = corners(), np.random.default_rng(5)
    nees = {Kind.CORNER: [], Kind.END: []}
    for observation, error in observations_and_truth(config, rng, free_poses(rng, 1000), 0.01):
        assert math.hypot(*error) < 0.3
        nees[observation.kind].append(error @ np.linalg.solve(observation.cov, error))
    for values in nees.values():
        assert len(values) > 2000
        assert 1.8 < np.mean(values) < 2.2


@pytest.mark.parametrize("ranges", [np.full(360, np.inf), np.zeros(360), np.full(360, 1e-3), np.full(360, 9.99)])
def test_degenerate_scans_have_no_landmarks_and_cause_no_error(ranges):
    config = corners()
    features = extract(Scan.from_config(ranges, config.laser), config.assumed, config.features)
    assert isinstance(features.observations, tuple)
    assert np.isfinite(features.walls).all()


def test_a_walls_distance_about_its_middle_is_consistent_for_short_and_far_walls():
    """An error of the angle rotates a wall about its middle: the distance there has no bias of second order."""
    rng, config = np.random.default_rng(0), preset(features={"landmarks": "walls"})
    wall, is_wall = np.array([[[3.0, 0.2], [3.0, -0.5]]]), np.array([True])
    bias, nees = [], []
    for _ in range(1500):
        pose = Pose(rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(-3.0, 3.0))
        for observation in extract(
            scan_from(pose, config, rng, walls=wall), config.assumed, config.features
        ).observations:
            expected, _, _ = predict_walls(pose, np.array([[math.pi, -3.0]]))
            (error,), (cov,) = innovations_of(observation.z[None], observation.cov[None], expected, is_wall)
            across = np.array([-cov[0, 1] / cov[0, 0], 1.0])  # what its angle does not tell
            bias.append(across @ error / math.sqrt(across @ cov @ across))
            nees.append(error @ np.linalg.solve(cov, error))
    assert len(bias) > 1000
    assert abs(np.mean(bias)) < 4.0 / math.sqrt(len(bias))
    assert np.mean(nees) == pytest.approx(2.0, abs=0.3)


def test_a_parallel_line_is_the_weighted_mean_of_its_returns():
    rng = np.random.default_rng(1)
    bearings = np.linspace(0.2, 0.3, 6)
    alpha, off, sure = 0.1, [], np.array([0.1, 2.0, 0.0, 0.0, 0.0])
    for _ in range(2000):
        ranges = 2.0 / np.cos(bearings - alpha) + rng.normal(0.0, 0.01, 6)
        points = np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])
        line = parallel_line(points, np.arange(6), sure, LaserSigmas(0.01, 0.0))
        off.append((line[1] - 2.0) / math.sqrt(line[4]))
        assert line[0] == alpha and line[2] == line[3] == 0.0
    assert abs(np.mean(off)) < 0.1 and np.std(off) == pytest.approx(1.0, abs=0.06)
