import atexit
import gc
import subprocess
import sys

import pytest

from sixthsense.running import warmup


@pytest.mark.parametrize("is_loaded", [True, False])
def test_what_is_kept_from_collection_is_released_at_exit_if_ompl_is_among_it(
    is_loaded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    registered: list[object] = []
    for name in ("collect", "freeze"):
        monkeypatch.setattr(gc, name, lambda: 0)
    monkeypatch.setattr(atexit, "register", registered.append)
    if is_loaded:
        monkeypatch.setitem(sys.modules, "ompl", sys)
    else:
        monkeypatch.delitem(sys.modules, "ompl", raising=False)
    warmup._keep_imports()
    assert registered == ([gc.unfreeze] if is_loaded else [])


def test_a_process_with_ompl_ends_without_a_word() -> None:
    code = "from ompl import base; from sixthsense.running.warmup import _keep_imports; _keep_imports()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
