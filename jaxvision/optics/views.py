"""Projection: the relation between pixels and the rays that reach them.

Camera axes are right, down and forward. Pixel (0, 0) is the upper left pixel, and integer (row,
column) are centres of pixels, so the optical axis passes between the middle pixels of an even grid.
Lengths are metres.

For a lens at distance z_i from the sensor, the chief ray of the image point (x, y) has the
direction (x / z_i, y / z_i, 1). The ray through the point (a, b) of the lens is

    origin (a, b, 0),   direction (x / z_i - a / z_f, y / z_i - b / z_f, 1)

with z_f the distance in focus. The functions use reciprocals of distances, so infinity is not a
special case.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._numerics import divide, norm, normalize
from ..core._types import Scalar, check_kind, is_known
from ..core._vector import Vec, as_array, as_vec
from ..geometry import Ray
from ..scene import Distortion, Orthographic, Pinhole, ThinLens, View
from .aperture import aperture_point
from .distortion import distort, undistort
from .thin_lens import image_vergence

# Directions count as equal in single precision if the sine of their angle is smaller
PARALLEL = 1e-7


@takes_numbers
def look_at(
    position: Float[Array, "3"], target: Float[Array, "3"], up: Float[Array, "3"]
) -> Float[Array, "3 3"]:
    """Return the rotation of a camera that looks from a position at a target.

    Args:
        position: (3,) m.
        target: (3,) m.
        up: (3,) any vector not along the line of sight, no unit.

    Returns:
        (3, 3), no unit: rows are the unit axes right, down and forward in the world. NaN for traced
        arguments that define no rotation.

    Raises:
        ValueError: if the position is the target, or up lies along the line of sight, so that no
            rotation is defined.

    Example:
        >>> eye, target, up = jnp.array([0.0, 0.0, 5.0]), jnp.zeros(3), jnp.array([0.0, 1.0, 0.0])
        >>> print(jv.look_at(eye, target, up) + 0.0)
        [[ 1.  0.  0.]
         [ 0. -1.  0.]
         [ 0.  0. -1.]]
    """
    if all(map(is_known, (position, target, up))):
        sight, upward = (
            np.asarray(target, float) - np.asarray(position, float),
            np.asarray(up, float),
        )
        if not sight.any():
            raise ValueError(f"look_at: position and target are one point, {position}.")
        lengths = np.linalg.norm(sight) * np.linalg.norm(upward)
        if np.linalg.norm(np.cross(sight, upward)) <= PARALLEL * lengths:
            raise ValueError(
                "look_at: up must be a vector that is not along the line of sight, got "
                f"{upward.tolist()} for a sight along {sight.tolist()}."
            )
    forward = as_array(normalize(target - position))
    across = jnp.cross(forward, as_array(normalize(up)))
    right = as_array(normalize(across))
    rotation = jnp.stack([right, jnp.cross(forward, right), forward])
    return jnp.where(norm(across) > PARALLEL, rotation, jnp.nan)


def opencv_view(
    matrix: np.ndarray,
    *,
    coefficients: np.ndarray | Sequence[float] = (),
    resolution: tuple[int, int],
    rotation: np.ndarray | None = None,
    translation: np.ndarray | None = None,
    pixel_pitch: float = 1e-5,
) -> Pinhole:
    """Return the view of a camera calibrated by OpenCV, with any fx, fy, cx and cy.

    Views have OpenCV's conventions: x right, y down, z forward, and integers at the centres of
    pixels. `u` is the column, `v` the row. The result is an ordinary pinhole, whose `Distortion`
    contains shift and stretch besides the coefficients. The fields of the view may be traced or
    fitted. If fx and fy differ, the irradiance on the sensor is computed for square pixels of the
    pitch, behind a lens that stretches the image.

    Args:
        matrix: (3, 3) [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] pixels.
        coefficients: k1, k2, p1, p2, k3 in the order of OpenCV, none, four or five of them; further
            ones must be 0.
        resolution: (rows, columns) pixels.
        rotation: (3, 3) from the world to the camera, or its Rodrigues vector, (3,) rad; None for
            the identity.
        translation: (3,) m, position of the world's origin in the camera; None for 0.
        pixel_pitch: m between the pixels of a row, which fixes the focal length in m; pictures of
            radiance do not depend on it.

    Returns:
        The view.

    Raises:
        ValueError: for a matrix with skew or of another form, and for coefficients of the rational,
            thin-prism or tilted models.

    Example:
        >>> matrix = np.array([[800.0, 0.0, 300.0], [0.0, 820.0, 250.0], [0.0, 0.0, 1.0]])
        >>> view = jv.optics.opencv_view(
        ...     matrix, coefficients=[-0.1, 0.01, 0, 0], resolution=(480, 640)
        ... )
        >>> seen = jv.project(view, jnp.array([0.0, 0.0, 2.0]))  # a point on the optical axis
        >>> print(round(float(seen.column), 3), round(float(seen.row), 3))
        300.0 250.0
    """
    k, pose = np.asarray(matrix, float), np.eye(3) if rotation is None else np.asarray(rotation)
    if k.shape != (3, 3) or not np.isfinite(k).all() or (k[2] != [0, 0, 1]).any():
        raise ValueError(
            "opencv_view: matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels, got "
            f"{k.tolist()}."
        )
    if k[0, 1] or k[1, 0] or not min(k[0, 0], k[1, 1]) > 0:
        raise ValueError(
            f"opencv_view: matrix must have fx and fy above 0 and no skew, got {k.tolist()}."
        )
    given = np.asarray(coefficients, float).ravel()
    if given.size in (1, 2, 3) or given[5:].any():
        raise ValueError(
            "opencv_view: coefficients must be k1, k2, p1, p2, k3; those of the rational, "
            f"thin-prism and tilted models are not known, got {given.tolist()}."
        )
    k1, k2, p1, p2, k3 = (*given[:5], *np.zeros(5 - min(given.size, 5)))
    if pose.size == 3:
        pose = _rotation_matrix(np.asarray(pose, float).ravel())
    moved = np.zeros(3) if translation is None else np.asarray(translation, float).ravel()
    rows, columns = resolution
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2])
    distortion = Distortion(
        [k1, k2, k3][: 3 if k3 else 2 if k2 else 1],
        [p1, p2] if p1 or p2 else None,
        shift=(k[:2, 2] - middle) / k[0, 0],
        stretch=k[1, 1] / k[0, 0],
    )
    focal_length = k[0, 0] * pixel_pitch
    return Pinhole(
        -pose.T @ moved,
        pose,
        focal_length,
        pixel_pitch,
        resolution=resolution,
        distortion=distortion,
    )


def _rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """Return the (3, 3) rotation about a vector, by its length in rad."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def chip_size(view: View) -> Float[Array, "2"]:
    """Return the height and width of the light-sensitive area: pixels times their pitch.

    Args:
        view: a pinhole or a thin lens. For a parallel projection the pixel pitch, and thus the
            size, is measured in the scene.

    Returns:
        (2,) m; its norm is the diagonal.

    Example:
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 6e-6, resolution=(4000, 6000))
        >>> print(jv.optics.chip_size(view))  # full frame
        [0.024 0.036]
    """
    check_kind("chip_size: view", view, View)
    return jnp.asarray(view.resolution, view.pixel_pitch.dtype) * view.pixel_pitch


