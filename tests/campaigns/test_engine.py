"""Rows that outlive their writer, and calls that outlive their process."""

import os
import subprocess
import sys
import time
from concurrent.futures import Future
from pathlib import Path

import psutil
import pytest

from sixthsense.campaigns.engine import LostWorkerError, Processes, Rows, carry_out
from sixthsense.config.errors import InputError


def test_the_later_row_of_a_key_counts_and_a_line_that_was_cut_is_left_out_and_written_over(tmp_path: Path) -> None:
    rows = Rows(tmp_path / "deep" / "rows.jsonl", "name")
    assert rows.read() == {}
    for name, value in (("b", 0.1), ("a", 2), ("b", "ü\n")):
        rows.add({"name": name, "value": value})
    expected = {"b": {"name": "b", "value": "ü\n"}, "a": {"name": "a", "value": 2}}
    assert rows.read() == expected and list(rows.read()) == ["b", "a"]
    with rows.file.open("a") as stream:
        stream.write('{"name": "c", "val')
    assert rows.read() == expected
    rows.add({"name": "d", "value": 7})
    assert rows.read() == expected | {"d": {"name": "d", "value": 7}}


@pytest.mark.parametrize("line", ["", "3", "{}", '{"name": 1', "[" * 100_000, '{"name": []}'])
def test_a_damaged_row_is_named(line: str, tmp_path: Path) -> None:
    rows = Rows(tmp_path / "rows.jsonl", "name")
    rows.add({"name": "a"})
    with rows.file.open("a") as stream:
        stream.write(f"{line}\n")
    rows.add({"name": "b"})
    with pytest.raises(InputError, match=r"rows.jsonl: line 2: found .*, allowed: a row of a run"):
        rows.read()


def squared(x: float) -> float:
    if x < 0.0:
        raise ValueError(f"found {x}")
    return x * x


def dying(item: tuple[Path, int]) -> int:
    """The process of the call, which dies in the first ones."""
    mark, deaths = item
    with mark.open("a") as file:
        file.write(f"{os.getpid()}\n")
    if len(mark.read_text().splitlines()) <= deaths:
        os._exit(3)
    time.sleep(0.2)
    return os.getpid()


def found(futures: dict[str, Future[float]]) -> dict[str, float | str]:
    return {key: str(future.exception() or future.result()) for key, future in futures.items()}


def test_calls_end_with_what_they_return_or_raise_and_none_begins_after_its_time(tmp_path: Path) -> None:
    with Processes(2) as pool:
        made = dict(carry_out(pool, squared, {"a": 1.5, "b": -2.5, "c": 3.5}))
        assert found(made) == {"a": "2.25", "b": "found -2.5", "c": "12.25"}
        assert dict(carry_out(pool, squared, {"a": 1.5}, until=time.time() - 1.0)) == {}


def test_a_call_whose_process_dies_is_made_once_more_and_takes_no_other_down(tmp_path: Path) -> None:
    items = {"once": 1, "always": 99, "never": 0, "slow": 0, "later": 0}
    with Processes(3) as pool:
        made = dict(carry_out(pool, dying, {key: (tmp_path / key, deaths) for key, deaths in items.items()}))
    assert made.keys() == items.keys()
    assert isinstance(made["always"].exception(), LostWorkerError)
    assert len((tmp_path / "always").read_text().split()) <= 2
    for key in items.keys() - {"always"}:
        assert str(made[key].result()) == (tmp_path / key).read_text().split()[-1]


def test_calls_that_run_when_their_iterator_is_closed_end_with_their_executor(caplog: pytest.LogCaptureFixture) -> None:
    with Processes(1) as pool:
        assert pool.submit(squared, 2.0).result() == 4.0
        pool.workers = 9  # so that most calls wait in the pool
        calls = carry_out(pool, time.sleep, {"first": 0.0, **{f"later {k}": 600.0 for k in range(9)}})
        assert next(calls)[0] == "first"
        calls.close()
    assert caplog.text == ""


def test_a_program_needs_no_guard_and_nothing_is_left_of_it(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text("""
from tqdm.auto import tqdm
from sixthsense.campaigns.engine import Processes, carry_out
print("begun")
def doubled(x):
    with tqdm(disable=True):
        return 2 * x
with Processes(2) as pool:
    print(sorted(future.result() for _, future in carry_out(pool, doubled, {"a": 1, "b": 2, "c": 3})))
""")
    done = subprocess.run([sys.executable, str(program)], capture_output=True, text=True, check=True, timeout=120)
    assert (done.stdout, done.stderr) == ("begun\n[2, 4, 6]\n", "")


def test_processes_end_with_the_one_that_has_started_them(tmp_path: Path) -> None:
    mark, program = tmp_path / "mark", tmp_path / "program.py"
    program.write_text(f"""
import os, time
from pathlib import Path
from sixthsense.campaigns.engine import Processes
def sleeping():
    Path({str(mark)!r}).write_text(str(os.getpid()))
    time.sleep(600)
with Processes(1) as pool:
    pool.submit(lambda _: sleeping(), None).result()
""")
    with subprocess.Popen([sys.executable, str(program)]) as started:
        while not (mark.exists() and mark.read_text()):
            time.sleep(0.01)
        started.kill()
    deadline = time.monotonic() + 10.0
    while psutil.pid_exists(int(mark.read_text())):
        assert time.monotonic() < deadline
        time.sleep(0.05)
