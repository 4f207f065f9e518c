"""Rows that outlive their writer, and calls that outlive their process."""

import os
import time
from concurrent.futures import Future
from functools import partial
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


def dying(mark: Path, deaths: int) -> int:
    """The process of the call, which dies in the first ones."""
    with mark.open("a") as file:
        file.write(f"{os.getpid()}\n")
    if len(mark.read_text().splitlines()) <= deaths:
        os._exit(3)
    return os.getpid()


def sleeping(mark: Path) -> None:
    mark.write_text(str(os.getpid()))
    time.sleep(600.0)


def found(futures: dict[str, Future[float]]) -> dict[str, float | str]:
    return {key: str(future.exception() or future.result()) for key, future in futures.items()}


def test_calls_end_with_what_they_return_or_raise_and_none_begins_after_its_time(tmp_path: Path) -> None:
    with Processes(2) as pool:
        made = dict(carry_out(pool, squared, {"a": 1.5, "b": -2.5, "c": 3.5}))
        assert found(made) == {"a": "2.25", "b": "found -2.5", "c": "12.25"}
        assert dict(carry_out(pool, squared, {"a": 1.5}, until=time.time() - 1.0)) == {}


def test_a_call_whose_process_dies_is_made_again_by_another_up_to_four_times(tmp_path: Path) -> None:
    with Processes(1) as pool:
        items = {"thrice": 3, "four times": 4, "never": 0}
        made = {key: dict(carry_out(pool, partial(dying, tmp_path / key), {key: n}))[key] for key, n in items.items()}
    assert len(set((tmp_path / "thrice").read_text().split())) == 4
    assert isinstance(made["four times"].exception(), LostWorkerError)
    assert str(made["never"].result()) == (tmp_path / "never").read_text().strip()


def test_processes_end_with_the_block_also_in_the_middle_of_a_call(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    with Processes(1) as pool:
        pool.submit(sleeping, mark)
        while not (mark.exists() and mark.read_text()):
            time.sleep(0.01)
    assert not psutil.pid_exists(int(mark.read_text()))
