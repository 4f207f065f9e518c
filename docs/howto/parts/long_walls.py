"""An extractor of your own: walls of some length alone."""

from dataclasses import dataclass

from sixthsense.config import FeaturesConfig
from sixthsense.slam.features import Features
from sixthsense.slam.features.extraction import LineExtractor


class LongWalls:
    """Observes long walls: short ones may be furniture."""

    @dataclass(frozen=True)
    class Options:
        """Flags `--extractor-options.least-m 1.5`, or a table `[extractor_options]`."""

        least_m: float = 1.0
        """Length of the shortest wall that is used, m."""

    def __init__(self, assumed, options):
        self.least_m = options.least_m
        self.lines = LineExtractor(assumed, FeaturesConfig(landmarks="walls"))

    def extract(self, scan):
        found = self.lines.extract(scan)
        long = [wall for wall in found.observations if wall.extent[1] - wall.extent[0] >= self.least_m]
        return Features(found.walls, tuple(long), found.pieces, found.spans)
