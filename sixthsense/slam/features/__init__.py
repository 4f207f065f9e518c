"""From a scan to walls and landmarks, and the de-skewing before it."""

from sixthsense.slam.features.extraction import NO_FEATURES, Features, extract
from sixthsense.slam.features.extractor import Extractor

__all__ = ["NO_FEATURES", "Extractor", "Features", "extract"]
