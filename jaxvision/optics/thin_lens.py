"""The thin lens: position, size and sharpness of the image of an object.

    1 / z_o + 1 / z_i = 1 / f

with object distance z_o and image distance z_i in m from the lens, both positive for a real object
and a real image. z_i < 0 is a virtual image on the object's side, as for an object inside the focal
length. All functions act elementwise on arrays that broadcast. For a distance of inf the result is
the exact limit, with gradient 0. NaN stays NaN. Divisors are at least `smallest_divisor`, 3e-10 in
float32. At z_o = f the image distance is therefore f^2 / `smallest_divisor` instead of infinite,
and all gradients are finite.

Sources:
    Szeliski, Computer Vision, section 2.2.3; Hecht, Optics, chapters 5 and 6.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ..core._arguments import takes_numbers, takes_range
from ..core._numerics import divide, or_one, smallest_divisor
from ..core._types import AMOUNT, Scalars, is_known

LONGEST = 10.0  # m; only telescopes have longer focal lengths, and their objects are far
NARROWEST_BLUR = 1e-6  # rad; smaller blurs are probably given in another unit


@takes_numbers
def image_distance(object_distance: Scalars, focal_length: Scalars) -> Scalars:
    """Return the distance at which a thin lens images an object: z_i = f z_o / (z_o - f).

    The law is symmetric: an object at z_i is imaged at z_o.

    Args:
        object_distance: (...) m from the lens; inf is allowed.
        focal_length: (...) m.

    Returns:
        (...) m from the lens, negative for a virtual image; very large but finite at z_o = f.

    Raises:
        ValueError: for a focal length of 10 m or more with an object inside it, as if 50 mm were
            passed as 50. All functions here that take a distance and a focal length check this.

    Example:
        >>> z_i = jv.image_distance(jnp.array(1.0), jnp.array(0.05))
        >>> round(float(1 / 1.0 + 1 / z_i), 6)  # 1 / f
        20.0
    """
    _check_metres("image_distance", object_distance, focal_length)
    z, f = object_distance, focal_length
    close, far = _parts(z, f)
    return jnp.where(_is_near(z, f), close * f * _reciprocal(close - f), f / (1 - f / far))


@takes_numbers
def image_vergence(object_distance: Scalars, focal_length: Scalars) -> Scalars:
    """Return the reciprocal of the image distance, 1 / z_i = 1 / f - 1 / z_o, which is finite even
    if z_i is infinite.

    Args:
        object_distance: (...) m from the lens.
        focal_length: (...) m.

    Returns:
        (...) m^-1; 0 at z_o = f and negative for a virtual image.

    Example:
        >>> print(f"{1000 / jv.optics.image_vergence(2.0, 0.05):.2f} mm")  # behind the lens
        51.28 mm
    """
    _check_metres("image_vergence", object_distance, focal_length)
    return vergence_difference(focal_length, object_distance)


@takes_numbers
def vergence_difference(first: Scalars, second: Scalars) -> Scalars:
    """Return the difference of two reciprocal distances, accurate even if they are nearly equal.

    Args:
        first: (...) m.
        second: (...) m.

    Returns:
        1 / first - 1 / second, (...) m^-1.

    Example:
        >>> print(jv.optics.vergence_difference(0.5, 1.0))  # dioptres
        1.0
    """
    near = _is_near(first, second) & _is_near(second, first) & jnp.isfinite(first)
    closer = _is_near(first, second, 4.0) & _is_near(second, first, 4.0) & jnp.isfinite(first)
    a, b = (or_one(z, closer) for z in (first, second))
    close = (b - a) * _reciprocal(a) * _reciprocal(b)
    far = _reciprocal(first) - _reciprocal(second)
    return jnp.where(near, close, far)


@takes_numbers
def magnification(object_distance: Scalars, focal_length: Scalars) -> Scalars:
    """Return the ratio of image size to object size: m = -z_i / z_o = f / (f - z_o).

    Args:
        object_distance: (...) m from the lens.
        focal_length: (...) m.

    Returns:
        (...) relative; negative if the image is inverted.

    Example:
        >>> f = jnp.array(0.05)
        >>> round(float(jv.optics.magnification(2 * f, f)), 6)
        -1.0
    """
    _check_metres("magnification", object_distance, focal_length)
    return -focal_length * _reciprocal(object_distance - focal_length)


@takes_numbers
@takes_range(f_number=AMOUNT, focus_distance=AMOUNT)
def working_f_number(f_number: Scalars, focus_distance: Scalars, focal_length: Scalars) -> Scalars:
    """Return the ratio of image distance to lens diameter, z_i / d = N (1 + |m|), for a lens in
    focus.

    m is the magnification. The working f-number determines exposure and diffraction. For focus at
    infinity it equals N.

    Args:
        f_number: (...) N of the lens, no unit.
        focus_distance: (...) m from the lens to the plane in focus.
        focal_length: (...) m.

    Returns:
        (...) relative (no unit).

    Raises:
        ValueError: for an f-number or a distance below 0, and for a focus distance inside the focal
            length, whose image is virtual.

    Example:
        >>> f = jnp.array(0.05)
        >>> round(float(jv.optics.working_f_number(jnp.array(8.0), 2 * f, f)), 6)  # 1 : 1
        16.0
    """
    _check_focus("working_f_number", focus_distance, focal_length)
    z, f = focus_distance, focal_length
    close, far = _parts(z, f)
    magnified = jnp.where(_is_near(z, f), close * _reciprocal(close - f), 1 / (1 - f / far))
    return f_number * magnified


@takes_numbers
def lens_power(
    front_curvature: Scalars,
    back_curvature: Scalars,
    refractive_index: Scalars,
    *,
    thickness: Scalars | None = None,
) -> Scalars:
    """Return 1 / f = (n - 1) (c_1 - c_2 + (n - 1) t c_1 c_2 / n), the lensmaker's equation.

    Distances of a thick lens are measured from its principal planes.

    Args:
        front_curvature: (...) 1 / radius in m^-1, 0 for a plane; positive if the centre lies behind
            the surface, so that a biconvex lens has c_1 > 0 > c_2.
        back_curvature: (...) m^-1, of the same sign convention.
        refractive_index: (...) n > 0, relative to the surrounding medium.
        thickness: (...) t in m on the axis; None for a thin lens.

    Returns:
        (...) m^-1.

    Example:
        >>> c = jnp.array(10.0)
        >>> float(jv.optics.lens_power(c, -c, jnp.array(1.5)))
        10.0
    """
    bending = front_curvature - back_curvature
    if thickness is not None:
        reduced = (refractive_index - 1) * thickness / refractive_index
        bending = bending + reduced * front_curvature * back_curvature
    return (refractive_index - 1) * bending


@takes_numbers
def lens_focal_length(
    front_curvature: Scalars,
    back_curvature: Scalars,
    refractive_index: Scalars,
    *,
    thickness: Scalars | None = None,
) -> Scalars:
    """Return the focal length of a lens: the reciprocal of `lens_power`.

    Args:
        front_curvature: (...) m^-1, as in `lens_power`.
        back_curvature: (...) m^-1, as in `lens_power`.
        refractive_index: (...) n > 0, relative to the surrounding medium.
        thickness: (...) m on the axis; None for a thin lens.

    Returns:
        (...) m; negative for a diverging lens.

    Example:
        >>> print(f"{jv.optics.lens_focal_length(10.0, -10.0, 1.5):.3f} m")  # radii 0.1 m
        0.100 m
    """
    return _reciprocal(
        lens_power(front_curvature, back_curvature, refractive_index, thickness=thickness)
    )


@takes_numbers
@takes_range(focus_distance=AMOUNT, f_number=AMOUNT)
def circle_of_confusion(
    object_distance: Scalars, focus_distance: Scalars, focal_length: Scalars, f_number: Scalars
) -> Scalars:
    """Return the diameter, on the sensor, of the image of a point out of focus: c = d z_i |1 / z_o
    - 1 / z_f|.

    d = f / N is the lens diameter and z_i the image distance of the plane in focus, where the
    sensor is.

    Args:
        object_distance: (...) z_o in m from the lens; negative for light that converges toward a
            point behind the lens.
        focus_distance: (...) z_f in m from the lens to the plane in focus.
        focal_length: (...) f in m.
        f_number: (...) N, no unit.

    Returns:
        (...) m on the sensor; 0, with gradient 0, in focus.

    Raises:
        ValueError: for a plane in focus behind the lens or inside its focal length, or an f-number
            below 0.

    Example:
        >>> z_f, f, N = jnp.array(1.0), jnp.array(0.05), jnp.array(2.0)
        >>> c = jv.circle_of_confusion(jnp.array(jnp.inf), z_f, f, N)
        >>> round(float(c) * 1e3, 4)  # f^2 / (N (z_f - f)), in mm
        1.3158
    """
    _check_focus("circle_of_confusion", focus_distance, focal_length)
    image = image_distance(focus_distance, focal_length)
    blur = image * vergence_difference(object_distance, focus_distance)
    return focal_length / f_number * (jnp.sign(blur) * blur)


@takes_numbers
@takes_range(focus_distance=AMOUNT, focal_length=AMOUNT, f_number=AMOUNT, allowed_blur=AMOUNT)
def depth_of_field(
    focus_distance: Scalars, focal_length: Scalars, f_number: Scalars, allowed_blur: Scalars
) -> tuple[Scalars, Scalars]:
    """Return the distances z between which the circle of confusion is at most `allowed_blur`.

        1 / z = 1 / z_f +- c N / (f z_i)

    Args:
        focus_distance: (...) z_f in m from the lens to the plane in focus.
        focal_length: (...) f in m.
        f_number: (...) N, no unit.
        allowed_blur: (...) c in m on the sensor.

    Returns:
        (near, far), each (...) m; `far` is inf, with gradient 0, from the hyperfocal distance on.

    Raises:
        ValueError: for an argument below 0, a focus distance inside the focal length, or a focal
            length of more than a million times the blur, where one is probably in mm.

    Example:
        >>> z_f, f, N, c = (jnp.array(x) for x in (3.0, 0.05, 8.0, 30e-6))
        >>> near, far = jv.depth_of_field(z_f, f, N, c)
        >>> round(float(1 / near + 1 / far), 6)  # 2 / z_f
        0.666667
    """
    _check_blur("depth_of_field", focal_length, allowed_blur)
    _check_focus("depth_of_field", focus_distance, focal_length)
    focused = _reciprocal(focus_distance)
    image = image_vergence(focus_distance, focal_length)
    tolerance = jnp.abs(allowed_blur * f_number * image / focal_length)
    return _positive_reciprocal(focused + tolerance), _positive_reciprocal(focused - tolerance)


@takes_numbers
@takes_range(focal_length=AMOUNT, f_number=AMOUNT, allowed_blur=AMOUNT)
def hyperfocal_distance(focal_length: Scalars, f_number: Scalars, allowed_blur: Scalars) -> Scalars:
    """Return the nearest focus distance at which infinity is still sharp: f + f^2 / (c N).

    With that focus, everything beyond half the hyperfocal distance is sharp.

    Args:
        focal_length: (...) f in m.
        f_number: (...) N, no unit.
        allowed_blur: (...) c in m on the sensor.

    Returns:
        (...) m; inf if c N is 0.

    Raises:
        ValueError: for an argument below 0, or a focal length of more than a million times the
            blur, where one is probably in mm.

    Example:
        >>> H = jv.hyperfocal_distance(jnp.array(0.05), jnp.array(8.0), jnp.array(30e-6))
        >>> round(float(H), 4)
        10.4667
    """
    _check_blur("hyperfocal_distance", focal_length, allowed_blur)
    return focal_length + _positive_reciprocal(f_number * allowed_blur / focal_length**2)


def _check_metres(name: str, distance: Scalars, focal_length: Scalars) -> None:
    """Raise `ValueError` for a focal length that seems not to be in m, if both are known."""
    if not (is_known(distance) and is_known(focal_length)):
        return
    distances, lengths = np.broadcast_arrays(np.asarray(distance), np.asarray(focal_length))
    odd = (lengths >= LONGEST) & (lengths < np.inf) & (distances > 0) & (distances < lengths)
    if odd.any():
        raise ValueError(
            f"{name}: focal_length must be in m (50 mm are 0.05), got {lengths[odd][0]:g} with an "
            f"object at {distances[odd][0]:g} m, inside it."
        )


def _check_focus(name: str, distance: Scalars, focal_length: Scalars) -> None:
    """Raise `ValueError` for a plane in focus with a virtual image, if both are known."""
    _check_metres(name, distance, focal_length)
    if not (is_known(distance) and is_known(focal_length)):
        return
    distances, lengths = np.broadcast_arrays(np.asarray(distance), np.asarray(focal_length))
    odd = (distances < lengths) | (lengths < 0)
    if odd.any():
        raise ValueError(
            f"{name}: a plane at {distances[odd][0]:g} m has a virtual image behind a focal length "
            f"of {lengths[odd][0]:g} m, and no sensor receives it; focus beyond the focal length."
        )


def _check_blur(name: str, focal_length: Scalars, allowed_blur: Scalars) -> None:
    """Raise `ValueError` for lengths that seem to have different units, if they are known."""
    if not (is_known(focal_length) and is_known(allowed_blur)):
        return
    lengths, blurs = np.broadcast_arrays(np.abs(focal_length), np.abs(allowed_blur))
    odd = (blurs > 0) & (lengths > blurs / NARROWEST_BLUR)
    if odd.any():
        length, blur = float(lengths[odd][0]), float(blurs[odd][0])
        raise ValueError(
            f"{name}: focal_length and allowed_blur must be in m (50 mm are 0.05), got "
            f"{length:g} and {blur:g}: the blur would be {blur / length:.1g} rad wide."
        )


def _is_near(z: Scalars, f: Scalars, times: float = 2.0) -> Bool[Array, "..."]:
    """Whether |z| is at most `times` |f|, where the difference of reciprocals would cancel."""
    return jnp.abs(z) <= times * jnp.abs(f)


def _parts(z: Scalars, f: Scalars) -> tuple[Scalars, Scalars]:
    """Return two copies of z, m: one for the formula for near z, one for the formula for far z.
    Outside the range of its formula, z is replaced by a value that gives finite numbers.
    """
    return jnp.where(_is_near(z, f, 4.0), z, 0), jnp.where(_is_near(z, f, 1.5), jnp.inf, z)


def _reciprocal(x: Scalars) -> Scalars:
    """Return 1 / x. If |x| is below `smallest_divisor`, return 1 / divisor with gradient 0."""
    least = smallest_divisor(x.dtype)
    return 1 / jnp.where(jnp.abs(x) <= least, jnp.where(x < 0, -least, least), x)


def _positive_reciprocal(x: Scalars) -> Scalars:
    """Return 1 / x, and inf with gradient 0 for x <= 0."""
    return divide(1, x, ~(x <= smallest_divisor(x.dtype)), jnp.inf)
