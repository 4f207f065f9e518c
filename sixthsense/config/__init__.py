"""The configuration: a tree of frozen, validated sections, its presets, and its files."""

from sixthsense.config.errors import InputError as InputError
from sixthsense.config.files import PRESETS as PRESETS
from sixthsense.config.files import load_config as load_config
from sixthsense.config.files import notes_of as notes_of
from sixthsense.config.files import preset as preset
from sixthsense.config.files import save_config as save_config
from sixthsense.config.section import Distribution as Distribution
from sixthsense.config.section import Section as Section
from sixthsense.config.section import as_table as as_table
from sixthsense.config.section import merge as merge
from sixthsense.config.sections import *  # noqa: F403
