"""`humoslope demo`: the shipped policy of Stage II walks a slope, live."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from humoslope import shipped
from humoslope.deploy import contract as contracts
from humoslope.deploy import views
from humoslope.deploy.picture import draw_walk
from humoslope.deploy.player import Player, TrialCfg
from humoslope.deploy.views import Live
from humoslope.errors import UserError
from humoslope.files import check_place

PICTURE = Path("demo.png")
PICTURE_S, POSES = 9.0, 4
"""Length of the walk in the picture, s, and moments that it shows."""
NEXT = f"""Next:
  humoslope play {shipped.EXPORT} --grade -15   down instead of up
  humoslope evaluate {shipped.STAGE2} --trials 16   measure it on the held-out track
  humoslope train HumoSlope-Stage1-Unitree-G1   train your own
  humoslope list   all tasks and terrains"""


@dataclasses.dataclass(frozen=True)
class Options:
    """Shows the shipped policy of Stage II on a slope, live and steerable, in the browser or in a window. Without a
    display it writes a picture.

    Attributes:
        grade: Grade of the slope, degrees; negative goes down, 0 is flat ground.
        speed: Forward speed to begin with, m/s.
        picture: Path of a PNG to write instead of showing anything.
        live: View of the walk, and its controls.
    """

    grade: float = 20.0
    speed: float = 0.5
    picture: Path | None = None
    live: Annotated[Live, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Live)


def run(arguments: list[str]) -> None:
    """Shows the demonstration."""
    options, console = tyro.cli(Options, args=arguments, prog="humoslope demo"), Console()
    kind = views.chosen(options.live.view)
    cfg = views.long_course(TrialCfg(grade=options.grade, speed=options.speed))
    folder = shipped.root() / shipped.EXPORT
    if not folder.is_dir():
        raise UserError(f"'{folder}' is missing; install HumoSlope from its wheel, or from a whole checkout.")
    contract = contracts.read(folder)
    player = Player(folder, contract, cfg)

    def say(text: str) -> None:
        console.print(text, highlight=False, markup=False, soft_wrap=True)

    slope = f"a slope of {cfg.grade:g} degrees" if cfg.grade else "flat ground"
    say(f"The shipped policy of Stage II on {contract.robot.name}, blind, on {slope}, in plain MuJoCo.")
    if options.picture is None and kind is not None:
        views.show(player, kind, options.live, say, NEXT)
        return
    path = options.picture or PICTURE
    check_place(path)
    if options.picture is None:
        say("There is no display here: it walks into a picture. --view browser serves the page all the same.")
    stood = draw_walk(player, PICTURE_S, POSES, f"HumoSlope, Stage II: {cfg.grade:g}°, {cfg.speed:g} m/s asked", path)
    ended = f"It walked for {PICTURE_S:g} s" if stood else "It fell"
    distance = player.world.along(float(player.world.root_pos[0]))
    say(f"{ended}, {distance:.1f} m along the ground; wrote {path.absolute()}")
    say(NEXT)
