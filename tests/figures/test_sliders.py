import sys

import pytest

from sixthsense.figures import slider


@pytest.fixture
def shown(monkeypatch):
    """What was displayed."""
    display = pytest.importorskip("IPython.display")
    found = []
    monkeypatch.setattr(display, "display", lambda one, **options: found.append(one))
    return found


def test_without_widgets_the_picture_of_the_start_is_shown(shown, monkeypatch):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    slider(lambda value: f"drawn at {value}", (1, 2, 3), 2, "value")
    assert shown == ["drawn at 2"]


def test_a_slider_draws_again_when_it_is_moved(monkeypatch):
    widgets = pytest.importorskip("ipywidgets")
    from IPython import display

    found, updated = [], []

    class Handle:
        def update(self, one):
            updated.append(one)

    monkeypatch.setattr(display, "display", lambda one, **options: found.append(one) or Handle())
    slider(lambda value: f"drawn at {value}", (1, 2, 3), 2, "value")
    (moved,) = [one for one in found if isinstance(one, widgets.SelectionSlider)]
    moved.value = 3
    assert "drawn at 2" in found and updated == ["drawn at 3"]


def test_a_start_that_is_no_value_is_refused():
    with pytest.raises(ValueError, match="start: found 5, allowed: 1, 2"):
        slider(str, (1, 2), 5, "value")
