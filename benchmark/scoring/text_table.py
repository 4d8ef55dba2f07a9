"""Tables for a terminal or a pipe: text alone, never wider than what it goes to, nothing cut."""

import shutil
from collections.abc import Sequence

NARROW = 80
"""Columns of a terminal that says nothing of itself, and of a pipe."""


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], width: int | None = None) -> str:
    """Lines of aligned columns; where they are too wide, the first column stands on a line of its own.

    Args:
        header: Names of the columns.
        rows: Their texts.
        width: In characters; the terminal's if None.
    """
    width = width or shutil.get_terminal_size((NARROW, 24)).columns
    table = [[*header], *map(list, rows)]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    if sum(widths) + 2 * (len(widths) - 1) <= width:
        return "\n".join(_line(row, widths) for row in table)
    lines = []
    for row in table:
        lines += [row[0], f"  {_line(row[1:], widths[1:])}"]
    return "\n".join(lines)


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
