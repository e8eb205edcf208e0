"""Collisions with a height field in MuJoCo-Warp, made accurate anywhere on the field.

MuJoCo-Warp 3.14 collides a geom with the cells of a height field in the field's frame, and each cell reaches down to
the field's base. C MuJoCo does the same in float64; MuJoCo-Warp computes in float32, where two things go wrong:

- Far from the field's centre, rounding upsets EPA once a sphere's centre or a capsule's axis is in the ground. 20 m out
  half of such contacts are metres deep, with any normal; 50 m out they throw a robot at 100 m/s.
- A cell of 0.1 m by 0.1 m by several metres is so thin that GJK takes a touch for an overlap: 3.5 % of the contacts of
  a sphere 1 mm in a ramp of 30 degrees were more than 1 mm too deep, some pointing downhill.

The correction moves the frame to the geom's own x and y and moves the contact back afterwards, and ends each cell half
a diagonal below both the geom and the cell's surface, so deep that the shortest way out of a cell is never through its
bottom. The errors on ramps vanish, and no error grows with the distance. It costs nothing. What is left: a geom that
starts decimetres deep, or inside a vertical step of metres, can still get a contact that is too deep (1 of 1,152 robots
dropped in any pose with limbs in the ground diverged, 36 without the correction); robots that fall do not.

The alternatives were worse: one field per tile multiplies the broadphase pairs by seventy; one field per world
(`geom_dataid`) leaves no ground beyond the world's own tile and gives every lookup its own frame; more CCD iterations,
a looser CCD tolerance or a thinner base of the whole field do not help.

The lines are found and replaced in the source of the installed package, so the correction holds for one version of it
only and refuses every other. Remove this module once MuJoCo-Warp does the same.
"""

from __future__ import annotations

import importlib
import inspect
import linecache
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from humoslope.errors import UserError

VERSION = "3.14.0"
"""The version of MuJoCo-Warp whose source the replacements are written for."""

_MODULE = "mujoco_warp._src.collision_convex"
_BUILDER = "ccd_hfield_kernel_builder"
_CORRECTED = f"{_BUILDER}_near_geom"
_FILENAME = f"<{_MODULE}, collided near the geom>"

_REPLACEMENTS = {
    # The kernel cache of MuJoCo-Warp goes by this name; a kernel of the original must not be taken for the new one.
    f"def {_BUILDER}(": f"def {_CORRECTED}(",
    "geom2.pos = hf_matT @ (geom2.pos - hf_pos)\n": (
        "geom2.pos = hf_matT @ (geom2.pos - hf_pos)\n"
        "    near = wp.vec3(geom2.pos[0], geom2.pos[1], 0.0)\n"
        "    geom2.pos = geom2.pos - near\n"
    ),
    "x = dx * float(cmin) - size[0]\n": "x = dx * float(cmin) - size[0] - near[0]\n",
    "x = dx * float(c) - size[0]\n": "x = dx * float(c) - size[0] - near[0]\n",
    "y = dy * float(r + dr[init_i]) - size[1]\n": "y = dy * float(r + dr[init_i]) - size[1] - near[1]\n",
    "y = dy * float(r + dr[i]) - size[1]\n": "y = dy * float(r + dr[i]) - size[1] - near[1]\n",
    "geom1.polyvert = prism\n": (
        "base = wp.min(zmin, wp.min(prism[3, 2], wp.min(prism[4, 2], prism[5, 2])))\n"
        "          base = wp.max(-size[3], base - 0.5 * wp.sqrt(dx * dx + dy * dy))\n"
        "          prism[0, 2] = base\n"
        "          prism[1, 2] = base\n"
        "          prism[2, 2] = base\n"
        "          geom1.polyvert = prism\n"
    ),
    "pos = hf_mat @ pos_local + hf_pos\n": "pos = hf_mat @ (pos_local + near) + hf_pos\n",
}


def collide_near_geoms() -> None:
    """Installs the corrected height-field kernel in MuJoCo-Warp; does nothing if it is installed already.

    Raises:
        UserError: If MuJoCo-Warp is not the version that the correction is written for.
    """
    module = importlib.import_module(_MODULE)
    if hasattr(module, _CORRECTED):
        return
    installed = version("mujoco-warp")
    if installed != VERSION:
        raise UserError(
            f"mujoco-warp {installed} is installed, but the correction of its height-field collisions is written for "
            f"{VERSION}; install mujoco-warp=={VERSION}, or use backend 'native'."
        )
    source = corrected(inspect.getsource(inspect.unwrap(getattr(module, _BUILDER))), _REPLACEMENTS)
    # Warp reads a kernel's source through the line cache, and hashes it: its cache on disk keeps both kernels apart.
    linecache.cache[_FILENAME] = (len(source), None, source.splitlines(keepends=True), _FILENAME)
    namespace: dict[str, Any] = vars(module)
    exec(compile(source, _FILENAME, "exec"), namespace)
    setattr(module, _BUILDER, namespace[_CORRECTED])


def corrected(source: str, replacements: Mapping[str, str]) -> str:
    """The source with every text replaced.

    Raises:
        UserError: If a text does not occur exactly once.
    """
    for old, new in replacements.items():
        if source.count(old) != 1:
            raise UserError(
                f"the correction of MuJoCo-Warp's height-field collisions does not fit its source: '{old.strip()}' "
                f"occurs {source.count(old)} times instead of once; reinstall mujoco-warp=={VERSION}."
            )
        source = source.replace(old, new)
    return source
