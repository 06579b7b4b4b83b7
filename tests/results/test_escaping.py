"""What others wrote, as CSV, Markdown, LaTeX and JSON in a page have it."""

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from geoevs.results.escaping import (
    FORMULA,
    csv_text,
    latex_text,
    markdown_text,
    read_csv,
    script_json,
)
from geoevs.results.formats import _latex_line, markdown_grid
from geoevs.results.report.markdown import markdown_html


def test_csv_of_honest_tables_is_that_of_pandas():
    table = pd.DataFrame(
        {"name": ["a", "b, c"], "value": [-1.5, float("nan")], "note": ["", None], "bin": ["", "x"]}
    )
    assert csv_text(table) == table.to_csv(index=False)
    strings = table.astype({"name": "string", "bin": "string"})
    assert csv_text(strings) == strings.to_csv(index=False)


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@a", "\t=1", "＝1+1", "=HYPERLINK('x')"])
def test_no_text_of_a_csv_file_is_a_formula_and_it_is_read_back(tmp_path, text):
    table = pd.DataFrame({"method": ["null", "nan"], "note": [text, "fine"], "value": [-1.0, 2.0]})
    path = tmp_path / "table.csv"
    path.write_text(csv_text(table), encoding="utf-8")
    cell = path.read_text(encoding="utf-8").splitlines()[1].split(",")[1].strip('"')
    assert not FORMULA.match(cell)
    pd.testing.assert_frame_equal(read_csv(path), table, check_dtype=False)


def test_bins_of_a_csv_file_are_no_dates():
    table = pd.DataFrame({"bin": ["5-10", "0.01-0.02", "masked-observed"], "name": ["3-4"] * 3})
    lines = csv_text(table).splitlines()[1:]
    assert lines == ["5 to 10,3-4", "0.01 to 0.02,3-4", "masked-observed,3-4"]


@pytest.mark.parametrize(
    "text",
    [
        "# heading",
        "`code`",
        "<b>tag</b>",
        "[a](http://b)",
        "![a](http://b)",
        "[a]: http://b",
        "*stars* and \\* more",
        "a\n\n# b",
        "<javascript:alert(1)>",
        "a | b",
    ],
)
def test_markdown_shows_text_as_it_stands(text):
    plain = MarkdownIt("commonmark").enable("table")
    for shown in (
        plain.render(f"- who: {markdown_text(text)}\n"),
        plain.render(markdown_text(text)),
        plain.render(markdown_grid(["a", "b"], [[text, "c"]])),
        str(markdown_html(markdown_grid(["a", "b"], [[text, "c"]]))),
    ):
        assert not any(tag in shown for tag in ("<h1", "<code", "<b>", "<a ", "<img", "<em"))
        words = " ".join(text.split())
        escaped = words.replace("<", "&lt;").replace(">", "&gt;")
        assert escaped in shown
    assert plain.render(markdown_grid(["a", "b"], [[text, "c"]])).count("<td>") == 2


def test_stars_around_a_whole_cell_set_it_apart():
    assert markdown_grid(["*a_b*"], [["**x|y**"]]).splitlines()[::2] == [
        "| *a_b* |",
        r"| **x\|y** |",
    ]
    assert _latex_line(["*a_b*", "**x**", "2*3*4"]) == r"a\_b & x & 2*3*4 \\"


def test_all_special_letters_of_latex_are_printed():
    assert latex_text(r"a_b & 50% #3 $x$ {y} ~ ^ C:\path *x* <|>" + "\n") == (
        r"a\_b \& 50\% \#3 \$x\$ \{y\} \textasciitilde{} \textasciicircum{} "
        r"C:\textbackslash{}path *x* \textless{}\textbar{}\textgreater{}"
    )


@given(st.text(), st.text())
def test_no_text_ends_a_script(key, value):
    text = script_json({key: value})
    assert "<" not in text
    assert text.isascii()
