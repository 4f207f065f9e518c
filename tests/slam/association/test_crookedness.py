"""Walls that are not straight determine less, by what their own returns say."""

import numpy as np
import pytest
from predicted import predict_walls
from scanned import look

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import WallShape, initialize_landmark
from sixthsense.slam.association.records import Crookedness, MeanShape, less_certain
from sixthsense.slam.features import extract

VARIANCES = (4e-6, 9e-6)


def test_an_unknown_shape_says_nothing():
    mean, crookedness = MeanShape(), Crookedness()
    mean.add(WallShape())
    crookedness.add(WallShape())
    assert mean.square_m2((3.0, 3.0)) == 0.0
    assert crookedness.excess == (0.0, 0.0)


def arc(radius_m, segment_m=0.03):
    """A wall that is part of a circle around a point 2 m beyond its nearest place, which is 2 m ahead of the origin."""
    angles = np.arange(-1.0, 1.0, segment_m / radius_m)
    corners = np.column_stack([2.0 + radius_m - radius_m * np.cos(angles), radius_m * np.sin(angles)])
    return np.stack([corners[:-1], corners[1:]], axis=1)


def nis_of_neighbours(walls, seeds):
    """NIS (2) of walls observed 0.1 m farther on, against those observed before: as they are, and less certain."""
    config = preset()
    raw, honest = [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        poses = [Pose(0.0, -0.5 + 0.1 * k, 0.0) for k in range(11)]
        seen = []
        crookedness = Crookedness()
        for pose in poses:
            scan = look(pose, walls, config.laser, 0.01, rng)
            found = extract(scan, config.assumed, config.features, rng).observations
            seen.append([s for s in found if s.is_wall])
            for observation in seen[-1]:
                crookedness.add(observation.shape)
        for before, after, one, two in zip(poses, poses[1:], seen, seen[1:], strict=False):
            for first in one:
                for with_shape, out in ((False, raw), (True, honest)):
                    out += _nis(before, after, first, two, crookedness.excess if with_shape else None)
    return np.array(raw), np.array(honest)


def _nis(before, after, first, candidates, excess):
    """NIS of the candidate that looks most alike, if any is near; the first observation gives the wall's shape."""
    square = 0.0
    if excess is not None:
        mean = MeanShape()
        mean.add(first.shape)
        square = mean.square_m2(excess)
    landmark, _, by_z = initialize_landmark(before, first)
    predicted, _, by_landmark = predict_walls(after, landmark[None])
    jacobian = by_landmark[0] @ by_z
    known = jacobian @ less_certain(first, square).cov @ jacobian.T
    found = []
    for second in candidates:
        off = second.z - predicted[0]
        off[0] = wrap_angle(float(off[0]))
        overlap = min(first.extent[1], second.extent[1] + 0.1) - max(first.extent[0], second.extent[0] + 0.1)
        if overlap > 0.7 * (first.extent[1] - first.extent[0]):
            found.append(float(off @ np.linalg.solve(known + less_certain(second, square).cov, off)))
    return found[:1]


@pytest.mark.parametrize("radius_m", [6.0, 12.0])
def test_a_curved_wall_is_as_certain_as_it_says(radius_m):
    raw, honest = nis_of_neighbours(arc(radius_m), 12)
    assert len(honest) > 100
    assert raw.mean() > 4.0
    assert 1.2 < honest.mean() < 3.0


def test_a_straight_wall_stays_as_certain_as_it_was():
    walls = np.array([[(2.0, -5.0), (2.0, 5.0)]])
    raw, honest = nis_of_neighbours(walls, 12)
    assert raw.mean() == pytest.approx(2.0, abs=0.45)
    assert honest.mean() == pytest.approx(raw.mean(), rel=0.15)
