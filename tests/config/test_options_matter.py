"""Every option has its documented effect: a test for each option that no other test covers."""

import numpy as np

from sixthsense.config import preset
from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.slam.features import extract

ROOM = np.array([[[-3, -2], [3, -2]], [[3, -2], [3, 2]], [[3, 2], [-3, 2]], [[-3, 2], [-3, -2]],
                 [[1, -2], [1, -0.5]]], dtype=float)  # fmt: skip


def features_at(config, T_world_laser=None):
    """Features of a noise-free scan; the laser has the same pose for any mount."""
    pose = T_world_laser or Pose(-0.5, 0.3, 0.4)
    ranges = cast_rays(pose, beam_bearings(config.laser), ROOM, config.laser.max_range)
    scan = Scan.from_config(ranges, config.laser)
    return extract(scan, config.assumed, config.features, np.random.default_rng(0))


def test_the_mount_rotates_the_covariance_with_the_observation():
    corners = {"features": {"landmarks": "corners"}}
    plain = features_at(preset(**corners)).observations
    mount = (0.2, -0.1, 1.1)
    turned = features_at(preset(laser={"mount": mount}, **corners)).observations
    assert len(plain) == len(turned) > 4
    for a, b in zip(plain, turned, strict=True):
        assert np.allclose(Pose(*mount) @ a.z, b.z, atol=1e-9)
        assert np.allclose(rotation(1.1) @ a.cov @ rotation(1.1).T, b.cov, atol=1e-15)
