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
    spaced = "".join(" " if letter.isspace() else letter for letter in head)
    # C: control, format and surrogate characters, and those without a meaning.
    kept = "".join(letter for letter in spaced if unicodedata.category(letter)[0] != "C")
    line = " ".join(kept.split())
    more = max(len(line) - limit, 0) + len(text) - len(head)
    return f"{line[:limit]}... ({more} characters more)" if more else line
