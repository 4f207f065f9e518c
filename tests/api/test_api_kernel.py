"""What Jupyter's own kernel makes of a run: pictures once each, without pyplot and with it, and the stop button."""

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

CELLS = """\
import sixthsense as ss
run = ss.run("rectangle", task="tour", max_time=5.0, progress=False)
run
---
run.plot()
---
run.plot(); run.metrics
---
figure = run.plot("error")
---
ss.compare([run, run])
---
import sys; "matplotlib.pyplot" in sys.modules
---
%matplotlib inline
import matplotlib.pyplot as plt
run.plot()
---
import os, signal
def press(tick, trace):
    if tick.stamp_ns == 1_000_000_000:
        os.kill(os.getpid(), signal.SIGINT)
[ss.run("rectangle", press, task="tour", max_time=60.0, progress=False).outcome]
"""


def test_runs_are_cards_figures_are_shown_once_and_the_stop_button_ends_a_run():
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in CELLS.split("---\n")])
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    outputs = [cell.outputs for cell in notebook.cells]
    assert [set(one.data) for one in outputs[0]] == [{"text/html", "text/plain"}]
    assert len(outputs[0][0].data["text/plain"]) < 200
    assert [set(one.data) for one in outputs[1]] == [{"image/png", "text/plain"}]
    assert outputs[3] == []  # a figure in a variable
    assert outputs[5][0].data["text/plain"] == "False"
    assert outputs[7][-1].data["text/plain"] == "['interrupted']"
