"""Cartesian vectors as records of three components, for inner loops.

An array with a trailing axis of length 3 does not fill the vector units of a CPU. In a record of
components under `vmap`, each component becomes a long array. Functions of vectors take a (..., 3)
array or a `Vec` and return the same type. The sum or difference of an array and a `Vec` is a `Vec`.
"""

from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._arguments import takes_numbers
from ._shown import Shown
from ._types import Scalars, as_float, print_by_name


class Vec(Shown):
    """A Cartesian vector as a record of its three components. Arithmetic is componentwise, also
    with scalars. `x, y, z = v` unpacks a vector.

    Attributes:
        x: (...) in any unit.
        y: (...) of the shape and unit of `x`.
        z: (...) of the shape and unit of `x`.

    Example:
        >>> v = jv.Vec(*jnp.array([1.0, 2.0, 3.0]))
        >>> jv.as_array(2.0 * v - v).tolist()
        [1.0, 2.0, 3.0]
    """

    x: Scalars
    y: Scalars
    z: Scalars

    def __iter__(self) -> Iterator[Scalars]:
        return iter((self.x, self.y, self.z))

    def __add__(self, other: "Vec3") -> "Vec":
        o = as_vec(other)
        return Vec(self.x + o.x, self.y + o.y, self.z + o.z)

    def __sub__(self, other: "Vec3") -> "Vec":
        o = as_vec(other)
        return Vec(self.x - o.x, self.y - o.y, self.z - o.z)

    def __mul__(self, scale: Scalars) -> "Vec":
        return Vec(self.x * scale, self.y * scale, self.z * scale)

    def __truediv__(self, divisor: Scalars) -> "Vec":
        return Vec(self.x / divisor, self.y / divisor, self.z / divisor)

    def __neg__(self) -> "Vec":
        return Vec(-self.x, -self.y, -self.z)

    def __rsub__(self, other: "Vec3") -> "Vec":
        return as_vec(other) - self

    __radd__ = __add__
    __rmul__ = __mul__


Vec3 = Float[Array, "... 3"] | Vec
Vector = Float[Array, "3"] | Vec
Direction = Float[Array, "3"] | Vec  # a unit vector
Directions = Float[Array, "... 3"] | Vec  # unit vectors
print_by_name(globals(), "Vec3", "Vector", "Direction", "Directions")


@takes_numbers
def as_vec(v: Vec3) -> Vec:
    """Convert a vector to a record of its components.

    Args:
        v: (..., 3) array, or a `Vec`, which is returned unchanged.

    Returns:
        The vector as a `Vec`, in the same unit.

    Example:
        >>> v = jv.as_vec(jnp.array([1.0, 2.0, 3.0]))
        >>> print(v.x, v.y, v.z)
        1.0 2.0 3.0
    """
    return v if isinstance(v, Vec) else Vec(v[..., 0], v[..., 1], v[..., 2])


def vector_field(v: Any) -> Vec:
    """Convert the value of a record's field to a `Vec`; an error message names the field."""
    return v if isinstance(v, Vec) else as_vec(as_float(v))


@takes_numbers
def as_array(v: Vec3) -> Float[Array, "... 3"]:
    """Convert a vector to an array with a trailing axis of length 3.

    Args:
        v: a `Vec`, or a (..., 3) array, which is returned unchanged.

    Returns:
        (..., 3) in the same unit.

    Example:
        >>> print(jv.as_array(jv.Vec(*jnp.arange(3.0))))
        [0. 1. 2.]
    """
    return jnp.stack([*v], axis=-1) if isinstance(v, Vec) else v


def scaled(v: Vec3, scale: Scalars) -> Vec3:
    """Multiply vectors, (..., 3) or `Vec`, by scalars (...), one for each vector."""
    return v * scale if isinstance(v, Vec) else v * scale[..., None]


def masked(keep: Bool[Array, "..."], v: Vec3) -> Vec3:
    """Return each vector where its flag in `keep`, (...), is true, and the zero vector
    elsewhere."""
    if isinstance(v, Vec):
        return Vec(*(jnp.where(keep, component, 0) for component in v))
    return jnp.where(keep[..., None], v, 0)


def where(condition: Bool[Array, "..."], u: Vec, v: Vec) -> Vec:
    """Return `u` where the condition is true, and `v` elsewhere."""
    return Vec(
        jnp.where(condition, u.x, v.x),
        jnp.where(condition, u.y, v.y),
        jnp.where(condition, u.z, v.z),
    )
