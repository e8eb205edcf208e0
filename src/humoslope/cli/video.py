"""`humoslope video ROLLOUT`: a video and a contact sheet of a recorded walk."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from humoslope.cli.arguments import parse_options
from humoslope.errors import UserError
from humoslope.files import check_place
from humoslope.ranges import Checked
from humoslope.replay.film.video import ENDINGS, VideoCfg, write_sheet, write_video
from humoslope.replay.rollout import load_rollout


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Draws a recorded walk to a video and to a PNG contact sheet. Needs no display, GPU or graphics driver.

    Attributes:
        rollout: Path of a rollout, a file of `humoslope record`.
        video: Settings of the video.
        out: Path of the video, ending in .mp4, .gif or .webp; by default an mp4 beside the rollout. The contact sheet
            has the same name with .png.
        sheet_only: Draw the contact sheet alone.
    """

    VERB: ClassVar[str] = "video"

    rollout: tyro.conf.Positional[Path]
    video: Annotated[VideoCfg, tyro.conf.arg(name="")] = dataclasses.field(default_factory=VideoCfg)
    out: Path | None = None
    sheet_only: bool = False


def run(arguments: list[str]) -> None:
    """Draws the rollout named in `arguments`."""
    options = parse_options(Options, arguments, "video")
    rollout, cfg, console = load_rollout(options.rollout), options.video, Console()
    stem = options.rollout.name.removesuffix(".npz").removesuffix(".rollout")
    out = options.out or options.rollout.with_name(f"{stem}.mp4")
    if out.suffix not in ENDINGS:
        raise UserError(f"--out '{out}' must end in {', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}.")
    sheet = out.with_suffix(".png")
    for path in (out, sheet):
        check_place(path)
    write_sheet(rollout, sheet, cfg)
    console.print(f"wrote {sheet}", soft_wrap=True)
    if options.sheet_only:
        return
    columns = (TextColumn("drawing"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("", total=len(cfg.steps(rollout)))
        write_video(rollout, out, cfg, lambda: progress.advance(bar))
    console.print(f"wrote {out} ({out.stat().st_size / 1e6:.1f} MB)", soft_wrap=True)
