"""The exercises of the notebooks, and what says in words and numbers how an answer is off.

from course import check
nees = check("nees", nees)
"""

import os

from course.checking import check, reference

__all__ = ["LONG", "check", "reference"]

LONG = os.environ.get("SIXTHSENSE_LONG", "1") != "0"
"""whether the longer cells of the notebooks run in full; `SIXTHSENSE_LONG=0` cuts them short"""