def pixel_grid(view: View) -> tuple[Float[Array, " h"], Float[Array, " w"]]:
    """Return the pixel coordinates of the whole picture, in the view's dtype.

    Args:
        view: the camera's projection.

    Returns:
        (rows, columns): (h,) and (w,) in pixels.
    """
    height, width = view.resolution
    dtype = view.pixel_pitch.dtype
    return jnp.arange(height, dtype=dtype), jnp.arange(width, dtype=dtype)


@takes_numbers
def pixel_offset(view: View, row: Scalar, column: Scalar) -> tuple[Scalar, Scalar]:
    """Return the position of a pixel's centre on the sensor, relative to the optical axis.

    Args:
        view: the camera's projection.
        row: () pixels, may be fractional.
        column: () pixels, may be fractional.

    Returns:
        (right, down), each () m.

    Example:
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(2, 2))
        >>> print(*(f"{1e6 * x:.0f} um" for x in jv.optics.pixel_offset(view, 0, 1)))
        5 um -5 um
    """
    rows, columns = view.resolution
    x = (column + (1 - columns) / 2) * view.pixel_pitch
    y = (row + (1 - rows) / 2) * view.pixel_pitch
    return x, y


def sensor_vergence(view: Pinhole | ThinLens) -> Scalar:
    """Return the reciprocal of the distance from the pinhole or lens to the sensor, 1 / z_i.

    Args:
        view: the camera's projection.

    Returns:
        () m^-1.
    """
    if isinstance(view, Pinhole) or view.focus_distance is None:
        return 1 / view.focal_length
    return image_vergence(view.focus_distance, view.focal_length)


