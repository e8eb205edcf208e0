"""Tables of figures, written to the screen, Markdown, CSV and JSON."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from humoslope.evaluation.report.seeds import Estimate
from humoslope.seal import sealed_json
from humoslope.statistics import Average, Proportion

Value = float | Proportion | Average | Estimate | str | None

STYLES = {"ours": "", "paper": "dim italic", "reference": "italic"}
"""Style of a row on the screen by its source."""


@dataclass(frozen=True)
class Column:
    """A column of figures.

    Attributes:
        label: Heading.
        unit: Unit of its figures; "" if they have none.
        digits: Number of decimals.
        group: Heading over several columns, such as a grade, that tells columns of one label apart.
        interval: True if our figures have bounds, i.e. are proportions, averages or estimates.
        signed: Show the sign of positive figures, too, as of differences.
    """

    label: str
    unit: str = ""
    digits: int = 2
    group: str = ""
    interval: bool = False
    signed: bool = False

    @property
    def title(self) -> str:
        """Heading in one line."""
        return " ".join(part for part in (self.group, self.label, self.unit) if part)


@dataclass(frozen=True)
class Row:
    """A row of figures.

    Attributes:
        name: Name of the method.
        note: Remark that is needed to read it, such as how the method was trained.
        values: One figure for each column; a proportion is shown in percent.
        source: "ours" if measured here, "paper" if printed in the paper, "reference" if computed to compare with.
        partial: How much has been measured, if not all.
        more: True for a further row of the method above, whose name is not repeated on the screen.
    """

    name: str
    note: str
    values: tuple[Value, ...]
    source: Literal["ours", "paper", "reference"] = "ours"
    partial: str = ""
    more: bool = False

    @property
    def title(self) -> str:
        """The name, marked as the paper's or as partial."""
        name = f"paper: {self.name}" if self.source == "paper" else self.name
        return f"{name} (partial: {self.partial})" if self.partial else name


