"""The thin lens: where it images what, how large, and how sharp.

    1 / z_o + 1 / z_i = 1 / f

with object distance z_o and image distance z_i in m from the lens, both positive for a real object
and a real image: z_i < 0 is a virtual image, on the object's side, as of an object inside the focal
length. All functions are elementwise on arrays that broadcast. A distance of inf is exact, with
gradient 0; NaN stays NaN. A divisor counts as no smaller than `smallest_divisor`, 3e-10 in float32,
so that the image distance at z_o = f is f^2 over that instead of infinite, and all gradients are
finite.
Sources: Szeliski, Computer Vision, section 2.2.3; Hecht, Optics, chapters 5 and 6.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from .._numerics import smallest_divisor
from .._types import Scalars


def image_distance(object_distance: Scalars, focal_length: Scalars) -> Scalars:
    """z_i = f z_o / (z_o - f), in m, from `object_distance` and `focal_length` in m. The law is
    symmetric: an object at z_i is imaged at z_o."""
    z, f = object_distance, focal_length
    near = _is_near(z, f)
    close = jnp.where(near, z, 0) * f * _reciprocal(jnp.where(near, z, 0) - f)
    return jnp.where(near, close, f / (1 - f / jnp.where(near, jnp.inf, z)))


def image_vergence(object_distance: Scalars, focal_length: Scalars) -> Scalars:
    """1 / z_i = 1 / f - 1 / z_o in m^-1, from distances in m: finite where the image is not, 0 at
    z_o = f and negative for a virtual image."""
    return vergence_difference(focal_length, object_distance)


def vergence_difference(first: Scalars, second: Scalars) -> Scalars:
    """1 / first - 1 / second in m^-1, from distances in m, with all digits where they are nearly
    equal."""
    near = _is_near(first, second) & _is_near(second, first) & jnp.isfinite(first)
    a, b = (jnp.where(near, z, 1) for z in (first, second))
    close = (b - a) * _reciprocal(a) * _reciprocal(b)
    far = _reciprocal(first) - _reciprocal(second)
    return jnp.where(near, close, far)


def magnification(object_distance: Scalars, focal_length: Scalars) -> Scalars:
    """m = -z_i / z_o = f / (f - z_o): image size over object size, relative; negative where the
    image stands on its head. Distances in m."""
    return -focal_length * _reciprocal(object_distance - focal_length)


def working_f_number(f_number: Scalars, focus_distance: Scalars, focal_length: Scalars) -> Scalars:
    """z_i / d = N (1 + |m|): image distance over lens diameter, relative, when the lens is in focus
    at a distance; distances in m. It sets exposure and diffraction, and is N at infinity focus."""
    return f_number * _reciprocal(image_vergence(focus_distance, focal_length) * focal_length)


def lens_power(
    front_curvature: Scalars,
    back_curvature: Scalars,
    refractive_index: Scalars,
    *,
    thickness: Scalars | None = None,
) -> Scalars:
    """1 / f = (n - 1) (c_1 - c_2 + (n - 1) t c_1 c_2 / n) in m^-1: the lensmaker's equation.

    Curvatures: 1 / radius in m^-1, 0 for a plane, positive where the centre lies behind the
    surface, so that a biconvex lens has c_1 > 0 > c_2. `refractive_index`: n > 0, relative to the
    medium around. `thickness`: t in m on the axis; None is a thin lens. Thick ones are measured
    from their principal planes.
    """
    bending = front_curvature - back_curvature
    if thickness is not None:
        reduced = (refractive_index - 1) * thickness / refractive_index
        bending = bending + reduced * front_curvature * back_curvature
    return (refractive_index - 1) * bending


def lens_focal_length(
    front_curvature: Scalars,
    back_curvature: Scalars,
    refractive_index: Scalars,
    *,
    thickness: Scalars | None = None,
) -> Scalars:
    """f in m, negative for a lens that spreads the light: the reciprocal of `lens_power`, whose
    arguments it takes."""
    return _reciprocal(
        lens_power(front_curvature, back_curvature, refractive_index, thickness=thickness)
    )


def circle_of_confusion(
    object_distance: Scalars, focus_distance: Scalars, focal_length: Scalars, f_number: Scalars
) -> Scalars:
    """c = d z_i |1 / z_o - 1 / z_f| with d = f / N: the diameter in m, on a sensor at the image z_i
    of the distance z_f in focus, of the disc that is made of a point at z_o. Distances in m; 0,
    with gradient 0, in focus."""
    image = image_distance(focus_distance, focal_length)
    blur = image * vergence_difference(object_distance, focus_distance)
    return focal_length / f_number * (jnp.sign(blur) * blur)


def depth_of_field(
    focus_distance: Scalars, focal_length: Scalars, f_number: Scalars, allowed_blur: Scalars
) -> tuple[Scalars, Scalars]:
    """(near, far) in m: between them the circle of confusion is at most `allowed_blur`, m on the
    sensor. Distances in m; `far` is inf, with gradient 0, from the hyperfocal distance on.

    1 / z = 1 / z_f +- c N / (f z_i).
    """
    focused = _reciprocal(focus_distance)
    image = image_vergence(focus_distance, focal_length)
    tolerance = jnp.abs(allowed_blur * f_number * image / focal_length)
    return _positive_reciprocal(focused + tolerance), _positive_reciprocal(focused - tolerance)


def hyperfocal_distance(focal_length: Scalars, f_number: Scalars, allowed_blur: Scalars) -> Scalars:
    """f + f^2 / (c N) in m: the nearest distance to focus at for which infinity is still sharp to a
    blur of c m on the sensor; everything from half of it on is. inf where c N is 0."""
    return focal_length + _positive_reciprocal(f_number * allowed_blur / focal_length**2)


def _is_near(z: Scalars, f: Scalars) -> Bool[Array, "..."]:
    """Where z is at most twice f, and in the reciprocals' difference digits would go."""
    return jnp.abs(z) <= 2 * jnp.abs(f)


def _reciprocal(x: Scalars) -> Scalars:
    """1 / x; at a size below `smallest_divisor` that of the divisor itself, with gradient 0."""
    least = smallest_divisor(x.dtype)
    usable = ~(jnp.abs(x) <= least)
    return jnp.where(usable, 1 / jnp.where(usable, x, 1), jnp.where(x < 0, -1 / least, 1 / least))


def _positive_reciprocal(x: Scalars) -> Scalars:
    """1 / x; inf, with gradient 0, at and below 0."""
    usable = ~(x <= smallest_divisor(x.dtype))
    return jnp.where(usable, 1 / jnp.where(usable, x, 1), jnp.inf)
