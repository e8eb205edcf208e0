"""A table of figures, once, for the screen, for Markdown, for CSV and for JSON."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass, field
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from humoslope.statistics import Average, Proportion

Value = float | Proportion | Average | str | None


@dataclass(frozen=True)
class Column:
    """A column of figures.

    Attributes:
        label: What it holds.
        unit: "" if it has none.
        digits: After the point.
        group: What a label is of, such as a grade, if there are several columns of that label.
        interval: Whether figures of ours have bounds: its values are proportions or averages.
    """

    label: str
    unit: str = ""
    digits: int = 2
    group: str = ""
    interval: bool = False

    @property
    def title(self) -> str:
        """In one line."""
        return " ".join(part for part in (self.group, self.label, self.unit) if part)


@dataclass(frozen=True)
class Row:
    """A row of figures.

    Attributes:
        name: Of the method.
        note: What must be known to read it, such as how it was trained.
        values: One for each column; a proportion is shown in percent.
        paper: Whether it is the paper's, and not measured here.
        partial: How much of it has been measured, if not all.
        more: Whether it is one more row of the method above, whose name need not be said again on the screen.
    """

    name: str
    note: str
    values: tuple[Value, ...]
    paper: bool = False
    partial: str = ""
    more: bool = False

    @property
    def title(self) -> str:
        """The name, said to be the paper's or partial."""
        name = f"paper: {self.name}" if self.paper else self.name
        return f"{name} (partial: {self.partial})" if self.partial else name


@dataclass(frozen=True)
class Sheet:
    """A table.

    Attributes:
        title: What it shows.
        notes: What must be known to read it.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = field(default=())

    def to_rich(self) -> Table:
        """For the screen; a rule comes before each method of ours."""
        table = Table(title=self.title, title_justify="left", box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
        table.caption, table.caption_justify = "\n".join(self.notes), "left"
        table.add_column("\nmethod", no_wrap=True)
        group = ""
        for column in self.columns:
            head = (column.group if column.group != group else "", column.label, column.unit)
            table.add_column("\n".join(head), justify="right", no_wrap=True)
            group = column.group
        for i, row in enumerate(self.rows):
            style = "dim italic" if row.paper else "yellow" if row.partial else ""
            cells = (_lines(value, column) for value, column in zip(row.values, self.columns, strict=True))
            last = i + 1 == len(self.rows) or not (self.rows[i + 1].paper or self.rows[i + 1].more)
            name = "\n".join(filter(None, (row.title.replace(" (partial", "\n(partial"), row.note)))
            table.add_row("" if row.more else name, *cells, style=style, end_section=last)
        return table

    def show(self) -> None:
        """Prints it. A terminal too narrow wraps its lines; a table squeezed into it would lose figures."""
        table = self.to_rich()
        width = Console(width=1000).measure(table).maximum
        Console(width=max(Console().width, width)).print(table)

    def to_markdown(self) -> str:
        """For a file that people read."""
        lines = [f"**{self.title}**", ""]
        lines.append(_markdown_row(["method", "training", *(column.title for column in self.columns)]))
        lines.append(_markdown_row(["---", "---", *("---:" for _ in self.columns)]))
        for row in self.rows:
            cells = (_lines(value, column) for value, column in zip(row.values, self.columns, strict=True))
            shown = [row.title, row.note, *(cell.replace("\n", " (") + ")" * ("\n" in cell) for cell in cells)]
            lines.append(_markdown_row([f"*{cell}*" if row.paper and cell else cell for cell in shown]))
        return "\n".join([*lines, "", *(f"{note}  " for note in self.notes)]).rstrip() + "\n"

    def to_csv(self) -> str:
        """For a program: full precision, empty where there is no figure; with bounds; proportions in percent."""
        out = io.StringIO()
        records = self.records()
        writer = csv.DictWriter(out, fieldnames=list(records[0]) if records else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)
        return out.getvalue()

    def to_json(self) -> str:
        """As `to_csv`, with the notes."""
        whole = {"title": self.title, "notes": self.notes, "rows": self.records()}
        return json.dumps(whole, indent=2, allow_nan=False, ensure_ascii=False) + "\n"

    def records(self) -> list[dict[str, Any]]:
        """Every row as names and values, all with the same names."""
        return [
            {
                "source": "paper" if row.paper else "ours",
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
    """A cell; an interval is in a second line, that of an average with one more digit."""
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
    return f"{value:.{column.digits}f}"


def _fields(value: Value, column: Column) -> dict[str, float | str | None]:
    """What a cell is in a record. Columns with intervals have their bounds beside them, also where there are none."""
    middle: float | str | None
    low = high = None
    if isinstance(value, Proportion):
        middle, low, high = 100.0 * value.share, 100.0 * value.low, 100.0 * value.high
    elif isinstance(value, Average):
        middle, low, high = value.mean, value.low, value.high
    else:
        middle = value
    bounds = {f"{column.title} low": low, f"{column.title} high": high} if column.interval else {}
    return {column.title: middle, **bounds}


def _markdown_row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
