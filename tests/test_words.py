"""Words: what modules, functions and classes were once called, where the field has a word of its own."""

import tokenize
from pathlib import Path

import pytest

import jaxtissue

MODULES = sorted(Path(jaxtissue.__file__).parent.rglob("*.py"))
PRIVATE = {
    *("settled", "taken", "PUT", "Posts", "Rivals", "sunk", "meeting"),
    *("see_lines", "see_window", "see_turned", "see_others", "see_rivals"),
    *("Leads", "leads", "foremost", "until", "GOING", "HOME", "LOST"),
    *("open_round", "overflow", "Surveyor", "shortlisted", "both_views", "Gauge", "renewals"),
}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: f"{path.parent.name}.{path.stem}")
def test_no_private_word_is_left(path: Path):
    with path.open() as file:
        names = {token.string for token in tokenize.generate_tokens(file.readline) if token.type == tokenize.NAME}
    left = sorted(names & PRIVATE)
    assert not left, f"{path.name} says {', '.join(left)}"
