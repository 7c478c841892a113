"""The sun as a disc of uniform radiance, or any other round light at infinity. Shadows under such a
light have penumbrae.

A disc of angular radius r and radiance L gives the irradiance E = pi L sin^2(r) on a surface that
faces it.
"""

from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._bounds import Ends, Source, cone, least, most, peak
from ..core._numerics import normalize
from ..core._types import (
    AMOUNT,
    Colour,
    Range,
    Scalar,
    as_float,
    check_direction,
    check_fields,
)
from ..core._vector import Direction, Vector, as_array, as_vec
from ..geometry import Ray
from ..geometry.hemisphere import direction_at, local_frame, to_world
from ..scene import Light
from ._registry import Incident, Seen, register_extended

SUN_RADIUS = np.radians(0.2666)  # rad, the mean as seen from the earth


class SunDisc(Light):
    """A round light at infinity, of uniform radiance.

    Attributes:
        direction: (3,) toward the middle of the disc (its length is ignored).
        irradiance: (bands,) W m^-2 on a surface that faces the disc.
        radius: () rad, angular radius, above 0 and at most pi / 2; by default the sun's.

    Example:
        >>> sun, up = jv.SunDisc([0, 0.6, 0.8], [1000.0]), jnp.array([0.0, 0.0, 1.0])
        >>> print(jv.irradiance(sun, jnp.zeros(3), up, rule=jv.Quadrature(4)).round(1))
        [800.]
    """

    spectra = ("irradiance",)
    direction: Float[Array, "3"] = eqx.field(converter=as_float)
    irradiance: Colour = eqx.field(converter=as_float)
    radius: Scalar = eqx.field(converter=as_float, default=SUN_RADIUS)

    def __check_init__(self) -> None:
        allowed = Range(0, np.pi / 2, above=True, nan=True)
        check_fields(self, irradiance=AMOUNT, radius=allowed)
        check_direction("SunDisc.direction", self.direction)


def _height(light: SunDisc) -> Scalar:
    """Return 1 - cos(r) of the sun's angular radius r, computed without cancellation, no unit."""
    half = jnp.sin(light.radius / 2)
    return 2 * half * half


def _radiance(light: SunDisc) -> Colour:
    sine = jnp.sin(light.radius)
    return light.irradiance / (jnp.pi * sine * sine)


def _inside(light: SunDisc, direction: Direction) -> Array:
    apart = as_vec(direction) - as_vec(normalize(light.direction))
    return apart.x * apart.x + apart.y * apart.y + apart.z * apart.z <= 2 * _height(light)


def _radiance_along(light: SunDisc, ray: Ray) -> Seen:
    """Return the radiance of the disc along a ray, (bands,) W m^-2 sr^-1, and an infinite
    distance."""
    radiance = jnp.where(_inside(light, ray.direction), _radiance(light), 0)
    return Seen(jnp.full_like(ray.origin.x, jnp.inf), radiance)


def sun_sample(light: SunDisc, point: Vector, u: Float[Array, "2"]) -> Incident:
    """Map `u`, (2,) in [0, 1], to a unit direction, uniformly over the disc. Return the direction,
    the radiance times the disc's solid angle, (bands,) W m^-2, and the density, sr^-1."""
    height = _height(light)
    local = direction_at(height * u[0], 2 * jnp.pi * u[1])
    direction = to_world(local_frame(normalize(light.direction)), local)
    wi = as_array(direction) if isinstance(point, Array) else as_vec(direction)
    solid_angle = 2 * jnp.pi * height
    return Incident(wi, _radiance(light) * solid_angle, density=1 / solid_angle)


def sun_pdf(light: SunDisc, point: Vector, wi: Direction) -> Scalar:
    """Return the density of the directions that `sun_sample` returns for uniform `u`, at a unit
    direction, () in sr^-1."""
    del point
    return jnp.where(_inside(light, wi), 1 / (2 * jnp.pi * _height(light)), 0)


def _bound(light: Ends[SunDisc]) -> Source:
    """Return upper bounds on the light of a disc: its largest radiance, the cone of its directions,
    and the share of the sky that its largest disc fills. Where both ends have one radius, that
    share times the radiance is the irradiance of a facing surface, within cos(radius / 2)^2."""
    smallest, widest = least(light, "radius"), most(light, "radius")
    radiance = peak(light, "irradiance") / (np.pi * np.sin(smallest) ** 2)
    middle, width = cone(light)
    share = float(2 * np.sin(widest / 2) ** 2)
    own = np.array([1.0])
    around = own * min(width + widest, np.pi)
    return Source(radiance, middle, around, own, None, None, "sky", share=share, even=True)


def _from_file(
    *,
    direction: Float[Array, "3"],
    irradiance: Colour,
    radius: Annotated[float, Range(0, 90, above=True)] = 0.2666,
) -> SunDisc:
    """The sun as a disc, whose angular radius is in degrees.

    Args:
        radius: degrees, angular radius, above 0 and at most 90.
    """
    return SunDisc(direction, irradiance, np.radians(radius))


register_extended(
    SunDisc,
    seen=_radiance_along,
    sample=sun_sample,
    pdf=sun_pdf,
    bound=_bound,
    from_file=_from_file,
)
