"""Warn of scenes whose interreflections cannot be computed correctly, because a material reflects
more than it receives or rounding deforms a shape.

A `diffuse` coefficient above 1 / pi is accepted for a single reflection, because a fit may use an
arbitrary unit of light. With several reflections such a coefficient is wrong in every unit.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..brdf import albedo, suprema
from ..core._bounds import Angles, Ends
from ..core._loops.fusion import one_program
from ..core._maps import ENDS, replace_maps
from ..core._types import Colour, common_dtype, is_known
from ..core._warnings import warn_caller
from ..geometry.checks import warn_of_shapes
from ..scene import Material, Scene

_ROUNDING = 1e-4  # allows for the rounding and quadrature errors of an albedo of 1


def warn_of_scene(scene: Scene) -> None:
    """Warn of shapes that are so far from the origin that rounding deforms them, and of the first
    surface that reflects more light than it receives along its normal. Numbers that JAX traces are
    not checked."""
    warn_of_shapes(*(surface.shape for surface in scene.surfaces))
    for i, surface in enumerate(scene.surfaces):
        if not all(map(is_known, jax.tree.leaves(surface.material))):
            continue
        with jax.ensure_compile_time_eval():  # known values may occur inside a trace
            reflected = _largest_albedo(surface.material)
        if reflected > 1 + _ROUNDING:
            warn_caller(
                f"Scene.surfaces[{i}] reflects {reflected:.4g} times the light that it receives "
                "along its normal, and light that bounces grows; give an albedo of at most 1 "
                "(k_d is albedo / pi)."
            )
            return


def _largest_albedo(material: Material) -> float:
    """Return the largest albedo of any band for a view along the normal. If a fast upper bound on
    it is at most 1, return this bound instead."""
    found = suprema(Ends(material, material))
    most = np.pi * found.body
    if found.lobe is not None:
        theta = np.pi / 2 * np.linspace(0, 1, 513) ** 4  # dense about the mirror direction
        one = np.ones_like(theta)[None]
        half = np.cos(theta / 2)[None]
        lobe = found.lobe.most(Angles(theta[None], half, half, np.cos(theta)[None], one, one))
        most = most + found.lobe.spectrum * np.trapezoid(2 * np.pi * np.sin(theta) * lobe[0], theta)
    if found.mirror is not None:
        most = most + found.mirror
    if not np.max(most) > 1 + _ROUNDING:
        return float(np.max(most))
    if found.mirror is not None:
        return float(np.max(found.mirror))
    return float(np.max(_along_normal(replace_maps(material, ENDS[1]))))


@one_program
def _along_normal(material: Any) -> Colour:
    return albedo(material, jnp.asarray([0, 0, 1], common_dtype(material)))
