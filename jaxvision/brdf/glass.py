"""The smooth surface of a clear body, which reflects part of the light and refracts the rest.

The share F of the light, from Fresnel's exact equations, continues in the mirrored direction, and
the share 1 - F in the refracted direction. Snell's law relates the angle of refraction theta_t to
the angle of incidence theta_i:

    sin(theta_t) = sin(theta_i) / eta

Here eta is the index behind the surface divided by the index in front of it. If no theta_t
satisfies this law, F = 1 (total internal reflection). In the local frame the normal is +z, and the
body is below the surface.
"""

from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..core._arguments import takes_numbers
from ..core._bounds import Ends, Reflection, least, most
from ..core._numerics import or_one, safe_sqrt
from ..core._types import (
    AMOUNT,
    DIVISOR,
    POSITIVE,
    Colour,
    Scalar,
    as_float,
    as_optional_float,
    check_fields,
)
from ..core._vector import Vec, Vector, as_vec
from ..scene import Material
from ._lobe import mirrored
from ._registry import register_delta
from ._specular import Specular
from .fresnel import fresnel_dielectric


class Glass(Material):
    """The material that fills a closed shape with outward normals: glass, water, a crystal.

    Attributes:
        index: () index of refraction of the inside divided by that of the outside, > 0, no unit;
            the same for all bands, so that there is no dispersion.
        absorption: (bands,) Lambert-Beer coefficient inside, m^-1: transmittance exp(-absorption x
            distance); None for no absorption.

    Example:
        >>> up = jnp.array([0.0, 0.0, 1.0])
        >>> ways = jv.brdf.specular(jv.Glass(1.5), up)
        >>> round(float(ways.reflectance[0]), 4), round(float(ways.transmittance[0]), 4)
        (0.04, 0.96)
    """

    index: Scalar = eqx.field(converter=as_float)
    absorption: Colour | None = eqx.field(converter=as_optional_float, default=None, kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, index=DIVISOR, absorption=AMOUNT)


@takes_numbers
def refracted_direction(w: Vector, eta: Scalar) -> Vec:
    """Return the unit direction of the refracted ray behind the interface. For w = (x, y, z), the
    refracted ray has the components -x / eta and -y / eta, and a third component that makes it a
    unit vector; in total reflection the third component is 0. `eta` is the index behind the
    interface divided by the index in front of it."""
    v = as_vec(w)
    # 1 - (1 - z^2) / eta^2 = (eta^2 - 1 + z^2) / eta^2: nothing cancels near equal indices
    below = safe_sqrt((eta - 1) * (eta + 1) + v.z * v.z) / eta
    aside = v.x * v.x + v.y * v.y
    total = (eta - 1) * (eta + 1) + v.z * v.z <= 0
    along = 1 / jnp.sqrt(or_one(aside))
    scale = jnp.where(total, along, 1 / eta)
    return Vec(-v.x * scale, -v.y * scale, jnp.where(v.z > 0, -below, below))


def specular(material: Glass, w: Vec) -> Specular:
    """Return the two directions in which a ray continues at the surface: reflected and refracted.
    The unit local direction `w` points to where the ray came from: outside the body if `w` is above
    the surface, else inside. The shares of
    the flux and `eta` have no unit. In total reflection the reflectance is 1, and `refracted` is a
    direction along the surface."""
    eta = jnp.where(w.z > 0, material.index, 1 / material.index)
    reflectance = fresnel_dielectric(jnp.abs(w.z), eta[None])
    return Specular(mirrored(w), reflectance, refracted_direction(w, eta), 1 - reflectance, eta)


def _bound(x: Ends[Glass]) -> Reflection:
    """Return upper bounds on the shares of light that glass reflects and transmits, at most 1 in
    sum. The diffuse part of glass is 0, because `render` draws glass black."""
    indices = least(x, "index"), most(x, "index")
    return Reflection(np.zeros(1), mirror=np.ones(1), indices=indices)


def _from_file(*, index: Annotated[float, POSITIVE] = 1.5, **fields: Any) -> Glass:
    """Smooth glass."""
    return Glass(index, **fields)


register_delta(
    Glass,
    specular=specular,
    absorption=lambda material: material.absorption,
    bound=_bound,
    from_file=_from_file,
)
