"""The paper's tables as printed, for comparison; their numbers are never mixed with ours."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from humoslope import shipped
from humoslope.errors import UserError
from humoslope.evaluation.report.results import Result

FILE = shipped.root() / "experiments" / "paper.json"


@dataclass(frozen=True)
class PaperRow:
    """A row of one of the paper's tables.

    Attributes:
        name: Name of the method, as printed.
        tasks: Our tasks that it is compared with.
        grades: Figures by grade in degrees, "sr" in percent, "mxd" in m, "t_trav" in s, ...; None for a dash.
        max_grade: Steepest grade, degrees; None in a table without that column.
    """

    name: str
    tasks: tuple[str, ...]
    grades: dict[float, dict[str, float | None]]
    max_grade: float | None = None

    def matches(self, result: Result) -> bool:
        """True if one of our results is compared with this row, by its task or by the name it was given."""
        given = result.given_name
        return result.task in self.tasks if given == result.task else given == self.name


@dataclass(frozen=True)
class Paper:
    """The two tables of section 4.

    Attributes:
        main: Table 1, methods on tracks of four grades.
        ablation: Table 2, variants on the track of one grade.
        ablation_grade: Grade of table 2, degrees.
    """

    main: tuple[PaperRow, ...] = ()
    ablation: tuple[PaperRow, ...] = ()
    ablation_grade: float = 20.0


def read_paper(path: Path = FILE) -> Paper:
    """Tables from a file; empty ones if it does not exist.

    Raises:
        UserError: If it cannot be read.
    """
    if not path.is_file():
        return Paper()
    try:
        tables = json.loads(path.read_text(encoding="utf-8"))
        grade = float(tables["ablation"]["grade"])
        return Paper(
            main=tuple(
                PaperRow(
                    row["name"],
                    tuple(row["tasks"]),
                    {float(g): figures for g, figures in row["grades"].items()},
                    row["max_grade"],
                )
                for row in tables["main"]
            ),
            ablation=tuple(
                PaperRow(
                    row["name"],
                    tuple(row["tasks"]),
                    {grade: {key: value for key, value in row.items() if key not in ("name", "tasks")}},
                )
                for row in tables["ablation"]["rows"]
            ),
            ablation_grade=grade,
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"the paper's tables in '{path}' cannot be read: {error}.") from None
