"""Defocus of a sharp picture by its depth map.

One pass over the picture approximates a rendering with hundreds of rays per pixel through the lens.

A point whose reciprocal distance differs by delta from that of the plane in focus is blurred to an
image of the aperture. That image has the signed radius (d / 2) z_i delta, with the lens diameter d
and the image distance z_i: the image is upright for points nearer than the plane in focus, and
inverted for points behind it. For a single plane, all methods agree with rays sampled over the
lens. The methods differ at the edge of a nearer surface, because the sharp picture does not contain
the light from behind it:

- `gather_defocus`: each pixel averages by its own kernel. A flat picture stays flat. A blurred
  foreground before a sharp background wrongly keeps a sharp edge.
- `scatter_defocus`: each pixel spreads its light by its own kernel. The sum of light is conserved,
  but where surfaces meet, pixels get too much or too little light.
- `layered_defocus`: surfaces are blurred by depth and composited. A foreground's blurred edge
  covers the background, whose hidden part is extrapolated from its visible part.

The RMS errors were measured over 48 x 64 pixels against 48 x 48 rays per pixel, on patterns of
amplitude 0.3 to 0.4. For a plane blurred by 7 to 10 pixels the errors are 3e-4 to 7e-4 for all
methods. For a blurred foreground before a sharp background they are 0.04 (gather), 0.11 (scatter)
and 0.03 (layers). For a sharp foreground before a blurred background they are 0.001 to 0.007
(gather), 0.10 (scatter) and 0.005 to 0.02 (layers). If foreground and background are both blurred,
the errors are 0.01 to 0.04 for all methods.

Pictures are (h, w, bands) in any unit linear in light. `depth` is (h, w) m along the optical axis,
not along the ray. A pixel of depth NaN (unknown) counts as in focus. `radius` is the static radius
in pixels of the largest kernel; larger blurs are truncated.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import divide, smallest_divisor
from ..core._types import Scalar, Scalars, check_count, print_by_name
from ..filters import adjoint, correlate, correlate_bank, disk_profile, radial_blur
from ..scene import CircularAperture, ThinLens
from .aperture import aperture_kernel
from .thin_lens import _reciprocal, vergence_difference
from .views import sensor_vergence

Picture = Float[Array, "h w bands"]
Depth = Float[Array, "h w"]
Plane = Float[Array, "h w ..."]
print_by_name(globals(), "Picture", "Depth", "Plane")

# Smallest share of a pixel at which a layer's colour is well determined there
_FEW = 1e-3


@takes_numbers
def defocus_radius(view: ThinLens, depth: Scalars) -> Scalars:
    """Return the signed radius, in pixels, of the blurred image of a point: half the circle of
    confusion.

    Args:
        view: the lens.
        depth: (...) m along the axis; inf is allowed.

    Returns:
        (...) pixels; positive nearer than the plane in focus, negative behind it.

    Example:
        >>> at = {"resolution": (2, 2), "f_number": 2.0, "focus_distance": 2.0}
        >>> lens = jv.ThinLens([0, 0, 0], np.eye(3), 0.05, 1e-5, **at)
        >>> print([f"{jv.optics.defocus_radius(lens, z):.1f}" for z in (1.0, 2.0, np.inf)])
        ['32.1', '0.0', '-32.1']
    """
    focus = jnp.inf if view.focus_distance is None else view.focus_distance
    focus = jnp.broadcast_to(jnp.asarray(focus, depth.dtype), depth.shape)
    return vergence_difference(depth, focus) * _pixels_per_vergence(view)


@takes_numbers
def gather_defocus(
    view: ThinLens, picture: Picture, depth: Depth, *, radius: int, members: int | None = None
) -> Picture:
    """Blur each pixel by the kernel for its own depth.

    Kernels of a round aperture are exact up to their edge, which is softened over one pixel.
    Kernels of other apertures are blended from a bank of kernels. The picture is mirrored at its
    border.

    Args:
        view: the lens.
        picture: (h, w, bands) in any unit linear in light.
        depth: (h, w) m along the axis; NaN counts as in focus.
        radius: radius of the largest kernel in pixels, static, at least 1.
        members: number of kernels in the bank, static, at least 2; None for one upright and one
            inverted kernel per pixel of radius. Unused for a round aperture.

    Returns:
        (h, w, bands) in the unit of the picture.

    Raises:
        ValueError: `radius` or `members` is too small.

    Example:
        >>> view = dict(rotation=np.eye(3), focal_length=0.05, pixel_pitch=1e-5, resolution=(5, 5))
        >>> lens = jv.ThinLens([0, 0, 0], **view, f_number=2.0, focus_distance=3.0)
        >>> star = jnp.zeros((5, 5, 1)).at[2, 2].set(1.0)
        >>> blurred = jv.gather_defocus(lens, star, jnp.full((5, 5), 3.2), radius=2)
        >>> bool(blurred[2, 2, 0] < 0.3), round(float(blurred.sum()), 3)  # spread, and none is lost
        (True, 1.0)
    """
    return _gather(view, picture, _blur(view, depth), radius=radius, members=members)


@takes_numbers
def scatter_defocus(
    view: ThinLens, picture: Picture, depth: Depth, *, radius: int, members: int | None = None
) -> Picture:
    """Spread each pixel's light over the image of the aperture for its own depth.

    The function is the transpose of `gather_defocus`. The sum of light is conserved, because light
    that leaves the picture is mirrored back.

    Args:
        view: the lens.
        picture: (h, w, bands) in any unit linear in light.
        depth: (h, w) m along the axis; NaN counts as in focus.
        radius: radius of the largest kernel in pixels, static, at least 1.
        members: number of kernels in the bank, as in `gather_defocus`.

    Returns:
        (h, w, bands) in the unit of the picture.

    Raises:
        ValueError: `radius` or `members` is too small.
    """
    turned = -_blur(view, depth)

    def gather(light: Picture) -> Picture:
        return _gather(view, light, turned, radius=radius, members=members)

    return adjoint(picture, operator=gather)


@takes_numbers
def layered_defocus(
    view: ThinLens, picture: Picture, depth: Depth, *, radius: int, layers: int
) -> Picture:
    """Split the picture into layers of depth, blur each, and composite them, the nearest in front.

    The layers are spaced by equal steps of blur radius from the farthest to the nearest depth. Each
    pixel is divided between the two nearest layers. The coverage A of a layer is the mask of all
    surfaces at or in front of it, blurred like the layer. The layer is visible where its coverage A
    exceeds the coverage of the next nearer layer. The colour of a layer is a mean over the pixels
    that belong to it, so a flat picture stays flat.

    Args:
        view: the lens.
        picture: (h, w, bands) in any unit linear in light.
        depth: (h, w) m along the axis; NaN counts as in focus.
        radius: radius of the largest kernel in pixels, static.
        layers: number of layers, static, at least 1.

    Returns:
        (h, w, bands) in the unit of the picture.

    Raises:
        ValueError: `layers` is less than 1.

    Example:
        A flat picture stays flat at any depths.

        >>> view = dict(rotation=np.eye(3), focal_length=0.05, pixel_pitch=1e-5, resolution=(5, 5))
        >>> lens = jv.ThinLens([0, 0, 0], **view, f_number=2.0, focus_distance=3.0)
        >>> depth, flat = jnp.full((5, 5), 9.0).at[:, :2].set(1.0), jnp.full((5, 5, 1), 0.5)
        >>> blur = jax.jit(lambda flat: jv.layered_defocus(lens, flat, depth, radius=2, layers=2))
        >>> round(float(blur(flat).min()), 4), round(float(blur(flat).max()), 4)
        (0.5, 0.5)
    """
    check_count("layers", layers, 1)
    blur = _blur(view, depth)
    low, high = blur.min(), blur.max()
    span = high - low
    position = divide(blur - low, span, ~(span <= smallest_divisor(span.dtype))) * (layers - 1)

    around = jnp.full((2 * radius + 1,) * 2, 1 / (2 * radius + 1) ** 2, picture.dtype)
    light = jnp.zeros((), picture.dtype)
    covered = jnp.zeros((), picture.dtype)
    for layer in reversed(range(layers)):
        share = jnp.maximum(1 - jnp.abs(position - layer), 0)[..., None].astype(picture.dtype)
        nearer = jnp.clip(position - layer + 1, 0, 1)[..., None].astype(picture.dtype)
        scale = low + span * (layer / max(layers - 1, 1))
        kernel = aperture_kernel(view.aperture, scale, size=2 * radius + 1)
        parts = jnp.concatenate([picture * share, share, nearer], axis=-1)
        blurred = correlate(parts, kernel.astype(picture.dtype))
        if layer == 0:  # the farthest layer continues behind the others, even if it is in focus
            blurred = blurred + _FEW * correlate(parts.at[..., -1].set(0), around)
        own, cover = blurred[..., -2:-1], blurred[..., -1:]
        seen = jnp.maximum(cover - covered, 0) / (own + _FEW**2)
        light = light + seen * blurred[..., :-2]
        # `own` is 0 for an empty layer, which covers nothing even if the blurred mask does
        covered = covered + seen * own
    return divide(light, covered, ~(covered <= smallest_divisor(covered.dtype)), picture)


@takes_numbers
def chromatic_defocus(
    view: ThinLens,
    picture: Picture,
    depth: Depth,
    focal_lengths: Float[Array, "..."],
    *,
    radius: int,
) -> Picture:
    """Apply longitudinal chromatic aberration: `gather_defocus` with a focal length for each band.

    The sensor stays at the view's image distance.

    Args:
        view: the lens.
        picture: (h, w, bands) in any unit linear in light.
        depth: (h, w) m along the axis; NaN counts as in focus.
        focal_lengths: (bands,) m.
        radius: radius of the largest kernel in pixels, static, at least 1.

    Returns:
        (h, w, bands) in the unit of the picture.

    Raises:
        ValueError: `focal_lengths` does not hold one value per band, or `radius` is too small.
    """
    if focal_lengths.shape != picture.shape[-1:]:
        raise ValueError(
            f"focal_lengths must be {picture.shape[-1:]}, one per band, got {focal_lengths.shape}."
        )
    scale = _blur(view, depth)
    shifts = vergence_difference(view.focal_length, focal_lengths) * _pixels_per_vergence(view)

    def blur_band(plane: Float[Array, "h w"], shift: Float[Array, ""]) -> Float[Array, "h w"]:
        return _gather(view, plane, scale + shift, radius=radius, members=None)

    return jax.vmap(blur_band, in_axes=(-1, 0), out_axes=-1)(picture, shifts)


def _blur(view: ThinLens, depth: Depth) -> Depth:
    """Return the signed blur radius in pixels, or 0 where the depth is NaN."""
    known = ~jnp.isnan(depth)
    return jnp.where(known, defocus_radius(view, jnp.where(known, depth, jnp.inf)), 0)


def _pixels_per_vergence(view: ThinLens) -> Scalar:
    """Return the blur radius in pixels per difference of reciprocal distances in m^-1."""
    radius = view.focal_length / view.f_number / 2
    return radius / view.pixel_pitch * _reciprocal(sensor_vergence(view))


def _gather(
    view: ThinLens, picture: Plane, scale: Depth, *, radius: int, members: int | None
) -> Plane:
    check_count("radius", radius, 1)
    if isinstance(view.aperture, CircularAperture):
        return radial_blur(picture, jnp.abs(scale), profile=disk_profile, radius=radius)
    count = 2 * radius + 1 if members is None else members
    check_count("members", count, 2)
    radii = jnp.asarray(np.linspace(-radius, radius, count), scale.dtype)
    bank = jax.vmap(partial(aperture_kernel, view.aperture, size=2 * radius + 1))(radii)
    position = (scale / (2 * radius) + 0.5) * (count - 1)
    return correlate_bank(picture, bank, position)
