"""Names of cells in files: names that would break a table, or be read as a formula, are escaped."""

import re

# XML allows no control characters, and neither surrogates nor the two that are no characters.
_UNSAFE = "\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff"
_TO_ESCAPE = re.compile(rf"[{_UNSAFE}]|\\(?=u[0-9a-f]{{4}})")
_ESCAPED = re.compile(r"\\u([0-9a-f]{4})")
_FORMULA = re.compile("'*[=+@-]")


def printable(name: str) -> str:
    r"""A name with its control characters written as \u and four hexadecimal digits.

    A backslash before what looks like one of these is written so too: no two names become one.

    >>> print(printable("a\x1b[31m"), printable(r"$\alpha$"), printable(r"\u001b"))
    a\u001b[31m $\alpha$ \u005cu001b
    """
    return _TO_ESCAPE.sub(lambda found: f"\\u{ord(found[0]):04x}", name)


def to_field(name: str) -> str:
    r"""A name as a field of a CSV table, `printable`, and after a ' where a spreadsheet would compute it.

    These begin with =, +, - or @.

    >>> to_field("=1+2"), to_field("'=1"), to_field("left"), to_field("'left'")
    ("'=1+2", "''=1", 'left', "'left'")
    """
    text = printable(name)
    return f"'{text}" if _FORMULA.match(text) else text


def from_field(text: str) -> str:
    r"""The name that `to_field` wrote.

    >>> names = ["=1+2", "'=1", "left", "'left'", "a\x1bb", "\n", r"\u001b", r"\u00e9", "\\"]
    >>> [from_field(to_field(name)) for name in names] == names
    True
    """
    text = text[1:] if text.startswith("'") and _FORMULA.match(text) else text
    return _ESCAPED.sub(_unescaped, text)


def _unescaped(found: re.Match[str]) -> str:
    """The text that an escape stands for; the escape itself where no text would have been written so."""
    character = chr(int(found[1], 16))
    return character if re.fullmatch(rf"[{_UNSAFE}\\]", character) else found[0]
