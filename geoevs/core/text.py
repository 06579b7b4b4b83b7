"""Text that somebody else wrote, made fit for one line of a table, a page or a terminal."""

import unicodedata

LONGEST = 500
"""Most characters of a reason or a note that are kept."""


def clean(text: str, limit: int = LONGEST) -> str:
    """One line without control characters, lone surrogates or reordering marks, and not too long.

    >>> clean("two" + chr(10) + "lines" + chr(27) + "[31m red")
    'two lines[31m red'
    >>> clean("abcdef", limit=3)
    'abc... (3 characters more)'
    """
    head = text[: 4 * limit]  # the rest of megabytes need not be looked at
    line = " ".join(printable(head).split())
    more = max(len(line) - limit, 0) + len(text) - len(head)
    return f"{line[:limit]}... ({more} characters more)" if more else line


def printable(line: str) -> str:
    """A line without what steers a terminal or hides text; its spaces stay.

    >>> printable("a  b" + chr(10) + chr(27) + "[31m red")
    'a  b [31m red'
    """
    spaced = "".join(" " if letter.isspace() else letter for letter in line)
    # C: control, format and surrogate characters, and those without a meaning.
    return "".join(letter for letter in spaced if unicodedata.category(letter)[0] != "C")
