"""The front end of scans in simulated drives: loops close, estimates are honest, wrong loop closures are undone."""

import dataclasses

import numpy as np
import pytest
from rooms import CORNERS, RING, ROOM, drive, scan_at, ticks

from sixthsense.config import LaserConfig, merge, preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.se2 import between, compose
from sixthsense.slam.estimators.ekf import EKF
from sixthsense.slam.scans.links import align_pairs, private_covariance
from sixthsense.slam.slam import Slam


def run(config, poses, walls, **wheels):
    """The finished Slam, its result, the steps' poses, and the number of keyframes at each step."""
    slam, causal = Slam(config, poses[0]), []
    last_key: list[int] = []
    with slam:
        for tick in ticks(poses, walls, **wheels):
            step = slam.take(tick)
            causal.append(step.pose.array())
            last_key.append((last_key[-1] if last_key else -1) + (step.keyframe is not None))
        return slam, slam.finish(), np.array(causal), np.array(last_key)


def scan_poses(result, last_key) -> Array:
    return np.array(
        [
            (Pose.from_array(result.trajectory[k]) @ Pose.from_array(m)).array()
            for k, m in zip(last_key, result.since_key, strict=True)
        ]
    )


def old_links(slam):
    """Links to keyframes of other passes."""
    links = slam._front_end._graph.links
    return links[links["is_old"]]


CONFIG = preset(front_end="scan-matching")


def test_two_loops_with_bad_wheels_close():
    poses = drive(Pose(-9.0, -6.0, 0.0), CORNERS + CORNERS[:2], step=0.2, turn=0.2)
    slam, result, _, last_key = run(CONFIG, poses, RING, scale=1.05, drift=0.03)
    truth = np.array([pose.array() for pose in poses])
    off = scan_poses(result, last_key) - truth
    assert result.loop_closures.found >= 1 and result.loop_closures.undone == 0
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.1 and np.abs(wrap_angle(off[:, 2])).max() < 0.03
    links = set(old_links(slam)["ends"][:, 1].tolist())
    second_lap = [k for k in range(len(result.trajectory)) if last_key.tolist().index(k) > len(poses) * 0.75]
    assert np.mean([k in links for k in second_lap]) > 0.7


def test_a_loop_that_a_log_ends_in_is_closed_at_its_end():
    laser = {"beams": 181, "fov": np.pi, "max_range": 6.0}
    poses = drive(Pose(-9.0, -6.0, 0.0), [*CORNERS[:3], (-9.0, -5.0)])
    poses += drive(poses[-1], [(-8.4, -6.0)])[1:12]  # it looks along its first metres for a second
    wheels = {"scale": 1.08, "drift": 0.04, "laser": LaserConfig(**laser)}
    # Of a bare corridor these few scans would fit a metre farther on, too.
    things = [
        [[-7.2, -6.9], [-6.7, -6.6]],
        [[-6.7, -6.6], [-6.5, -7]],
        [[-6, -5], [-5.8, -5.5]],
        [[-5.8, -5.5], [-5, -5]],
    ]
    walls = np.concatenate([RING, things])
    _, result, causal, last_key = run(merge(CONFIG, {"laser": laser}), poses, walls, **wheels)
    end = poses[int(np.argmax(last_key))].array()
    off_before = causal[np.argmax(last_key)] - end
    off = result.trajectory[-1] - end
    assert result.loop_closures.found == 1 and result.loop_closures.undone == 0
    assert np.hypot(*off_before[:2]) > 0.15 and np.hypot(*off[:2]) < 0.05 and abs(wrap_angle(off[2])) < 0.02


def test_without_loop_closures_no_old_scan_is_linked():
    config = merge(CONFIG, {"scans": {"loop_closures": False, "final_pass": False}})
    slam, result, *_ = run(config, drive(Pose(-2.0, 1.0, 0.0), [(0, 1), (0, -2), (-3, 1), (0, 1)]), ROOM)
    assert not len(old_links(slam)) and result.since_key is None and result.loop_closures is None


