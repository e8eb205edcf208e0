"""Versions and hardware."""

from __future__ import annotations

import platform
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch

import humoslope
from humoslope.check.finding import Finding
from humoslope.cpu import usable_cores
from humoslope.sim.device import describe_device, require_warp
from humoslope.sim.height_field import VERSION, collide_near_geoms

PACKAGES = ("torch", "mujoco", "mujoco-warp", "warp-lang", "mjbatch", "rsl-rl-lib", "tensordict", "numpy")

NVIDIA_DRIVER = Path("/proc/driver/nvidia/version")


def describe_machine(device: torch.device) -> list[Finding]:
    """Versions, and the device with its driver.

    Raises:
        UserError: If the driver is too old for MuJoCo-Warp, or MuJoCo-Warp is another version than the corrected one.
    """
    require_warp(device)
    unused = _unused_gpu() if device.type == "cpu" else ""
    collide_near_geoms()
    name = describe_device(device) if device.type == "cuda" else f"CPU, {usable_cores()} usable"
    return [
        Finding("humoslope", f"{humoslope.__version__} on Python {platform.python_version()}, {platform.platform()}"),
        Finding("packages", ", ".join(f"{package} {_version(package)}" for package in PACKAGES)),
        Finding("device", f"{device}: {name}{unused}", "no GPU left unused" if unused else "", right=not unused),
        Finding("CUDA of torch", torch.version.cuda or "none"),
        Finding("height-field collisions", "corrected", f"mujoco-warp {VERSION}"),
    ]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


def _unused_gpu() -> str:
    """The reason why torch uses no GPU although there is a driver for one, or ""."""
    if not NVIDIA_DRIVER.exists():
        return ""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        if torch.cuda.is_available():
            return ""
    if torch.version.cuda is None:
        return "; there is an NVIDIA driver, but torch is installed without CUDA"
    reason = f": {str(told[0].message).split(' (Triggered')[0]}" if told else ""
    return f"; there is an NVIDIA driver, but torch finds no CUDA device{reason}"
