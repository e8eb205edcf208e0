"""The paper's tables, as printed: numbers that ours stand beside and are never mixed with."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import humoslope
from humoslope.errors import UserError
from humoslope.evaluation.report.results import Result

FILE = Path(humoslope.__file__).parents[2] / "experiments" / "paper.json"
"""In a checkout; an installed package has no tables of the paper to show."""


@dataclass(frozen=True)
class PaperRow:
    """A row of one of the paper's tables.

    Attributes:
        name: The method's, as printed.
        tasks: Which of ours it is compared with.
        grades: Figures by grade in degrees, "sr" in percent, "mxd" in m, "t_trav" in s, ...; None where it has a dash.
        max_grade: Degrees; None in a table without that column.
    """

    name: str
    tasks: tuple[str, ...]
    grades: dict[float, dict[str, float | None]]
    max_grade: float | None = None

    def matches(self, result: Result) -> bool:
        """Whether the row is what a result of ours is compared with: by its task, or by the name it was given."""
        return result.task in self.tasks if result.name == result.task else result.name == self.name


@dataclass(frozen=True)
class Paper:
    """The two tables of section 4.

    Attributes:
        main: Table 1, methods on tracks of four grades.
        ablation: Table 2, variants on the track of one grade.
        ablation_grade: That grade, degrees.
    """

    main: tuple[PaperRow, ...] = ()
    ablation: tuple[PaperRow, ...] = ()
    ablation_grade: float = 20.0


def read_paper(path: Path = FILE) -> Paper:
    """The tables in a file; empty ones if it does not exist.

    Raises:
        UserError: If it cannot be read.
    """
    if not path.is_file():
        return Paper()
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        grade = float(told["ablation"]["grade"])
        return Paper(
            main=tuple(
                PaperRow(
                    row["name"],
                    tuple(row["tasks"]),
                    {float(g): figures for g, figures in row["grades"].items()},
                    row["max_grade"],
                )
                for row in told["main"]
            ),
            ablation=tuple(
                PaperRow(
                    row["name"],
                    tuple(row["tasks"]),
                    {grade: {key: value for key, value in row.items() if key not in ("name", "tasks")}},
                )
                for row in told["ablation"]["rows"]
            ),
            ablation_grade=grade,
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"the paper's tables in '{path}' cannot be read: {error}.") from None
