"""The site of the documentation: what is found wrong with its pages. `make docs` looks over the site itself."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))

from site_parts import Page


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("<a href='other.html#place'>ok</a><a href='#here'>ok</a><p id='here'>", []),
        ("<a href='https://example.org'>a link to elsewhere is fine</a>", []),
        ("<img src='data:image/png;base64,AA=='>", []),
        ("<script src='https://example.org/a.js'></script>", ["loads https://example.org/a.js"]),
        ("<link rel='stylesheet' href='//example.org/a.css'>", ["loads //example.org/a.css"]),
        ("<a href='lost.html'>x</a>", ["leads to lost.html, which is not there"]),
        ("<img src='lost.png'>", ["leads to lost.png, which is not there"]),
        ("<a href='other.html#lost'>x</a>", ["leads to other.html#lost, a place that other.html does not have"]),
        ("<a href='#lost'>x</a>", ["leads to #lost, a place that page.html does not have"]),
    ],
)
def test_what_a_page_loads_and_where_it_leads(tmp_path: Path, body: str, told: list[str]) -> None:
    page, other = tmp_path / "page.html", tmp_path / "other.html"
    page.write_text(body)
    other.write_text("<h1 id='place'>Other</h1>")
    pages = {path: Page(path) for path in (page, other)}
    assert pages[page].faults(page, pages) == [f"page.html {fault}" for fault in told]
