"""Exit codes."""

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
EXIT_CODES = {
    "goal reached": DONE,
    "tour ended": DONE,
    "explored": DONE,
    "explored in part": DONE,
    "log ended": DONE,
    "interrupted": INTERRUPTED,
}
"""of a run's outcomes; any other is a robot that failed"""
