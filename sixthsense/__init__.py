"""Sixth Sense: a workbench for 2-D laser SLAM.

The public names are flat; `__init__.pyi` lists them, and each is imported when it is first used.
"""

from pathlib import Path as _Path

import lazy_loader

from sixthsense.core.kernel_cache import choose_cache as _choose_cache

_choose_cache(_Path(__file__).parent)
__getattr__, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [name for name in _names if not name.startswith("_")]
