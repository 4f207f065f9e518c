import subprocess
import sys


def test_a_process_with_ompl_ends_without_a_word() -> None:
    code = "from ompl import base; from sixthsense.running.warmup import _keep_imports; _keep_imports()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
