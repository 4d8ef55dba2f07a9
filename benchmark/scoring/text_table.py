"""Tables for a terminal or a pipe: text alone, never wider than what it goes to, nothing cut."""

import shutil
import sys
from collections.abc import Iterator, Sequence
from itertools import groupby

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


def for_terminal(text: str, width: int | None = None) -> str:
    """Text with tables in Markdown as it is printed: where one is wider than the terminal, each of its rows stands in
    lines of its own, every cell behind the name of its column.

    Args:
        text: The text.
        width: In characters; the terminal's if None, and any if it goes to a file or a pipe.
    """
    if width is None:
        if not sys.stdout.isatty():
            return text
        width = shutil.get_terminal_size((NARROW, 24)).columns
    lines: list[str] = []
    for is_table, group in groupby(text.splitlines(), lambda line: line.startswith("|")):
        block = [*group]
        lines += _row_by_row(block, width) if is_table and max(map(len, block)) > width else block
    return "\n".join(lines)


def _row_by_row(table: Sequence[str], width: int) -> Iterator[str]:
    """Lines of a table in Markdown."""
    header, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    for row in rows:
        line = ""
        for name, cell in zip(header, row, strict=True):
            piece = f"{name} {cell}"
            if line and len(line) + 2 + len(piece) > width:
                yield line
                line = f"  {piece}"
            else:
                line += f"  {piece}" if line else piece
        yield line


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip()
