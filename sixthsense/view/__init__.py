"""The live view in Rerun, and what it accepts as a target."""

from pathlib import Path

LOOPBACK = "127.0.0.1"
VIEW_TARGETS = "window, browser or FILE.rrd"


def is_view_target(word: str) -> bool:
    """Whether a word names a target of the view: window, browser, or an .rrd file."""
    return word in ("window", "browser") or Path(word).suffix.lower() == ".rrd"
