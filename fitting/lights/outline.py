"""Find the outline of a ball in a picture, and the normal of the ball at a pixel.

In an orthographic view the outline is a circle. Through a lens of focal length f, in pixels, it is
the image of the cone of rays that touch the ball. With c the direction of the ball's centre and r
the outline's radius, a ray q lies on the cone if the tangent of the angle between q and c is r / f.
The picture of the cone is an ellipse unless the centre is on the lens's axis. Axes are x right, y
up, z toward the camera.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.ndimage import gaussian_filter1d, map_coordinates

from jaxvision.errors import InputError

from ..fits.solve import fit
from ..inference.likelihoods import Gaussian
from ..inference.parameters import Parameter
from ..inference.problem import Problem

RAYS = 256  # from the middle of a mask to its edge
ROUNDING = 12**-0.5  # pixels, of an edge between two pixels
SMALLEST = 8.0  # pixels, of a radius
AROUND = 0.3  # of the radius: distance from a mask's edge within which a picture shows its own
ROUND = 0.05  # largest rms of a mask's edge about the outline, relative to the radius


@dataclass(frozen=True)
class Lens:
    """The projection of the camera: orthographic, or through a lens."""

    focal_length: float | None  # focal length in pixels; None for an orthographic view
    centre: tuple[float, float]  # (column, row) where the lens's axis meets the picture


@dataclass(frozen=True)
class Outline:
    """The column and row of a ball's centre and its radius in a picture, in pixels.

    Through a lens, column and row are those where the ray to the ball's centre meets the picture.
    The radius is f tan(a / 2), with f the focal length and a the angle that the ball subtends.
    """

    values: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    scatter: float  # rms of the edge, pixels
    lens: Lens


def _circle_residuals(column: Array, row: Array, radius: Array, inputs: dict[str, Array]) -> Array:
    """Return the distances, in pixels, by which edge points lie outside a circle. The parameters
    are changes of a start, in units of its radius.
    """
    x, y, r = inputs["start"] + inputs["start"][2] * jnp.stack([column, row, radius])
    return jnp.hypot(inputs["edge"][:, 0] - x, inputs["edge"][:, 1] - y) - r


def _cone_residuals(column: Array, row: Array, radius: Array, inputs: dict[str, Array]) -> Array:
    """Return the distances by which edge points lie outside a cone of rays. Columns and rows are
    relative to the lens's axis.
    """
    x, y, r = inputs["start"] + inputs["start"][2] * jnp.stack([column, row, radius])
    focal, edge = inputs["focal"], inputs["edge"]
    rays = jnp.concatenate([edge, jnp.full((len(edge), 1), focal)], axis=1)
    axis = jnp.stack([x, y, focal])
    across = jnp.linalg.norm(jnp.cross(rays, axis[None]), axis=1)
    return focal * across / (rays @ axis) - r


def outline_of(mask: Bool[np.ndarray, "h w"], lens: Lens, *, sd: float, name: str) -> Outline:
    """Return the outline of a ball from its mask. `sd`, in pixels, is the error of centre and
    radius that the scatter of the edge does not show.
    """
    if not mask.any():
        raise InputError(f"{name}: the mask is empty; it must be non-zero where the ball is.")
    if mask[[0, -1]].any() or mask[:, [0, -1]].any():
        raise InputError(
            f"{name}: the mask reaches the border of the picture, and a ball cut by the border has "
            "no whole outline; photograph all of it, or correct the mask."
        )
    row, column = (float(np.mean(at)) for at in np.nonzero(mask))
    radius = float(np.sqrt(mask.sum() / np.pi))
    if radius < SMALLEST:
        raise InputError(
            f"{name}: the mask's ball has a radius of {radius:.1f} pixels, of at least "
            f"{SMALLEST:.0f} needed; photograph it larger."
        )
    turn = 2 * np.pi * np.arange(RAYS) / RAYS
    along = np.arange(0, 1.5 * radius, 0.05)
    columns, rows = (
        middle + along * way(turn)[:, None] for middle, way in ((column, np.cos), (row, np.sin))
    )
    inside = map_coordinates(mask.astype(float), [rows, columns], order=1) > 0.5
    edge = along[inside.shape[1] - 1 - np.argmax(inside[:, ::-1], axis=1)]
    points = np.stack([column + edge * np.cos(turn), row + edge * np.sin(turn)], axis=1)
    start = np.array([column, row, radius])
    inputs: dict[str, np.ndarray] = {"edge": points, "start": start}
    if lens.focal_length is not None:
        start[:2] -= lens.centre
        inputs |= {"edge": points - lens.centre, "focal": np.array(lens.focal_length)}
    names = ("column", "row", "radius")
    problem = Problem(
        {name: Parameter(start=0.0) for name in names},  # of equal structure: compiled once
        _circle_residuals if lens.focal_length is None else _cone_residuals,
        Gaussian(sd=ROUNDING),
        np.zeros(RAYS),
        inputs=inputs,
    )
    found = fit(problem, start=dict.fromkeys(names, 0.0), misfit="inflate")
    values = start + radius * np.array([float(found.values[name]) for name in names])
    scatter = float(np.sqrt(np.mean(found.residuals**2)) * ROUNDING)
    if not scatter < ROUND * values[2]:
        raise InputError(
            f"{name}: the mask's edge is {scatter:.1f} pixels (rms) from the outline of a ball of "
            f"radius {values[2]:.0f}; give the mask of one whole ball, without its stand."
        )
    if lens.focal_length is not None:
        values[:2] += lens.centre
    covariance = radius**2 * np.asarray(found.posterior.covariance) + sd**2 * np.eye(3)
    return Outline(values, covariance, scatter, lens)


def edge_beside_mask(
    picture: Float[np.ndarray, "h w"], mask: Bool[np.ndarray, "h w"], outline: Outline
) -> Float[np.ndarray, "3"] | None:
    """Compare a ball's edge in a picture with its mask. Return the differences in column, row and
    radius, in pixels; None if the picture shows no edge round the ball."""
    seen, drawn = (_edge(one, outline.values) for one in (picture, mask.astype(float)))
    return None if seen is None or drawn is None else seen - drawn


def _edge(
    picture: Float[np.ndarray, "h w"], circle: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"] | None:
    """Find the steepest step of the light along each radius, fit a circle to these places, and
    return its change from `circle`, pixels; None if the places are not on a circle.
    """
    column, row, radius = circle
    turn = 2 * np.pi * np.arange(RAYS) / RAYS
    along = np.arange((1 - AROUND) * radius, (1 + AROUND) * radius, 0.25)
    x, y = column + np.outer(np.cos(turn), along), row + np.outer(np.sin(turn), along)
    inside = (x >= 0) & (y >= 0) & (x <= picture.shape[1] - 1) & (y <= picture.shape[0] - 1)
    light = map_coordinates(picture, [y, x], order=1, mode="nearest")
    light = gaussian_filter1d(light, 2, axis=0, mode="wrap")
    light = gaussian_filter1d(light, 4, axis=1, mode="nearest")
    steps = np.where(inside, np.abs(np.gradient(light, axis=1)), 0)
    edge = along[np.argmax(steps, axis=1)] - radius
    design = np.stack([np.cos(turn), np.sin(turn), np.ones(RAYS)], axis=1)
    near, change = np.abs(edge - np.median(edge)) < 0.15 * radius, np.zeros(3)
    for width in (0.1 * radius, 2.0, 1.0, 1.0):
        if near.sum() < RAYS / 2:
            return None
        change = np.linalg.lstsq(design[near], edge[near], rcond=None)[0]
        near = np.abs(edge - design @ change) < width
    return change if near.sum() > RAYS / 2 else None


def surface(
    values: Float[np.ndarray, "*of 3"], pixels: Float[np.ndarray, "*of 2"], lens: Lens
) -> tuple[Float[np.ndarray, "*of 3"], Float[np.ndarray, "*of 3"]]:
    """Return the unit normals of the ball and the unit directions to the camera at some pixels; NaN
    outside the ball.
    """
    column, row, radius = np.moveaxis(np.asarray(values, float), -1, 0)
    with np.errstate(invalid="ignore"):
        if lens.focal_length is None:
            x, y = (pixels[..., 0] - column) / radius, (row - pixels[..., 1]) / radius
            normal = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1)
            return normal, np.broadcast_to([0.0, 0.0, 1.0], normal.shape)
        ray = _ray(pixels[..., 0], pixels[..., 1], lens)
        away = _distance(radius, lens)[..., None] * _ray(column, row, lens)  # in radii
        along = np.sum(ray * away, axis=-1)
        nearest = along - np.sqrt(along**2 - np.sum(away**2, axis=-1) + 1)
        return nearest[..., None] * ray - away, -ray


def centre_of(values: Float[np.ndarray, "*of 3"], lens: Lens) -> Float[np.ndarray, "*of 3"]:
    """Return the position of the ball's centre in units of its radius. The position is relative to
    the lens or, in an orthographic view, to the axis.
    """
    column, row, radius = np.moveaxis(np.asarray(values, float), -1, 0)
    if lens.focal_length is not None:
        return _distance(radius, lens)[..., None] * _ray(column, row, lens)
    x, y = (column - lens.centre[0]) / radius, (lens.centre[1] - row) / radius
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def _ray(column: np.ndarray, row: np.ndarray, lens: Lens) -> np.ndarray:
    """Return the unit vector from the lens through a position in the picture."""
    assert lens.focal_length is not None
    x, y = (column - lens.centre[0]) / lens.focal_length, (lens.centre[1] - row) / lens.focal_length
    ray = np.stack([x, y, -np.ones_like(x)], axis=-1)
    return ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def _distance(radius: np.ndarray, lens: Lens) -> np.ndarray:
    """Return the distance from the lens to a ball's centre, in radii of the ball."""
    assert lens.focal_length is not None
    return np.hypot(1, lens.focal_length / radius)
