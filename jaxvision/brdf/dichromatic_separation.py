"""Separate a picture of ONE material into Shafer's two terms, body and interface.

Each pixel is m_b c_b + m_i c_i. The colours lie in the dichromatic plane, which contains black, the
body's colour c_b and the illuminant's colour c_i. The factors m_b and m_i, both >= 0, are the
coordinates of a pixel in this plane.

    illuminant known, body not   c_b is the edge of the cloud of colours farthest from c_i, see
                                 `body_colour`
    illuminant unknown           with two materials or more, c_i is the line in which their planes
                                 meet, see `plane_normal` and `illuminant_from_planes`

The separation fails in three cases:

* Body and illuminant have similar colours (a neutral or metallic body, `angle` near 0). The noise
  of m_b and m_i grows as 1 / sin(angle), which is `noise_gain`. If body and illuminant have the
  same colour, the two terms are not identifiable.
* The illuminant's colour is wrong, there are several materials, or there is light of another colour
  or interreflection. Pixels then lie outside the dichromatic plane, and `residual` exceeds the
  noise. A wrong illuminant INSIDE the plane mixes the terms. This error is detected only if some
  pixels need a negative factor.
* Every pixel contains some interface reflection. Then `body_colour` is biased toward the
  illuminant, and m_i is too low by a multiple of m_b.

Exclude dark and saturated pixels by `valid`. Colours are linear and relative, (..., bands), with at
least two bands. Sources: Shafer, Color Research and Application 10(4) (1985); Klinker, Shafer &
Kanade, "The Measurement of Highlights in Color Images", IJCV 2 (1988); Lee, JOSA A 3(10) (1986).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..core._arguments import takes_numbers, warn_caller
from ..core._numerics import divide, magnitude, or_one, running_sum, safe_sqrt, smallest_divisor
from ..core._shown import Shown
from ..core._types import Colour, Scalar, check_shape, print_by_name

Pixels = Float[Array, "... channels"]
Mask = Bool[Array, "..."]
Factors = Float[Array, "..."]
print_by_name(globals(), "Pixels", "Mask", "Factors")


class Separation(Shown):
    """The body and interface terms of a picture, with measures of their reliability.

    Attributes:
        body: (...) >= 0, the geometry factor m_b for a body colour of unit length, in the picture's
            unit.
        interface: (...) >= 0, the geometry factor m_i for an illuminant of unit length, in the
            picture's unit.
        residual: (...) distance of each pixel from the fit, in the picture's unit.
        body_colour: (bands,) of length 1, no unit.
        illuminant: (bands,) of length 1, no unit.
        angle: () between the two colours, radians.
        noise_gain: () standard deviation of m_b (and of m_i) over that of one band, for independent
            noise of equal size in all bands, where both factors are positive: 1 / sin(angle), no
            unit.

    Example:
        >>> white, red = jnp.ones(3), jnp.array([1.0, 0.0, 0.0])
        >>> found = jv.separate(jnp.array([[3.0, 1.0, 1.0]]), white, body=red)
        >>> round(float(found.angle), 4), round(float(found.noise_gain), 4)  # arccos(1 / sqrt(3))
        (0.9553, 1.2247)
    """

    body: Factors
    interface: Factors
    residual: Factors
    body_colour: Colour
    illuminant: Colour
    angle: Scalar
    noise_gain: Scalar


@takes_numbers
def usable_pixels(image: Pixels, *, dark: float | Scalar, saturated: float | Scalar) -> Mask:
    """Return the mask, (...), of pixels of a linear image whose brightest band lies above `dark`
    and whose bands all lie below `saturated`, both in the image's unit."""
    if image.ndim == 0 or image.shape[-1] == 0:
        raise ValueError(f"image must be (..., bands), with at least one, got shape {image.shape}.")
    return (image < saturated).all(axis=-1) & (image.max(axis=-1) > dark)


