"""Sixth Sense: a workbench for 2-D laser SLAM.

The public names are flat; `__init__.pyi` lists them, and each is imported when it is first used.
"""

from pathlib import Path as _Path
from typing import Any as _Any

import lazy_loader

from sixthsense.core.kernel_cache import choose_cache as _choose_cache

_choose_cache(_Path(__file__).parent)
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
