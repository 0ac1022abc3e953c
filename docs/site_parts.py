"""What the site needs beside Sphinx's own parts: formulas as MathML, and a look over all that was built."""

from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from docutils import nodes
from docutils.utils.math import latex2mathml
from sphinx.errors import SphinxError

import jaxtissue

LOADED = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src", "video": "src"}


def setup(app: Any) -> dict[str, bool]:
    """Add these parts to Sphinx."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_block_math, None))
    app.connect("autodoc-process-docstring", _keep_bars)
    app.connect("build-finished", look_over)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def look_over(app: Any, error: Exception | None) -> None:
    """Lead from the root of the site to its first page, and look it over.

    Refuses a site that loads from other hosts, has a link that leads nowhere, or lacks a public name.
    """
    if error or app.builder.name != "html":
        return
    out = Path(app.outdir)
    (out / "index.html").write_text(f"<meta http-equiv='refresh' content='0; url={app.config.root_doc}.html'>\n")
    pages = {path.resolve(): Page(path) for path in out.rglob("*.html")}
    faults = [fault for path, page in pages.items() for fault in page.faults(path, pages)]
    faults += [f"{path.name} loads from another host" for path in out.rglob("*.css") if "url(http" in path.read_text()]
    described = app.env.get_domain("py").objects
    faults += [f"jt.{name} is not described" for name in jaxtissue.__all__ if f"jaxtissue.{name}" not in described]
    if faults:
        raise SphinxError("\n".join(faults))


class Page(HTMLParser):
    """What a page loads, where it leads, and the places in it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.leads: list[str] = []
        self.places: set[str] = set()
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what a tag loads or leads to."""
        values = {name: value or "" for name, value in attrs}
        self.places |= {values[name] for name in ("id", "name") if name in values}
        if tag in LOADED and LOADED[tag] in values:
            self.loads.append(values[LOADED[tag]])
        if tag == "a" and "href" in values:
            self.leads.append(values["href"])

    def faults(self, path: Path, pages: dict[Path, "Page"]) -> list[str]:
        """What is wrong with the page at a path, a line each."""
        found = [f"{path.name} loads {url}" for url in self.loads if urlsplit(url).netloc]
        for url in {*self.leads, *self.loads}:
            parts = urlsplit(url)
            if parts.scheme or parts.netloc:
                continue
            place = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not place.exists():
                found.append(f"{path.name} leads to {url}, which is not there")
            elif place in pages and parts.fragment and unquote(parts.fragment) not in pages[place].places:
                found.append(f"{path.name} leads to {url}, a place that {place.name} does not have")
        return found


def _keep_bars(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Bars in formulas such as |D| are bars, and no substitutions of reStructuredText."""
    lines[:] = [line if line.lstrip().startswith((">>>", "...")) else line.replace("|", "\\|") for line in lines]


def _inline_math(writer: Any, node: Any) -> None:
    writer.body.append(latex2mathml.tex2mathml(node.astext()))
    raise nodes.SkipNode


def _block_math(writer: Any, node: Any) -> None:
    writer.body.append(f'<div class="math">{latex2mathml.tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode
