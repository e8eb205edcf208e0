"""What a user names on the command line: a file whose format shows in itself, or a published policy."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humoslope.errors import UserError
from humoslope.foreign import holosoma, mjlab, rewire, unitree
from humoslope.foreign.folder import Source
from humoslope.foreign.policy import ForeignPolicy
from humoslope.foreign.published import PublishedPolicy
from humoslope.registry import all_tasks, build_task, content_named, content_of
from humoslope.scene.robot import Robot

YAML = (".yaml", ".yml")
DEPLOY = ("deploy.yaml", "params/deploy.yaml")
"""Where a deploy.yaml lies in a folder of a policy."""


@dataclass(frozen=True)
class Found:
    """A policy from outside with its network.

    Attributes:
        policy: Its description.
        network: Its network.
        source: Its origin.
        about: What is to be said about it, in sentences.
    """

    policy: ForeignPolicy
    network: Any
    source: Source
    about: tuple[str, ...]


def choose_robot(name: str | None) -> Robot:
    """Returns a robot by its name; without one, the robot of all registered tasks.

    Raises:
        UserError: If there is none of that name, or the tasks have several.
    """
    if name is not None:
        return content_named(Robot, name, "robot")
    walkers = {robot.name: robot for robot in (build_task(task).env.scene.robot for task in all_tasks())}
    if len(walkers) != 1:
        raise UserError(f"name a robot with --robot; the tasks have {', '.join(sorted(walkers)) or 'none'}.")
    return next(iter(walkers.values()))


def find(named: str, network: Path | None, robot: Robot) -> Found:
    """Returns the policy that a user named.

    Args:
        named: A published policy; an ONNX file; a deploy.yaml, or a folder with one.
        network: Network of a deploy.yaml, if it does not lie where Unitree puts it.
        robot: Robot that it is to walk on.

    Raises:
        UserError: If there is none, or it cannot be read.
    """
    path = Path(named)
    published = {policy.name: policy for policy in content_of(PublishedPolicy)}
    if named in published and not path.is_file():  # a folder of this name is what an earlier import wrote
        return _published(published[named])
    if not path.exists():
        known = ", ".join(sorted(published)) or "none"
        raise UserError(f"'{named}' is neither a file nor a published policy; of these there are: {known}.")
    if path.is_dir():
        places = [path / place for place in DEPLOY if (path / place).is_file()]
        if not places:
            raise UserError(f"folder '{path}' has no {' or '.join(DEPLOY)}; name a file.")
        path = places[0]
    if path.suffix in YAML:
        return _of_deploy_yaml(path, network or unitree.find_network(path), robot)
    if network is not None:
        raise UserError("--network belongs to a deploy.yaml; an ONNX file is its own network.")
    content = _bytes(path)
    return _of_network(content, path, Source(path.stem, path, _digest(content), ""), ())


def _published(policy: PublishedPolicy) -> Found:
    content, path = policy.fetch(), Path(policy.file)
    origin = f"from outside ({policy.wheel.title})"
    return _of_network(
        content, path, Source(policy.name, path, _digest(content), origin), (policy.about, policy.licence)
    )


def _of_network(content: bytes, path: Path, source: Source, about: tuple[str, ...]) -> Found:
    """The policy of a network that describes itself."""
    network = rewire.load(content, str(path))
    told = rewire.metadata_of(network)
    if holosoma.KEY in told:
        policy = holosoma.read(told, path, content_of(holosoma.HolosomaRobot))
    elif mjlab.KEY in told:
        policy = mjlab.read(told, path)
    else:
        raise UserError(
            f"'{path}' does not say what it reads: it has neither '{mjlab.KEY}' of mjlab nor '{holosoma.KEY}' of "
            "holosoma in its metadata; if a deploy.yaml belongs to it, import that."
        )
    return _found(policy, network, source, about)


def _of_deploy_yaml(path: Path, network: Path, robot: Robot) -> Found:
    policy, content = unitree.read(path, robot.joint_names), _bytes(network)
    name = next((part for part in reversed(path.parent.resolve().parts) if part != "params"), path.stem)
    return _found(policy, rewire.load(content, str(network)), Source(name, network, _digest(content), ""), ())


def _found(policy: ForeignPolicy, network: Any, source: Source, about: tuple[str, ...]) -> Found:
    origin = source.origin or f"from outside ({policy.framework})"
    if policy.commands is None:
        about = (*about, "Its file does not say its commands; up to 1 m/s and 1 rad/s are taken for them.")
    return Found(policy, network, Source(source.name, source.path, source.sha256, origin), about)


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"'{path}' cannot be read: {error.strerror}.") from None


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