@takes_numbers
def separate(
    image: Pixels,
    illuminant: Colour,
    *,
    body: Colour | None = None,
    valid: Mask | None = None,
    quantile: float = 0.02,
) -> Separation:
    """Find the non-negative body and interface factors of each pixel by least squares.

    All pixels are separated, also those that `valid` excludes. The non-negative optimum has a
    closed form: it is the unconstrained optimum if both factors are positive there, else the better
    of the two fits with a single term.

    Args:
        image: (..., bands) linear, relative.
        illuminant: (bands,) relative colour of the light, as the camera sees a white surface.
        body: (bands,) relative colour of the material, or None, which estimates it by
            `body_colour`.
        valid: (...) pixels that `body_colour` uses; all by default.
        quantile: as for `body_colour`, in (0, 1), no unit.

    Returns:
        The factors, the colours and their reliability.

    Raises:
        ValueError: for an illuminant or a body whose number of bands differs from the image's.

    Example:
        >>> white, red = jnp.ones(3), jnp.array([1.0, 0.0, 0.0])
        >>> found = jv.separate(jnp.array([[3.0, 1.0, 1.0]]), white, body=red)  # 2 red + 1 white
        >>> round(float(found.body[0]), 4), round(float(found.interface[0]), 4)  # 2 and sqrt(3)
        (2.0, 1.7321)
    """
    check_shape("illuminant", illuminant, (image.shape[-1],))
    check_shape("body", body, (image.shape[-1],))
    c_i = _unit(illuminant)
    if body is not None and quantile != 0.02:
        warn_caller("separate: quantile has no effect beside a body colour; leave it out.")
    c_b = body_colour(image, illuminant, valid=valid, quantile=quantile) if body is None else body
    c_b = _unit(c_b)
    cos = (c_b * c_i).sum()
    aside = c_b - cos * c_i
    sine = _length(aside)
    least = float(jnp.finfo(image.dtype).eps)
    same = sine <= least
    on_b, on_i = image @ c_b, image @ c_i
    below = jnp.square(jnp.maximum(sine, least))
    m_b, m_i = (on_b - cos * on_i) / below, (on_i - cos * on_b) / below
    outside = same | (m_b <= 0) | (m_i <= 0)
    alone_b, alone_i = jnp.maximum(on_b, 0), jnp.maximum(on_i, 0)
    body_wins = alone_b >= alone_i
    m_b = jnp.where(outside, jnp.where(body_wins, alone_b, 0), m_b)
    m_i = jnp.where(outside, jnp.where(body_wins, 0, alone_i), m_i)
    left = image - m_b[..., None] * _as_row(c_b, image) - m_i[..., None] * _as_row(c_i, image)
    return Separation(
        body=m_b,
        interface=m_i,
        residual=_length(left),
        body_colour=c_b,
        illuminant=c_i,
        angle=jnp.arctan2(sine, cos),
        noise_gain=1 / jnp.maximum(sine, jnp.finfo(image.dtype).eps),
    )


@takes_numbers
def body_colour(
    image: Pixels, illuminant: Colour, *, valid: Mask | None = None, quantile: float = 0.02
) -> Colour:
    """Estimate the colour of a material, (bands,) of length 1, no unit, from a linear picture in
    which some pixels have no highlight. Each pixel is decomposed into a component parallel to the
    illuminant and one perpendicular to it. The colour is the mean direction of the perpendicular
    components, plus the illuminant times the smallest ratio parallel / perpendicular. The smallest
    ratio is estimated as the `quantile`, in (0, 1), of the ratios, weighted by the perpendicular
    component. For a neutral body the result is the illuminant."""
    c_i = _unit(illuminant)
    used = image if valid is None else jnp.where(valid[..., None], image, 0)
    image = image / magnitude(used, axis=None)
    weight = jnp.ones(image.shape[:-1], image.dtype)
    weight = weight if valid is None else jnp.where(valid, weight, 0)
    along = image @ c_i
    across = image - along[..., None] * _as_row(c_i, image)
    # The mean is the main direction: all pixels lie on one side of the illuminant.
    total = (weight[..., None] * across).reshape(-1, image.shape[-1]).sum(axis=0)
    length = _length(total)
    tinted = ~(length <= jnp.finfo(image.dtype).eps * jnp.abs(weight * along).sum())
    side = total / or_one(length, ~(length <= smallest_divisor(length.dtype)))
    m = jnp.maximum((across @ side) * weight, 0).reshape(-1)
    positive = m > smallest_divisor(m.dtype)
    ratio = divide(along.reshape(-1), m, where=positive, otherwise=jnp.inf)
    order = jnp.argsort(ratio)
    share = running_sum(m[order])
    chosen = order[jnp.searchsorted(share, quantile * share[-1])]
    return jnp.where(tinted, _unit(side + jnp.where(positive, ratio, 0)[chosen] * c_i), c_i)


