"""Sixth Sense: a workbench for 2-D laser SLAM.

The public names are flat; `__init__.pyi` lists them, and each is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)
__all__ = [name for name in _names if not name.startswith("_")]
