"""Reflection and refraction of a ray at a smooth surface: a mirror or a clear interface.

A smooth surface sends light from one direction into one or two directions. The BRDF of a smooth
surface is a sum of delta functions and has no value in sr^-1. A `Specular` therefore contains the
directions in which a ray continues, in the local frame, and the share of the flux in each.

`reflectance` and `transmittance` are shares of the flux. Refraction also changes the solid angle:
where the medium has the index n, the radiance L divided by n^2 is constant along a ray (Veach,
"Robust Monte Carlo Methods for Light Transport Simulation", 1997, section 5.2). A path traced from
the eye is therefore multiplied by 1 / eta^2 where it is refracted, and a path traced from a light
is not. The factors where a path enters a body and where it leaves the body cancel.
"""

from typing import Literal

import jax
import jax.numpy as jnp

from ..core._numerics import reciprocal
from ..core._shown import Shown
from ..core._types import Colour, Scalar
from ..core._vector import Vec, where
from ._lobe import diffuse_share

Carries = Literal["radiance", "light"]


class Specular(Shown):
    """The directions in which a ray continues from a smooth surface, and their shares of the flux.

    Attributes:
        mirrored: unit, local, on the side of the incoming ray.
        reflectance: (bands,) or (1,) for all bands, reflected share of the flux, no unit.
        refracted: unit, local, on the other side; None for an opaque surface.
        transmittance: (bands,) or (1,), transmitted share of the flux, no unit; None where
            `refracted` is None.
        eta: () refractive index behind the surface over that in front of it, no unit; None where
            they are equal.
    """

    mirrored: Vec
    reflectance: Colour
    refracted: Vec | None = None
    transmittance: Colour | None = None
    eta: Scalar | None = None

    def __check_init__(self) -> None:
        if (self.refracted is None) != (self.transmittance is None):
            raise ValueError("Specular.refracted and Specular.transmittance come together.")


def transmitted(ways: Specular, carries: Carries) -> Colour:
    """Return the share of the flux that a clear surface transmits.

    Args:
        ways: the two directions of a transparent surface.
        carries: "light" for the share of the flux; "radiance" for the share of the radiance behind
            the surface, transmittance / eta^2.

    Returns:
        (bands,) or (1,), no unit.
    """
    assert ways.transmittance is not None  # the caller has asked whether light goes through
    if carries == "light" or ways.eta is None:
        return ways.transmittance
    return ways.transmittance / (ways.eta * ways.eta)


def draw_way(ways: Specular, u: Scalar, *, carries: Carries) -> tuple[Vec, Colour]:
    """Draw one of the two directions of a clear surface, each with a probability equal to its share
    of the flux.

    Args:
        ways: the directions.
        u: () uniform in [0, 1), no unit.
        carries: as for `transmitted`.

    Returns:
        The direction, unit, local, and its weight, (bands,) or (1,), no unit: the share divided by
        the probability. Gradients treat the probability as a constant.
    """
    if ways.refracted is None or ways.transmittance is None:
        return ways.mirrored, ways.reflectance
    likely = jax.lax.stop_gradient(diffuse_share(ways.reflectance, ways.transmittance))
    mirrors = u < likely
    weight = jnp.where(
        mirrors,
        ways.reflectance * reciprocal(likely),
        transmitted(ways, carries) * reciprocal(1 - likely),
    )
    return where(mirrors, ways.mirrored, ways.refracted), weight
