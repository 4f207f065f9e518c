"""Fixed drives through one room, made from a few plain lines: poses, wheels and ranges, as the files of logs."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bags import Bag

from sixthsense.config import load_config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick
from sixthsense.logs.runfolder import FILE
from sixthsense.record.stream import RecordWriter
from sixthsense.record.trace import Trace

# Off the axes and off the origin, and no part of it looks like another.
CORNERS = (
    (2.2, -7.4), (8.9, -6.9), (8.7, -4.6), (7.4, -4.7), (7.5, -4.2), (8.7, -4.0), (8.4, -1.7), (4.9, -1.9),
    (4.8, -2.5), (4.3, -2.4), (4.4, -1.9), (1.7, -2.2), (2.0, -4.9), (2.7, -4.9), (2.6, -5.6), (1.9, -5.5),
)  # fmt: skip
PILLAR = ((5.2, -4.9), (5.9, -4.7), (5.5, -4.2))
MOUNT = Pose(0.17, -0.06, 0.35)
BEAMS, FIRST, STEP, MAX_RANGE = 211, -1.9, 0.0179, 7.5
SIGMA_M = 0.01
SCANS, SCAN_NS, FIRST_NS = 70, 130_000_000, 2_700_000_000
TICKS = 4  # of odometry per scan
_RADIUS = Pose(1.75, 1.2)  # m, of the ellipse around the pillar that is driven


@dataclass(frozen=True)
class Drive:
    """A robot's way around the pillar from a phase on, rad, at a turn of `rate`, rad/s; its wheels and its laser."""

    phase: float
    rate: float
    seed: int
    scans: int = SCANS

    def pose(self, stamp_ns: int) -> Pose:
        """`T_world_robot`, which looks along its way."""
        turn = self.phase + self.rate * 1e-9 * (stamp_ns - FIRST_NS)
        ahead = math.copysign(1.0, self.rate)
        heading = math.atan2(ahead * _RADIUS.y * math.cos(turn), -ahead * _RADIUS.x * math.sin(turn))
        return Pose(5.5 + _RADIUS.x * math.cos(turn), -4.5 + _RADIUS.y * math.sin(turn), heading)

    def stamps_ns(self) -> list[int]:
        """Those of odometry; each `TICKS`-th is that of a scan."""
        return [FIRST_NS + k * SCAN_NS // TICKS for k in range(TICKS * (self.scans - 1) + 1)]

    def wheels(self) -> list[Pose]:
        """Odometry: too long by 2 %, with a drift and noise, from the true start on."""
        rng, stamps = np.random.default_rng(self.seed), self.stamps_ns()
        poses = [self.pose(stamps[0])]
        for before, after in itertools.pairwise(stamps):
            step = self.pose(before).inverse() @ self.pose(after)
            noise = 1e-3 * rng.standard_normal(2)
            poses.append(poses[-1] @ Pose(1.02 * step.x + noise[0], step.y, step.theta + 0.004 * step.x + noise[1]))
        return poses

    def ranges(self, k: int, shift_m: float) -> Array:
        """Of scan k, each changed by `shift_m`."""
        eye = self.pose(FIRST_NS + k * SCAN_NS) @ MOUNT
        noise = SIGMA_M * np.random.default_rng([self.seed, k]).standard_normal(BEAMS)
        return np.round(cast(eye) + noise, 6) + shift_m


def cast(eye: Pose) -> Array:
    """(BEAMS,) distances, m, from a laser at `eye` to the nearest wall in each direction."""
    walls = np.concatenate([np.stack([p, np.roll(p, -1, axis=0)], axis=1) for p in map(np.array, (CORNERS, PILLAR))])
    angles = eye.theta + FIRST + STEP * np.arange(BEAMS)
    beams = np.column_stack([np.cos(angles), np.sin(angles)])[:, None]
    along, to = walls[:, 1] - walls[:, 0], walls[:, 0] - eye.position
    cross = beams[..., 0] * along[:, 1] - beams[..., 1] * along[:, 0]
    distance = (to[:, 0] * along[:, 1] - to[:, 1] * along[:, 0]) / cross
    share = (to[:, 0] * beams[..., 1] - to[:, 1] * beams[..., 0]) / cross
    return np.where((share >= 0.0) & (share <= 1.0) & (distance > 0.0), distance, np.inf).min(axis=1)


def scene_file(file: Path) -> None:
    """The room as a scene of the simulator, with a tour around the pillar."""
    parts = "".join(f"[[polygons]]\npoints = {[list(point) for point in part]}\n" for part in (CORNERS, PILLAR))
    tour = [[6.9, -5.4], [7.0, -3.4], [5.3, -2.9]]
    file.write_text(f"start = [3.6, -5.2, 0.4]\nradius = 0.15\nregion = [1.5, -7.6, 9.1, -1.6]\ntour = {tour}\n{parts}")


def carmen_file(drive: Drive, file: Path, shift_m: float) -> None:
    """The drive as a CARMEN log that states its laser."""
    lines, wheels = [], drive.wheels()
    for n, (stamp_ns, pose) in enumerate(zip(drive.stamps_ns(), wheels, strict=True)):
        stamp = f"{1e-9 * stamp_ns:.6f} nohost {1e-9 * stamp_ns:.6f}"
        if n % TICKS:
            lines.append(f"ODOM {_text(pose)} 0.3 0.2 0.0 {stamp}")
            continue
        row = " ".join(f"{distance:.9f}" for distance in drive.ranges(n // TICKS, shift_m))
        laser = f"0 {FIRST} {STEP * (BEAMS - 1)} {STEP} {MAX_RANGE} 0.01 0 {BEAMS} {row} 0"
        lines.append(f"ROBOTLASER1 {laser} {_text(pose @ MOUNT)} {_text(pose)} 0.3 0.2 0.4 0.2 1.0 {stamp}")
    file.write_text("\n".join(lines) + "\n")


def relations_file(drive: Drive, file: Path) -> None:
    """The true relations between scans of the drive, some near to each other and some far."""
    lines = []
    for k in range(0, drive.scans - 23, 5):
        one, two = (FIRST_NS + n * SCAN_NS for n in (k, k + 23))
        step = drive.pose(one).inverse() @ drive.pose(two)
        lines.append(f"{1e-9 * one:.6f} {1e-9 * two:.6f} {step.x:.9f} {step.y:.9f} 0 0 0 {step.theta:.9f}")
    file.write_text("\n".join(lines) + "\n")


def _text(pose: Pose) -> str:
    return f"{pose.x:.9f} {pose.y:.9f} {pose.theta:.9f}"


def _scan(bag: Bag, drive: Drive, k: int, shift_m: float) -> None:
    laser = {"first": FIRST, "step": STEP, "low": 0.05, "high": MAX_RANGE}
    bag.scan(FIRST_NS + k * SCAN_NS, drive.ranges(k, shift_m), **laser)


def bag_folder(drive: Drive, folder: Path, shift_m: float) -> None:
    """The drive as somebody else's bag: scans between odometry, and the mount in two steps, one of them turned."""
    with Bag(folder) as bag:
        bag.transform("base", "plate", Pose(0.3, 0.11, -0.8), up=0.2)
        bag.transform("plate", "laser", Pose(0.3, 0.11, -0.8).inverse() @ MOUNT, up=0.1)
        for n, (stamp_ns, pose) in enumerate(zip(drive.stamps_ns(), drive.wheels(), strict=True)):
            bag.odometry(stamp_ns - 11_000_000, pose, child="base")
            if n % TICKS == 0 and n:
                _scan(bag, drive, n // TICKS, shift_m)


def run_folder(drive: Drive, folder: Path, shift_m: float) -> None:
    """The drive as a run recorded it, with its truth and the room."""
    folder.mkdir()
    scene_file(folder.with_suffix(".toml"))
    laser = f"beams = {BEAMS}\nfov = {STEP * (BEAMS - 1)}\nmax_range = {MAX_RANGE}\nmount = {MOUNT.array().tolist()}\n"
    (folder / "config.toml").write_text(f'scene = "{folder.with_suffix(".toml")}"\nseed = 5\n[laser]\n{laser}')
    record, trace = RecordWriter(folder / FILE), Trace(load_config(folder / "config.toml"), None, 0.2)
    for n, (stamp_ns, pose) in enumerate(zip(drive.stamps_ns(), drive.wheels(), strict=True)):
        scan = None
        if n % TICKS == 0:
            ranges = drive.ranges(n // TICKS, shift_m).astype(np.float32)
            scan = Scan(ranges, np.float32(FIRST), np.float32(STEP), MAX_RANGE, MOUNT)
        record(Tick(stamp_ns, pose, scan, truth=drive.pose(stamp_ns), log_stamp_s=1e-9 * stamp_ns), trace)
    record.close()
