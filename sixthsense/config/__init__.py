"""The configuration: a tree of frozen, validated sections, its presets, and its files."""

from sixthsense.config.driving import ExploreConfig, FollowConfig, RRTStarConfig, SafetyConfig
from sixthsense.config.errors import InputError
from sixthsense.config.files import is_of_replay, load_config, prior_map_of, save_config
from sixthsense.config.pipeline import (
    AssociationConfig,
    FeaturesConfig,
    GridConfig,
    ISAM2Config,
    KeyframeConfig,
    LinesConfig,
    PartitionConfig,
    PointsConfig,
    ScansConfig,
    SplitConfig,
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
from sixthsense.config.section import Distribution, Range, Section, as_table, merge
from sixthsense.config.tree import Config

__all__ = [
    "PRESETS",
    "AssociationConfig",
    "AssumedConfig",
    "Config",
    "Distribution",
    "ExploreConfig",
    "FeaturesConfig",
    "FollowConfig",
    "GridConfig",
    "ISAM2Config",
    "InputError",
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
    "WorldConfig",
    "as_table",
    "is_of_replay",
    "load_config",
    "merge",
    "preset",
    "prior_map_of",
    "save_config",
]