def focus_vergence(view: ThinLens) -> Scalar:
    """Return the reciprocal of the distance in focus, 1 / z_f.

    Args:
        view: the lens.

    Returns:
        () m^-1; 0 at infinity.

    Example:
        >>> at = {"resolution": (2, 2), "f_number": 2.0, "focus_distance": 2.0}
        >>> lens = jv.ThinLens([0, 0, 0], np.eye(3), 0.05, 1e-5, **at)
        >>> print(jv.optics.focus_vergence(lens))
        0.5
    """
    if view.focus_distance is None:
        return jnp.zeros_like(view.focal_length)
    return 1 / view.focus_distance


@takes_numbers
def chief_slope(view: Pinhole | ThinLens, row: Scalar, column: Scalar) -> tuple[Scalar, Scalar]:
    """Return the slope of the ray from a pixel's centre through the middle of the pinhole or lens.

    Args:
        view: the camera's projection.
        row: () pixels, may be fractional.
        column: () pixels, may be fractional.

    Returns:
        (right, down), each () m per m forward.

    Example:
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 0.1, resolution=(4, 4))
        >>> print(*(f"{x:.2f}" for x in jv.optics.chief_slope(view, 0, 3)))
        0.15 -0.15
    """
    x, y = pixel_offset(view, row, column)
    vergence = sensor_vergence(view)
    if view.distortion is None:
        return x * vergence, y * vergence
    return undistort(view.distortion, x * vergence, y * vergence)


@takes_numbers
def camera_ray(view: View, row: Scalar, column: Scalar) -> Ray:
    """Return the ray from the scene that reaches a pixel's centre through the middle of the lens.

    Args:
        view: the camera's projection.
        row: () pixels, may be fractional.
        column: () pixels, may be fractional.

    Returns:
        The ray in the world: origin in m, direction of unit length.

    Example:
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(1, 7501))
        >>> ray = jv.camera_ray(view, jnp.array(0.0), jnp.array(7500.0))  # 0.0375 m to the right
        >>> [round(float(x), 4) for x in jv.as_array(ray.direction)]
        [0.6, 0.0, 0.8]
    """
    right, down, forward = (as_vec(axis) for axis in view.rotation)
    if isinstance(view, Orthographic):
        x, y = pixel_offset(view, row, column)
        return Ray(view.position + x * right + y * down, forward)
    x, y = chief_slope(view, row, column)
    return Ray(view.position, normalize(x * right + y * down + forward))


class Projection(NamedTuple):
    """The image position of a point of the world.

    Attributes:
        row: () pixels, fractional; whole at the centre of a pixel.
        column: () pixels, fractional; whole at the centre of a pixel.
        depth: () m along the optical axis, from the camera; <= 0 behind it.
    """

    row: Scalar
    column: Scalar
    depth: Scalar


@takes_numbers
def project(view: View, point: Float[Array, "3"]) -> Projection:
    """Return the pixel at which a point of the world is imaged: the inverse of `camera_ray`.

    The function ignores occlusion, and the position may lie outside the picture.

    Args:
        view: the camera's projection.
        point: (3,) m, in the world.

    Returns:
        Row and column in pixels, depth in m. Behind a pinhole or lens row and column are NaN.

    Example:
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(480, 640))
        >>> [round(float(x), 3) for x in jv.project(view, jnp.array([0.1, 0.0, 2.0]))]
        [239.5, 569.5, 2.0]
    """
    check_kind("project: view", view, View)
    x, y, depth = view.rotation @ (point - view.position)
    if not isinstance(view, Orthographic):
        seen = depth > 0
        x, y = (divide(a, depth, seen, jnp.nan) for a in (x, y))
        if view.distortion is not None:
            x, y = distort(view.distortion, x, y)
        x, y = (a / sensor_vergence(view) for a in (x, y))
    rows, columns = view.resolution
    row, column = y / view.pixel_pitch + (rows - 1) / 2, x / view.pixel_pitch + (columns - 1) / 2
    return Projection(row, column, depth)


