"""The configuration: a tree of frozen, validated sections, its presets, and its files."""

from sixthsense.config.explore import ExploreConfig
from sixthsense.config.files import is_of_replay, load_config, prior_map_of, save_config
from sixthsense.config.pipeline import (
    AssociationConfig,
    FeaturesConfig,
    FollowConfig,
    GridConfig,
    ISAM2Config,
    KeyframeConfig,
    LinesConfig,
    PartitionConfig,
    PointsConfig,
    RRTStarConfig,
    SplitConfig,
    WallsConfig,
)
from sixthsense.config.platform import (
    AssumedConfig,
    LaserConfig,
    LaserNoise,
    MotionNoise,
    RobotConfig,
    WorldConfig,
)
from sixthsense.config.presets import PRESETS, preset
from sixthsense.config.safety import SafetyConfig
from sixthsense.config.scans import ScansConfig
from sixthsense.config.section import ConfigError, Range, Section, as_table, merge
from sixthsense.config.tree import Config
from sixthsense.config.values import Distribution

__all__ = [
    "PRESETS",
    "AssociationConfig",
    "AssumedConfig",
    "Config",
    "ConfigError",
    "Distribution",
    "ExploreConfig",
    "FeaturesConfig",
    "FollowConfig",
    "GridConfig",
    "ISAM2Config",
    "KeyframeConfig",
    "LaserConfig",
    "LaserNoise",
    "LinesConfig",
    "MotionNoise",
    "PartitionConfig",
    "PointsConfig",
    "RRTStarConfig",
    "Range",
    "RobotConfig",
    "SafetyConfig",
    "ScansConfig",
    "Section",
    "SplitConfig",
    "WallsConfig",
    "WorldConfig",
    "as_table",
    "is_of_replay",
    "load_config",
    "merge",
    "preset",
    "prior_map_of",
    "save_config",
]
