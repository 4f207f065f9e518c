"""Sixth Sense: a workbench for 2-D laser SLAM.

The public names are flat; `__init__.pyi` lists them, and each is imported when it is first used.
"""

import os as _os
import sys as _sys
from pathlib import Path as _Path

import lazy_loader


def _keep_kernels(*places: _Path) -> None:
    """Let Numba keep compiled kernels in a new folder where none of the `places` that it uses can be written."""
    if not _os.environ.get("NUMBA_CACHE_DIR") and not any(_os.access(place, _os.W_OK) for place in places):
        import tempfile

        # What is in it is executed: only this user may write it.
        _os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp(prefix="sixthsense-")
        if "numba" in _sys.modules:
            _sys.modules["numba"].config.CACHE_DIR = _os.environ["NUMBA_CACHE_DIR"]


_keep_kernels(_Path(__file__).parent, _Path("~").expanduser())
__getattr__, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [name for name in _names if not name.startswith("_")]
