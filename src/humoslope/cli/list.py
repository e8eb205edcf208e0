"""`humoslope list`: the registered tasks and terrains, and what is shipped."""

from __future__ import annotations

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from humoslope import shipped
from humoslope.registry import all_tasks, load_content
from humoslope.terrain import registry


def run(arguments: list[str]) -> None:
    """Prints all registered names."""
    tyro.cli(list_content, args=arguments, prog="humoslope list")


def list_content() -> None:
    """Lists the registered tasks and terrains, and the shipped files."""
    load_content()
    tasks = Table("task", "description", box=SIMPLE_HEAD, title="Tasks: humoslope train TASK", title_justify="left")
    tasks.columns[0].no_wrap = True  # a name is to be copied, so none of it may be cut off
    for name, line in all_tasks().items():
        tasks.add_row(name, line)
    terrains = Table(
        "terrain",
        "grade °",
        "description",
        box=SIMPLE_HEAD,
        title="Terrains: humoslope terrain NAME",
        title_justify="left",
    )
    terrains.columns[0].no_wrap = True
    for name in registry.names():
        kind = registry.find(name)
        low, high = kind.grade
        line = (kind.function.__doc__ or "").strip().split("\n")[0]
        terrains.add_row(name, f"{low:g}" if low == high else f"{low:g} to {high:g}", line)
    files = Table(
        "file", "description", box=SIMPLE_HEAD, title="Shipped, named like this from any folder", title_justify="left"
    )
    files.columns[0].no_wrap = True
    for path, line in shipped.FILES.items():
        files.add_row(str(path), line)
    console = Console()
    for table in (tasks, terrains, files):
        console.print(table)
