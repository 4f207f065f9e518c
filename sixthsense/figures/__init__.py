"""Figures of a run besides its map: quantities over time, one scan, one filter step, planning and exploration.

Each function draws on given axes. `new_axes` makes a figure. `record` runs a configuration and keeps its keyframes.
`__init__.pyi` lists the names, and each is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
