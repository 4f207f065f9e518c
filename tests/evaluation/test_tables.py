import pytest

from sixthsense.evaluation.tables import PAGE, digits, html_table, text_table


@pytest.mark.parametrize(("value", "text"), [(0.123456, "0.1235"), (12, "12"), ("tour ended", "tour ended")])
def test_only_floats_are_rounded(value, text):
    assert digits(value) == text


def test_columns_are_aligned_and_headings_do_not_widen_them():
    rows = [["a very long heading"], ["name", "1"], ["x", "20"]]
    assert text_table(rows).splitlines() == ["a very long heading", "name  1", "x     20"]
    assert text_table(rows, align="right").splitlines() == ["a very long heading", "name   1", "x     20"]


def test_a_table_without_rows_is_empty():
    assert text_table([]) == ""


def test_every_cell_of_an_html_table_is_escaped():
    table = html_table(["<head>", "value"], [["<group>"], ["<cell>", "&"]])
    assert "<head>" not in table and "<group>" not in table and "<cell>" not in table
    assert "&lt;head&gt;" in table and "&amp;" in table


def test_a_heading_spans_all_columns_and_numbers_have_their_class():
    table = html_table(["key", "value", "unit"], [["Time"], ["sim_time_s", "2", "s"]], numbers=1, style=PAGE)
    assert '<th class="group" colspan="3">Time</th>' in table
    assert '<tr><td>sim_time_s</td><td class="value">2</td><td>s</td></tr>' in table
