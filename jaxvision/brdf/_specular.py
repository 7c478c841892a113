"""Mirrors and clear interfaces: reflection and refraction of a ray at a smooth surface. Local
frame.

Such a surface sends light from one direction into one or two others: its BRDF is a sum of delta
functions, which no number in sr^-1 describes. Its family therefore says, as a `Specular`, where a
ray goes on and what share of the flux goes there.

Flux is shared as `reflectance` and `transmittance`. Radiance that goes through is also squeezed
into another solid angle: L / n^2 is constant along a ray (Veach, "Robust Monte Carlo Methods for
Light Transport Simulation", 1997, section 5.2), so that radiance followed from the eye is
multiplied by 1 / eta^2, and light followed from a source is not. On the way into a body and out of
it again the two factors cancel.
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
    """The directions in which a ray goes on from a smooth surface, and their shares of the flux.

    Attributes:
        mirrored: unit, local, on the side from which the ray came.
        reflectance: (bands,) or neutral (1,), share of the flux that is mirrored, no unit.
        refracted: unit, local, on the other side; None where no light goes through.
        transmittance: (bands,) or (1,), share of the flux that goes through, no unit; None
            together with `refracted`.
        eta: () refractive index behind the surface over that before it, no unit; None where the
            two are equal.
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
    """The share that goes through a clear surface.

    Args:
        ways: of a surface that light goes through.
        carries: "light" for the share of the flux; "radiance" for that of the radiance behind the
            surface, transmittance / eta^2.

    Returns:
        (bands,) or (1,), no unit.
    """
    assert ways.transmittance is not None  # the caller has asked whether light goes through
    if carries == "light" or ways.eta is None:
        return ways.transmittance
    return ways.transmittance / (ways.eta * ways.eta)


def draw_way(ways: Specular, u: Scalar, *, carries: Carries) -> tuple[Vec, Colour]:
    """One of the directions, drawn with a probability of its share of the flux.

    Args:
        ways: the directions.
        u: () uniform in [0, 1), no unit.
        carries: as for `transmitted`.

    Returns:
        The direction, unit, local, and its weight, (bands,) or (1,), no unit: the share over the
        probability, which is a constant to gradients.
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
