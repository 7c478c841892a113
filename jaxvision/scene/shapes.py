"""Where surfaces are, in metres."""

import equinox as eqx
from jaxtyping import Array, Float

from .._types import Scalar, as_float, check_shape


class Sphere(eqx.Module):
    """`centre`: (3,) m. `radius`: () m, positive."""

    centre: Float[Array, "3"] = eqx.field(converter=as_float)
    radius: Scalar = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("Sphere.centre", self.centre, (3,))
        check_shape("Sphere.radius", self.radius, ())


class Plane(eqx.Module):
    """An unbounded plane, seen and lit on the side its normal points to.

    `point`: (3,) m, any point of it. `normal`: (3,) unit vector (its length is ignored).
    """

    point: Float[Array, "3"] = eqx.field(converter=as_float)
    normal: Float[Array, "3"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_shape("Plane.point", self.point, (3,))
        check_shape("Plane.normal", self.normal, (3,))


Shape = Sphere | Plane