@takes_numbers
def plane_normal(image: Pixels, *, valid: Mask | None = None) -> tuple[Colour, Colour]:
    """Return the unit normal, (3,), of a material's dichromatic plane in a linear picture, and the
    root mean squares of the colours along their main axes, (3,), ascending, in the picture's unit.
    If the first two root mean squares are both at the noise level, the colours lie on a line and
    the plane is not determined."""
    check_shape("one pixel", image[(0,) * (image.ndim - 1)], (3,))
    pixels = image.reshape(-1, 3)
    weight = jnp.ones_like(pixels[:, 0]) if valid is None else valid.reshape(-1).astype(image.dtype)
    moments = (weight[:, None] * pixels).T @ pixels / jnp.maximum(weight.sum(), 1)
    sizes, axes = _eigh(moments)
    return axes[:, 0], safe_sqrt(sizes)


@takes_numbers
def illuminant_from_planes(normals: Float[Array, "planes 3"]) -> tuple[Colour, Scalar]:
    """Return the illuminant's colour, (3,), as the direction common to the dichromatic planes with
    unit `normals`, (planes, 3), by least squares (Lee 1986). The colour has a norm of 1 and a
    positive sum. Also return a measure () in [0, 1] of how well the planes determine the colour."""
    moments = normals.T @ normals
    sizes, axes = _eigh(moments)
    colour = axes[:, 0]
    total = jnp.maximum(sizes[2], smallest_divisor(sizes.dtype))
    return jnp.where(colour.sum() < 0, -colour, colour), safe_sqrt(sizes[1] / total)


@jax.custom_jvp
def _eigh(matrix: Float[Array, "3 3"]) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    """Return the ascending eigenvalues and the eigenvectors (columns) of a symmetric matrix. The
    gradient ignores rotations among eigenvectors of equal eigenvalues, whose basis is arbitrary."""
    sizes, axes = jnp.linalg.eigh(matrix)
    return sizes, axes


@_eigh.defjvp
def _eigh_jvp(primals, tangents):
    """Differentiate `_eigh` of a matrix M: dlambda_i = v_i . dM v_i and dv_j = sum_i v_i (v_i . dM
    v_j) / (lambda_j - lambda_i)."""
    sizes, axes = _eigh(*primals)
    turned = axes.T @ tangents[0] @ axes
    apart = sizes[None, :] - sizes[:, None]
    alike = jnp.abs(apart) <= 4 * jnp.finfo(sizes.dtype).eps * jnp.abs(sizes).max()
    return (sizes, axes), (jnp.diagonal(turned), axes @ divide(turned, apart, ~alike))


def _as_row(colour: Colour, image: Pixels) -> Pixels:
    return colour.reshape((1,) * (image.ndim - 1) + colour.shape)


def _length(v: Pixels) -> Factors:
    size = magnitude(v)
    return size[..., 0] * safe_sqrt(jnp.square(v / size).sum(axis=-1))


def _unit(colour: Colour) -> Colour:
    sized = colour / magnitude(colour)
    return sized / or_one(_length(sized))
