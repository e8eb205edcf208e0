"""Versions and hardware."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

import torch

import humoslope
from humoslope.check.finding import Finding
from humoslope.cpu import usable_cores
from humoslope.sim.device import describe_device, require_warp
from humoslope.sim.height_field import VERSION, collide_near_geoms

PACKAGES = ("torch", "mujoco", "mujoco-warp", "warp-lang", "mjbatch", "rsl-rl-lib", "tensordict", "numpy")


def describe_machine(device: torch.device) -> list[Finding]:
    """Versions, and the device with its driver.

    Raises:
        UserError: If the driver is too old for MuJoCo-Warp, or MuJoCo-Warp is another version than the corrected one.
    """
    require_warp(device)
    collide_near_geoms()
    name = describe_device(device) if device.type == "cuda" else f"CPU, {usable_cores()} usable"
    return [
        Finding("humoslope", f"{humoslope.__version__} on Python {platform.python_version()}, {platform.platform()}"),
        Finding("packages", ", ".join(f"{package} {_version(package)}" for package in PACKAGES)),
        Finding("device", f"{device}: {name}"),
        Finding("CUDA of torch", torch.version.cuda or "none"),
        Finding("height-field collisions", "corrected", f"mujoco-warp {VERSION}"),
    ]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"