@takes_numbers
def lens_ray(view: ThinLens, row: Scalar, column: Scalar, u: Float[Array, "2"]) -> Ray:
    """Return the ray from the scene that reaches a pixel's centre through one point of the
    aperture.

    For uniformly distributed `u`, each ray stands for an equal area of the aperture. The mean of
    the radiance along these rays is the argument of `pixel_irradiance`. Vignetting by a rim is
    applied to that irradiance, not to the rays. A blurred point far off the axis therefore has the
    right brightness, but the full shape of the aperture instead of a cat's eye.

    Args:
        view: the lens.
        row: () pixels, may be fractional.
        column: () pixels, may be fractional.
        u: (2,) in the unit square, selects the point of the aperture.

    Returns:
        The ray in the world: origin in m, direction of unit length.

    Example:
        Two rays of one pixel meet in the plane in focus.

        >>> view = dict(rotation=np.eye(3), focal_length=0.05, pixel_pitch=1e-5, resolution=(1, 1))
        >>> lens = jv.ThinLens([0, 0, 0], **view, f_number=2.0, focus_distance=3.0)
        >>> zero, u = jnp.array(0.0), jnp.array([[1.0, 0.5], [0.5, 0.2]])
        >>> rays = [jv.lens_ray(lens, zero, zero, one) for one in u]
        >>> [round(float(ray.origin.x + 3 * ray.direction.x / ray.direction.z), 4) for ray in rays]
        [0.0, 0.0]
    """
    right, down, forward = (as_vec(axis) for axis in view.rotation)
    radius = view.focal_length / view.f_number / 2
    a, b = (radius * part for part in aperture_point(view.aperture, u))
    x, y = chief_slope(view, row, column)
    focus = focus_vergence(view)
    origin = view.position + a * right + b * down
    return Ray(origin, normalize((x - a * focus) * right + (y - b * focus) * down + forward))


@takes_numbers
def view_ray(view: View, row: Scalar, column: Scalar, *, u: Float[Array, "2"] | None = None) -> Ray:
    """Return the ray of a pixel for any view: `lens_ray` for a thin lens with a given `u`, else
    `camera_ray`.

    Args:
        view: the camera's projection.
        row: () pixels, may be fractional.
        column: () pixels, may be fractional.
        u: (2,) in the unit square, selects the point of the aperture; None for its middle.

    Returns:
        The ray in the world: origin in m, direction of unit length.

    Example:
        >>> view = jv.Orthographic([0, 0, 9], np.eye(3), 0.5, resolution=(3, 3))
        >>> ray = jv.view_ray(view, jnp.array(1.0), jnp.array(2.0))
        >>> jv.as_array(ray.origin).tolist(), jv.as_array(ray.direction).tolist()
        ([0.5, 0.0, 9.0], [0.0, 0.0, 1.0])
    """
    if u is not None and isinstance(view, ThinLens):
        return lens_ray(view, row, column, u)
    return camera_ray(view, row, column)


@takes_numbers
def cos_to_axis(view: View, row: Scalar, column: Scalar) -> Scalar:
    """Return the cosine between a pixel's chief ray and the optical axis.

    Args:
        view: the camera's projection.
        row: () pixels, may be fractional.
        column: () pixels, may be fractional.

    Returns:
        () in (0, 1], no unit.

    Example:
        >>> view = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 1.0, resolution=(1, 3))
        >>> print(f"{jv.optics.cos_to_axis(view, 0, 2):.4f}")  # 45 degrees off
        0.7071
    """
    if isinstance(view, Orthographic):
        return jnp.ones_like(view.pixel_pitch)
    x, y = chief_slope(view, row, column)
    return 1 / norm(Vec(x, y, jnp.ones_like(x)))
