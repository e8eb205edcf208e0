"""`humoslope meshes`: fetches the real meshes of a robot, for `replay --meshes` and `video --meshes`."""

from __future__ import annotations

import tyro

from humoslope.errors import UserError, unknown
from humoslope.registry import all_tasks, build_task, load_content
from humoslope.replay.meshes import fetch_meshes


def meshes(robot: str | None = None, /) -> None:
    """Fetches the published meshes of a robot into .meshes; by default it is drawn with plain shapes.

    Args:
        robot: Name of the robot; not needed where there is only one robot with meshes.
    """
    robots = [build_task(task).env.scene.robot for task in all_tasks()]
    sources = {name: known.meshes for known in robots if known.meshes is not None for name in known.meshes.robots}
    if robot is None and len(set(sources.values())) != 1:
        raise UserError(f"name a robot; there are meshes of {', '.join(sorted(sources)) or 'none'}.")
    name = next(iter(sources)) if robot is None else robot
    if name not in sources:
        raise unknown("robot with meshes", name, sources)
    source = sources[name]
    names = " and ".join(source.robots)
    print(f"fetching {source.package} {source.version}, which carries the meshes of {names}", flush=True)
    folder = fetch_meshes(source)
    print(f"{source.licence}\nwrote {folder}")


def run(arguments: list[str]) -> None:
    """Fetches the meshes of the robot named in `arguments`."""
    load_content()
    tyro.cli(meshes, args=arguments, prog="humoslope meshes")
