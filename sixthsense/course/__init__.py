"""The exercises of the notebooks, and what says in words and numbers how an answer is off.

from sixthsense.course import check
check("nees", nees)
"""

from sixthsense.course.checking import check

__all__ = ["check"]
