"""Short walls far from the start, where a turn of one about its middle moves its offset from the origin."""

import numpy as np
from laws.nees import assert_consistent
from laws.short_walls import drive_past_short_walls

from sixthsense.evaluation.metrics import nees_world

RUNS = 12


def test_short_walls_leave_the_pose_consistent_however_far_they_are():
    drives = [drive_past_short_walls("ekf-invariant", seed, 30.0, 0.03) for seed in range(RUNS)]
    errors, covs = np.array([errors[-1] for errors, _ in drives]), np.array([covs[-1] for _, covs in drives])
    assert_consistent(nees_world(errors, covs), 3, confidence=0.999)
    # A bias would shift all runs along the way.
    sigma = np.sqrt(covs[:, 0, 0].mean() / RUNS)
    assert abs(errors[:, 0].mean()) < 3.3 * sigma
