"""Figures of runs: maps, errors, consistency, comparisons, reports and films; colours and helpers of notebooks.

`__init__.pyi` lists the public names, and each is imported when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