@pytest.mark.parametrize("mount", [Pose(-0.3, 0.1, 0.5), Pose(0.2, 0.0, np.pi)])
def test_a_laser_beside_the_robot_gives_the_robots_poses(mount):
    laser = preset().laser
    config = merge(CONFIG, {"laser": {"mount": tuple(mount.array())}})
    poses = drive(Pose(-2.0, 1.0, 0.0), [(0, 1), (0, -2), (-3, 1)])
    _, result, causal, last_key = run(config, poses, ROOM, scale=1.04, mount=mount, laser=laser)
    truth = np.array([pose.array() for pose in poses])
    for found in (causal, scan_poses(result, last_key)):
        assert np.abs(found - truth)[:, :2].max() < 0.02 and np.abs(wrap_angle(found - truth)[:, 2]).max() < 0.01


@pytest.mark.parametrize("seen", ["nothing", "two returns", "walls beyond 12 m"])
def test_scans_without_near_returns_are_passed_by_odometry(seen):
    """From the start on, and after a room; then another room comes, where the track is taken up again."""
    poses = drive(Pose(-2.0, 1.0, 0.3), [(0, 1.2), (0, -2), (-3, 1)])
    far, slam = 7.0 * ROOM[:4] + 0.4, Slam(CONFIG, poses[0])
    with slam:
        for k, tick in enumerate(ticks(poses, ROOM)):
            if k < 5 or 20 < k < 30:
                scan = scan_at(poses[k], far, LaserConfig(max_range=80.0))
                if seen != "walls beyond 12 m":
                    ranges = np.full(len(scan.ranges), np.inf, np.float32)
                    ranges[[40, 90] if seen == "two returns" else []] = 1.7
                    scan = dataclasses.replace(scan, ranges=ranges)
                tick = dataclasses.replace(tick, scan=scan)
            step = slam.take(tick)
            assert np.hypot(*(step.pose.position - poses[k].position)) < 0.1, k
        assert np.isfinite(slam.finish().trajectory).all()


def test_a_robot_that_slips_is_tracked_by_its_scans():
    poses = drive(Pose(-2.0, 1.0, 0.0), [(0, 1), (0, -2)])
    stuck = [*poses, *[poses[-1]] * 2]
    slam = Slam(CONFIG, poses[0])
    with slam:
        for k, tick in enumerate(ticks(stuck, ROOM)):
            slip = Pose(x=0.4) if k >= len(poses) else Pose()
            step = slam.take(dataclasses.replace(tick, odometry=tick.odometry @ slip))
    assert np.hypot(*(step.pose.position - poses[-1].position)) < 0.03


def test_at_the_end_the_robot_is_where_the_last_scan_was_tracked_and_not_where_wheels_say():
    poses = drive(Pose(-2.0, 1.0, 0.0), [(0, 1)])
    _, result, causal, last_key = run(merge(CONFIG, {"scans": {"loop_closures": False}}), poses, ROOM, scale=1.5)
    assert last_key[-1] == last_key[-2]  # the last scan is no keyframe
    assert result.estimate.pose.array() == pytest.approx(causal[-1], abs=1e-9)
    assert np.hypot(*(result.estimate.pose.position - poses[-1].position)) < 0.02


def test_half_of_a_push_that_wheels_do_not_notice_is_doubted_where_old_places_are_sought():
    before = drive(Pose(-3.0, 1.0, 0.0), [(-1.0, 1.0)])
    pushed = before[-1] @ Pose(0.3, 0.0, 0.6)
    seen = list(ticks([*before, *drive(pushed, [tuple((pushed @ Pose(x=1.0)).position)])], ROOM))
    at = len(before)
    unnoticed = seen[at - 1].odometry @ seen[at].odometry.inverse()
    with Slam(CONFIG, before[0]) as slam:
        for k, tick in enumerate(seen):
            slam.take(dataclasses.replace(tick, odometry=unnoticed @ tick.odometry) if k >= at else tick)
        graph = slam._front_end._graph
        _, sigma_rad = graph.sigmas(graph.count - 1)
    assert sigma_rad[0] > 0.29 > 5.0 * sigma_rad[-2]


def corridor_with_doors() -> Array:
    walls = [[[-30, -1], [30, -1]], [[30, 1], [-30, 1]]]
    for x in np.arange(-28.0, 30.0, 4.0):
        walls += [[[x, -1], [x, -0.85]], [[x, -0.85], [x + 0.9, -0.85]], [[x + 0.9, -0.85], [x + 0.9, -1]]]
    return np.array(walls, dtype=float)


