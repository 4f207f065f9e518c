"""Exit codes."""

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
EXIT_CODES = {
    "goal reached": DONE,
    "tour ended": DONE,
    "explored": DONE,
    "explored in part": DONE,
    "log ended": DONE,
    "time is up": DONE,
    "ended by the user": DONE,
    "interrupted": INTERRUPTED,
}
"""exit codes of a run's outcomes; every other outcome is a failure of the robot"""
