"""Sixth Sense: a workbench for 2-D laser SLAM.

The public names are flat; `__init__.pyi` lists them, and each is imported when it is first used.
"""

import os as _os
import sys as _sys
from pathlib import Path as _Path
from typing import Any as _Any

import lazy_loader


def _keep_kernels(package: _Path) -> None:
    """Let Numba keep compiled kernels in the user's cache, or in a new folder, if `package` cannot be written."""
    if _os.environ.get("NUMBA_CACHE_DIR") or _os.access(package, _os.W_OK):
        return
    folder = _Path(_os.environ.get("XDG_CACHE_HOME") or _Path("~/.cache").expanduser(), "sixthsense")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        import tempfile

        folder = _Path(tempfile.mkdtemp(prefix="sixthsense-"))  # what is in it is executed: only this user may write it
    _os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in _sys.modules:
        _sys.modules["numba"].config.CACHE_DIR = str(folder)


_keep_kernels(_Path(__file__).parent)
_lazy_getattr, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [name for name in _names if not name.startswith("_")]


def __getattr__(name: str) -> _Any:
    """A public name, imported now; ImportError's kin with the nearest name for a misspelt one."""
    try:
        return _lazy_getattr(name)
    except AttributeError:
        from sixthsense.config.errors import did_you_mean

        said = f"module 'sixthsense' has no attribute {name!r}{did_you_mean(name, __all__)}"
        raise AttributeError(said, name=name, obj=None) from None  # no object: Python would add a suggestion of its own
