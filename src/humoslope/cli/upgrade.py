"""`humoslope upgrade CHECKPOINT`: an old checkpoint in today's format."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path

import tyro

from humoslope.cli.options import configuration_of
from humoslope.errors import UserError
from humoslope.files import check_place
from humoslope.learning import checkpoint as checkpoints
from humoslope.learning import format_1
from humoslope.packing import pack
from humoslope.registry import load_content


@dataclasses.dataclass(frozen=True)
class Options:
    """Writes a checkpoint of the first format in today's, which holds the configuration that it was trained with.

    Attributes:
        checkpoint: Path of the old checkpoint.
        out: Path of the new one, which may be the old one's.
        options: Options of the training in one word, such as --options="--preset cpu --env.num-envs 64"; by default
            those in the options.txt beside the checkpoint.
    """

    checkpoint: tyro.conf.Positional[Path]
    out: Path
    options: str | None = None


def run(arguments: list[str]) -> None:
    """Upgrades the checkpoint named in `arguments`."""
    options = tyro.cli(Options, args=arguments, prog="humoslope upgrade")
    load_content()
    check_place(options.out)
    state = checkpoints.load(options.checkpoint)
    if state["format"] != format_1.FORMAT:
        raise UserError(f"checkpoint '{options.checkpoint}' has today's format already.")
    typed = None if options.options is None else shlex.split(options.options)
    state["config"] = pack(configuration_of(options.checkpoint, state["task"], typed))
    state["formerly"] = (checkpoints.digest(options.checkpoint),)
    del state["format"]
    checkpoints.save(options.out, state)
    print(f"wrote {options.out}")