@pytest.mark.parametrize("width", [0.4, 0.8])
def test_in_a_corridor_someone_who_walks_ahead_does_not_hold_the_robot_back(width):
    laser, walls, rng = (
        LaserConfig(beams=181, fov=np.pi, max_range=12.0),
        corridor_with_doors(),
        np.random.default_rng(1),
    )
    poses, errors = drive(Pose(-3.0, 0.0, 0.0), [(5.0, 0.0)], step=0.06), []
    with Slam(preset("log"), poses[0]) as slam:
        for k, (pose, tick) in enumerate(zip(poses, ticks(poses, walls, laser=laser), strict=True)):
            ahead = pose.position + np.array([[3.0, -0.5 * width], [3.0, 0.5 * width]])
            seen = np.concatenate([walls, ahead[None]]) if k > 40 else walls
            step = slam.take(dataclasses.replace(tick, scan=scan_at(pose, seen, laser, rng=rng)))
            errors.append(np.hypot(*(step.pose.position - pose.position)))
    assert max(errors) < 0.25 and errors[-1] < 0.05


def test_a_filter_that_is_asked_for_scans_is_named_with_those_that_can():
    with pytest.raises(InputError, match="front_end: found scan-matching with estimator ekf, allowed: with isam2"):
        preset(front_end="scan-matching", estimator="ekf")
    with pytest.raises(InputError, match=r"found scan-matching with .*:EKF, allowed: with isam2"):
        Slam(preset(front_end="scan-matching", estimator=EKF))


def test_a_loop_closure_that_contradicts_the_graph_is_undone_with_what_followed():
    slam, *_ = run(CONFIG, drive(Pose(-2.0, 1.0, 0.0), [(0, 1), (0, -2), (-3, 1), (0, 1)]), ROOM)
    front_end = slam._front_end
    graph, before = front_end._graph, slam.trajectory()
    last = graph.count - 1
    links_before = graph.links
    keys, starts = np.arange(3), between(graph.poses[:3], graph.poses[last])
    found = align_pairs(graph.store.returns, keys, np.full(3, last), starts, 0.12)
    found.poses[:] = found.poses + np.array([0.8, -0.5, 0.3])  # a wrong place
    before_it = front_end.loop_closures.counts
    front_end.loop_closures.close(found)
    assert front_end.loop_closures.counts == before_it._replace(undone=1)
    assert np.array_equal(graph.links, links_before)
    assert np.allclose(slam.trajectory(), before, atol=1e-3)


def test_a_keyframe_relative_to_another_has_the_graphs_uncertainty_and_the_private_errors_of_both_scans():
    mount = Pose(0.21, -0.13, 0.8)
    config = preset("log", laser={"mount": (mount.x, mount.y, mount.theta)})
    with Slam(config, Pose(-2.0, -1.0, 0.3)) as slam:
        for tick in ticks(drive(Pose(-2.0, -1.0, 0.3), [(2.5, -1.6), (2.9, 1.7)]), ROOM, mount=mount):
            slam.take(tick)
        front_end, (a, b) = slam._front_end, (2, len(slam.trajectory()) - 2)
        poses = slam.trajectory()[[a, b]]
        own = [private_covariance(front_end._store.returns, key, config.assumed.laser.range_m) for key in (a, b)]
        of_graph, (found,) = slam.estimator.relative_covariances(np.array([[a, b]])), slam.relative_covariances([a, b])

    def relative(errors):
        """Of the robot, where each laser errs in its own axes."""
        lasers = compose(compose(poses, mount.array()), errors.reshape(2, 3))
        return between(between(*poses), between(*compose(lasers, mount.inverse().array())))

    steps = 1e-6 * np.eye(6)
    by_lasers = np.array([(relative(h) - relative(-h)) / 2e-6 for h in steps]).T
    private = by_lasers @ np.block([[own[0], np.zeros((3, 3))], [np.zeros((3, 3)), own[1]]]) @ by_lasers.T
    np.testing.assert_allclose(found, of_graph[0] + private, rtol=1e-6, atol=1e-12)
    assert np.trace(private) > 0.02 * np.trace(found)
    with Slam(preset("default", estimator="ekf"), Pose()) as filtered, pytest.raises(InputError, match="found ekf"):
        filtered.relative_covariances([0, 0])
