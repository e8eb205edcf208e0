"""Table and figure of a certificate, from its report."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from humoslope.plotting import INK, dress, new_figure, save_figure

COLUMNS = 4


def table(report: dict[str, Any]) -> Table:
    """The limits of all quantities."""
    rule, robot = report["rule"], _robot(report)
    notes = [
        *([f"examined{robot}"] if robot else []),
        f"holds: a share of {rule['share']:.10g} succeeds, confidence {rule['confidence']:.10g} for each value",
        f"success: {report['success']}",
    ]
    if not all(found["monotone"] for found in report["quantities"].values()):
        notes.append("(*) a value beyond the first failing one held again")
    result = Table(
        title=f"Margins{robot}", box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False, caption="; ".join(notes)
    )
    for column in ("quantity", "unit", "from", "holds to", "at least", "fails at", "passed", "falls"):
        result.add_column(column, justify="left" if column in ("quantity", "unit") else "right", no_wrap=True)
    for name, found in report["quantities"].items():
        tested = {series["value"]: series for series in found["tested"]}
        # A first value that was not tested is the nominal one.
        at_limit = None if found["limit"] is None else tested.get(found["limit"], report["reference"])
        failed = tested.get(found["first_failing"])
        result.add_row(
            name if found["monotone"] else f"{name} (*)",
            found["unit"],
            f"{found['grid'][0]:.4g}",
            "none" if at_limit is None else f"{found['limit']:.4g}" + ("" if failed else " (end)"),
            "-" if at_limit is None else f"{100.0 * at_limit['share_at_least']:.1f} %",
            *(
                (f"{failed['value']:.4g}", f"{failed['successes']}/{failed['trials']}", str(failed["falls"]))
                if failed
                else ("-", "-", "-")
            ),
        )
    return result


def _robot(report: dict[str, Any]) -> str:
    """Words for a robot that is not the export's own."""
    model = report.get("model")
    return f" on another robot, {model}" if model else ""


def draw(report: dict[str, Any], path: Path) -> None:
    """Draws for every quantity the share of successes over its values, and its limit."""
    found = report["quantities"]
    rows = math.ceil(len(found) / COLUMNS)
    figure = new_figure(3.0 * COLUMNS, 0.6 + 2.2 * rows, f"Margins of {report['policy']['task']}{_robot(report)}")
    for i, (name, quantity) in enumerate(found.items()):
        axis = figure.add_subplot(rows, COLUMNS, i + 1)
        dress(axis)
        first, limit, shown = quantity["grid"][0], quantity["limit"], quantity["tested"]
        if limit is not None:
            axis.axvspan(first, limit, color="tab:green", alpha=0.15)
        axis.axhline(100.0 * report["rule"]["share"], color="0.6", linewidth=0.8)
        if all(series["value"] != first for series in shown):
            shown = [report["reference"] | {"value": first}, *shown]
        for series in shown:
            share = 100.0 * series["successes"] / series["trials"]
            axis.plot(series["value"], share, "o", markersize=4, color="tab:green" if series["holds"] else "tab:red")
        axis.set_ylim(-5.0, 105.0)
        axis.set_title(f"{name} [{quantity['unit']}]", fontsize=9, color=INK)
        if i % COLUMNS == 0:
            axis.set_ylabel("success, %", fontsize=8, color=INK)
    save_figure(figure, path)
