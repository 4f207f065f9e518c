import io
from contextlib import redirect_stderr
from types import SimpleNamespace

from sixthsense.config import preset
from sixthsense.record.trace import Trace
from sixthsense.running.progress import progress, seen_area


def test_nothing_is_written_where_no_terminal_is():
    with redirect_stderr(io.StringIO()) as err, progress("a log", 10.0) as bar:
        for seconds in (0.0, 5.0):
            bar.advance(SimpleNamespace(stamp_ns=round(seconds * 1e9)), Trace(preset(), None, 0.2))
    assert err.getvalue() == ""


def test_an_exploration_shows_the_seen_area():
    grid = SimpleNamespace(seen_area_m2=0.0)
    trace = SimpleNamespace(draw_map=lambda: grid)
    assert seen_area(trace) == ""
    grid.seen_area_m2 = 4.2
    assert seen_area(trace) == "4 m² seen"
