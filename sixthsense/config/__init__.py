"""The configuration: a tree of frozen sections that check themselves, its presets, and its files."""

from sixthsense.config.files import is_of_replay, load_config, save_config
from sixthsense.config.presets import PRESETS, preset
from sixthsense.config.section import ConfigError, Range, Section, as_table, merge
from sixthsense.config.tree import (
    AssociationConfig,
    AssumedConfig,
    Config,
    Distribution,
    FeaturesConfig,
    FollowConfig,
    GridConfig,
    KeyScanConfig,
    LandmarksConfig,
    LaserConfig,
    LaserNoise,
    LinesConfig,
    MotionNoise,
    PartitionConfig,
    RobotConfig,
    SplitConfig,
    WorldConfig,
)

__all__ = [
    "PRESETS",
    "AssociationConfig",
    "AssumedConfig",
    "Config",
    "ConfigError",
    "Distribution",
    "FeaturesConfig",
    "FollowConfig",
    "GridConfig",
    "KeyScanConfig",
    "LandmarksConfig",
    "LaserConfig",
    "LaserNoise",
    "LinesConfig",
    "MotionNoise",
    "PartitionConfig",
    "Range",
    "RobotConfig",
    "Section",
    "SplitConfig",
    "WorldConfig",
    "as_table",
    "is_of_replay",
    "load_config",
    "merge",
    "preset",
    "save_config",
]
