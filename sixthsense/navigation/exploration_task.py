"""What an exploration is asked to do, and by what means."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array
from sixthsense.navigation.area_to_see import Region
from sixthsense.navigation.follower import Follower
from sixthsense.navigation.path_planner import PathPlanner
from sixthsense.navigation.view_gain import SensorModel


@dataclass(frozen=True, slots=True, eq=False)
class ExplorationTask:
    """What to explore, and by what means."""

    home: Array
    """(2,) where the robot starts and returns to"""
    region: Region
    """holds the start"""
    radius_m: float
    """the robot's"""
    sensor: SensorModel
    paths: PathPlanner
    follower: Follower
    config: Config
    rng: np.random.Generator
    """for the random method"""
    tours: list[Array] = field(default_factory=list)
    """way points (N, 2) of each tour by which a view was chosen: robot, views, home; world frame"""