@dataclass(frozen=True)
class Sheet:
    """A table.

    Attributes:
        title: Heading of the table.
        columns, rows: Its contents.
        notes: Remarks below it.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = field(default=())

    def to_rich(self) -> Table:
        """The table for the screen, with a rule before each method of ours."""
        table = Table(title=self.title, title_justify="left", box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
        table.caption, table.caption_justify = "\n".join(self.notes), "left"
        table.add_column("\nmethod", no_wrap=True)
        group = ""
        for column in self.columns:
            head = (column.group if column.group != group else "", column.label, column.unit)
            table.add_column("\n".join(head), justify="right", no_wrap=True)
            group = column.group
        for i, row in enumerate(self.rows):
            style = "yellow" if row.partial else STYLES[row.source]
            cells = (_lines(value, column) for value, column in zip(row.values, self.columns, strict=True))
            last = i + 1 == len(self.rows) or not (self.rows[i + 1].source == "paper" or self.rows[i + 1].more)
            name = "\n".join(filter(None, (row.title.replace(" (partial", "\n(partial"), row.note)))
            table.add_row("" if row.more else name, *cells, style=style, end_section=last)
        return table

    def show(self, console: Console | None = None) -> None:
        """Prints the table: on a terminal in as many tables as its width asks for, elsewhere in one.

        Columns are never squeezed, which would lose figures; a terminal that has no room for the first column and
        another one wraps their lines.
        """
        console = console or Console()
        for part in self.parts(console.width) if console.is_terminal else [self]:
            table = part.to_rich()
            wide = max(console.width, _width_of(table))
            Console(file=console.file, width=wide, force_terminal=console.is_terminal).print(table)

    def parts(self, width: int) -> list[Sheet]:
        """The table in tables of neighbouring columns, none wider than `width` characters unless a single column is.
        The first has the title, the last the notes."""
        if not self.columns:
            return [self]
        parts, first = [], 0
        for last in range(1, len(self.columns) + 1):
            whole = last == len(self.columns)
            if whole or _width_of(self._of(first, last + 1).to_rich()) > width:
                parts.append(self._of(first, last))
                first = last
        parts[0] = replace(parts[0], title=self.title)
        parts[-1] = replace(parts[-1], notes=self.notes)
        return parts

    def _of(self, first: int, last: int) -> Sheet:
        """The columns from `first` on and before `last`."""
        rows = (replace(row, values=row.values[first:last]) for row in self.rows)
        return Sheet("", self.columns[first:last], tuple(rows))

    def to_markdown(self) -> str:
        """The table as Markdown."""
        lines = [f"**{self.title}**", ""]
        lines.append(_markdown_row(["method", "training", *(column.title for column in self.columns)]))
        lines.append(_markdown_row(["---", "---", *("---:" for _ in self.columns)]))
        for row in self.rows:
            cells = (_lines(value, column) for value, column in zip(row.values, self.columns, strict=True))
            shown = [row.title, row.note, *(cell.replace("\n", " (") + ")" * ("\n" in cell) for cell in cells)]
            lines.append(_markdown_row([f"*{cell}*" if row.source != "ours" and cell else cell for cell in shown]))
        return "\n".join([*lines, "", *(f"{note}  " for note in self.notes)]).rstrip() + "\n"

    def texts(self) -> list[list[str]]:
        """The cells of every row as text: name, how it was trained, and a figure for each column."""
        return [
            [
                row.title,
                row.note,
                *(_lines(v, c).replace("\n", " ") for v, c in zip(row.values, self.columns, strict=True)),
            ]
            for row in self.rows
        ]

    def to_csv(self) -> str:
        """The table as CSV: full precision with bounds, empty where there is no figure, proportions in percent."""
        out = io.StringIO()
        records = self.records()
        writer = csv.DictWriter(out, fieldnames=list(records[0]) if records else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)
        return out.getvalue()

    def to_json(self) -> str:
        """The table as sealed JSON: as `to_csv`, with the notes."""
        return sealed_json({"title": self.title, "notes": self.notes, "rows": self.records()})

    def records(self) -> list[dict[str, Any]]:
        """Every row as a mapping from names to values; all rows have the same names."""
        return [
            {
                "source": row.source,
                "method": row.name,
                "training": row.note,
                "partial": row.partial,
                **{
                    name: value
                    for value, column in zip(row.values, self.columns, strict=True)
                    for name, value in _fields(value, column).items()
                },
            }
            for row in self.rows
        ]


def _lines(value: Value, column: Column) -> str:
    """Text of a cell; an interval is in a second line, that of an average with one more digit."""
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    if isinstance(value, Proportion):
        interval = f"{100.0 * value.low:.0f}-{100.0 * value.high:.0f}"
        return f"{100.0 * value.share:.{column.digits}f}\n{interval}"
    if isinstance(value, Average):
        margin = "" if value.high is None else f"\n±{value.high - value.mean:.{column.digits + 1}f}"
        return f"{value.mean:.{column.digits}f}{margin}"
    if isinstance(value, Estimate):
        sign = "+" if column.signed else ""
        figures = [value.value] if value.low is None or value.high is None else [value.value, value.low, value.high]
        shown = [f"{figure:{sign}.{column.digits}f}" for figure in figures]
        return shown[0] + (f"\n{shown[1]} to {shown[2]}" if len(shown) > 1 else "")
    return f"{value:.{column.digits}f}"


def _width_of(table: Table) -> int:
    """Characters that a table takes without being squeezed."""
    return Console(width=10_000).measure(table).maximum


def _fields(value: Value, column: Column) -> dict[str, float | str | None]:
    """Entries of a cell in a record. A column with intervals has its bounds beside it, even where they are missing."""
    middle: float | str | None
    low = high = None
    if isinstance(value, Proportion):
        middle, low, high = 100.0 * value.share, 100.0 * value.low, 100.0 * value.high
    elif isinstance(value, Average):
        middle, low, high = value.mean, value.low, value.high
    elif isinstance(value, Estimate):
        middle, low, high = value.value, value.low, value.high
    else:
        middle = value
    bounds = {f"{column.title} low": low, f"{column.title} high": high} if column.interval else {}
    return {column.title: middle, **bounds}


def _markdown_row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
