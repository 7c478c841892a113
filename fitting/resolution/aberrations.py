"""Estimate the aberrations of a lens from pictures of straight edges."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

import jaxvision as jv
from jaxvision import ArrayLike
from jaxvision.core.plain_arrays import plain_array
from jaxvision.errors import InputError

from ..fits.result import Fit
from ..fits.solve import fit
from ..inference.likelihoods import Clustered, Gaussian
from ..inference.parameters import Parameter
from ..inference.precision import double_precision
from ..inference.problem import Problem
from .model import Blur, aperture_widths, problem_of_edge
from .pixels import EdgePixels, distance_from_edge, first_line, select_band

_OF_EDGE = "angle", "place", "low", "high", "curvature", "shade_x", "shade_y"
_FINE = 8  # samples of an edge spread per pixel
_PUPIL, _TO_CUTOFF = 20, 32  # nodes along and across the pupil, and in frequency up to the cut-off
_LEAST_PART = 0.03  # of the differences of a wavefront, by terms that edges determine


@double_precision
def wavefront_from_edges(
    images: Sequence[Any],
    *,
    wavelength: ArrayLike,
    f_number: float,
    pixel_pitch: float,
    terms: Sequence[int] = (4, 5, 6, 7, 8, 9, 10, 11),
    defocus: ArrayLike | None = None,
    aperture: jv.scene.Aperture | None = None,
    sensor: jv.Sensor | None = None,
    band: int | None = None,
    seed: int = 0,
) -> Fit:
    """Estimate the aberrations of a lens from pictures of straight edges at several angles.

    An edge shows the transfer function in one direction only, so several edges are fitted together.
    Geometry and levels of each edge are free. Even aberrations (defocus, astigmatism, spherical)
    with all signs reversed give the same pictures, so that pictures at two known settings of the
    focus are needed.

    Args:
        images: pictures of one edge each, as `from_edge` takes them, or regions of one picture in
            which the aberrations are equal.
        wavelength: () or (lines,) m; several lines of equal strength for light of a wide band.
        f_number: working f-number.
        pixel_pitch: m. The pixel is assumed to collect light on its whole square.
        terms: numbers of the Zernike terms to estimate, 4 and higher (`jv.optics.zernike`). A tilt
            (2 or 3) only moves the edges.
        defocus: (images,) known coefficient of term 4 that the setting of the focus adds to each
            picture, m; None for 0.
        aperture: shape of the pupil, convex; None for a disc.
        sensor: as in `from_edge`.
        band: as in `from_edge`.
        seed: seed of the searches.

    Returns:
        The fit. Its parameters "z4", "z5", ... are coefficients in nm; x of the pupil is to the
        right in the picture and y down. The model is valid for errors up to a quarter of a wave
        (rms). "edge" has seven numbers for each picture: the changes of angle, place, levels,
        curvature and shading, in standard errors of its own fit.

    Raises:
        InputError: for pictures that `from_edge` refuses, for terms that directions and focus of
            the edges do not determine, and for wrong terms or numbers.

    Example:
        See the page "Measure the aberrations of a lens".
    """
    lines = np.atleast_1d(np.asarray(plain_array("wavelength", wavelength), float))
    added = np.zeros(len(images))
    if defocus is not None:
        added = np.asarray(plain_array("defocus", defocus), float)
    terms = tuple(terms)
    if not terms or min(terms) < 4 or len(set(terms)) < len(terms):
        raise InputError(f"wavefront_from_edges: terms are {terms}; give different ones from 4 on.")
    if added.shape != (len(images),):
        raise InputError(
            f"wavefront_from_edges: defocus has the shape {added.shape}; give one number for each "
            f"of {len(images)} images."
        )
    if not (lines > 0).all() or lines.ndim != 1 or not f_number > 0 or not pixel_pitch > 0:
        raise InputError(
            "wavefront_from_edges: give wavelengths, f_number and pixel_pitch above 0."
        )
    black = 0.0 if sensor is None or sensor.offset is None else float(np.mean(sensor.offset))
    edges, starts = [], []
    for image in images:
        picture = select_band(plain_array("wavefront_from_edges: image", image), sensor, band)
        pixels = EdgePixels(picture, *first_line(picture))
        problem, start = problem_of_edge(pixels, sensor, Blur("gaussian", None))
        found = fit(problem, start=start, misfit="inflate")
        edges.append(pixels)
        starts.append({e.name: (e.value, e.standard_error) for e in found.estimates})
    own = np.array([[at[name] for name in _OF_EDGE] for at in starts])
    _refuse_undetermined(terms, own[:, 0, 0], len(set(added)) == 1)
    longest = max(len(one.value) for one in edges)

    def padded(rows: Sequence[np.ndarray], fill: float) -> np.ndarray:
        return np.stack(
            [np.pad(row, (0, longest - len(row)), constant_values=fill) for row in rows]
        )

    inputs = {"wave": lines, "f_number": f_number, "pitch": pixel_pitch, "black": black}
    inputs |= {"own": own, "defocus": added, "aperture": aperture}
    inputs |= {name: padded([one.inputs[name] for one in edges], 0.0) for name in ("x", "y")}
    likelihood: Any = Gaussian(sd=padded([one.sd for one in edges], 1.0))
    if any(one.blocks is not None for one in edges):
        labels, first = [], 0
        for one in edges:
            block = np.arange(len(one.value)) if one.blocks is None else one.blocks
            labels.append(first + block)
            first += int(block.max()) + 1
        likelihood = Clustered(likelihood, labels=padded(labels, 0))
    span = 16 * float(np.ceil(max(one.span for one in edges) / 16 + 0.125))
    cutoff = pixel_pitch / (float(lines.min()) * f_number)
    problem = Problem(
        {f"z{term}": Parameter(start=0.0, unit="nm") for term in terms}
        | {"edge": Parameter(shape=own.shape[:2], start=np.zeros(own.shape[:2]))},
        _aberrated_edges(terms, span, cutoff),
        likelihood,
        padded([one.value for one in edges], np.nan),
        inputs=jax.tree.map(np.float64, inputs),
    )
    return fit(problem, starts=2, misfit="inflate", seed=seed)  # about 0, with different signs


def _refuse_undetermined(terms: tuple[int, ...], angles: np.ndarray, one_focus: bool) -> None:
    """Refuse terms that edges with these normals, in degrees, do not determine. The transfer
    depends on differences of the wavefront error along the normal only."""
    even = [term for term in terms if (int(np.sqrt(8 * term - 7)) - 1) // 2 % 2 == 0]
    if even and one_focus:
        raise InputError(
            f"wavefront_from_edges: pictures at one setting of the focus do not determine the sign "
            f"of the terms {even}; give pictures at two known settings, with defocus."
        )
    x, y = (z[None] for z in jnp.meshgrid(*[jnp.linspace(-0.6, 0.6, 9)] * 2))
    right, down = (0.3 * f(np.radians(angles))[:, None, None] for f in (np.cos, np.sin))
    ends = [jv.optics.zernike(x + s * right, y + s * down, count=max(terms)) for s in (-1, 1)]
    change = np.asarray(ends[1] - ends[0]).reshape(-1, max(terms))[:, np.array(terms) - 1]
    _, size, ways = np.linalg.svd(change / np.sqrt(np.mean(change**2)), full_matrices=False)
    lost = [term for term, share in zip(terms, ways[-1], strict=True) if abs(share) > 0.1]
    if size[-1] < _LEAST_PART * size[0]:
        raise InputError(
            f"wavefront_from_edges: the directions of the edges do not determine the terms {lost} "
            "separately; give edges in more directions, or fewer terms."
        )


@cache
def _aberrated_edges(terms: tuple[int, ...], span: float, cutoff: float) -> Callable[..., Array]:
    """Return the prediction of all edges as a function of coefficients and geometry, the same
    function for equal settings."""
    frequency = np.arange(1, 8 * span * cutoff, 2) / (8 * span)  # cycles per pixel
    places = np.arange(-span, span + 0.5 / _FINE, 1 / _FINE)
    phase = 2 * np.pi * np.outer(places, frequency)
    nodes, degree = np.polynomial.chebyshev.chebpts1(_TO_CUTOFF), _TO_CUTOFF - 1
    smooth, at_nodes = (
        np.polynomial.chebyshev.chebvander(x, degree) for x in (2 * frequency / cutoff - 1, nodes)
    )
    between = smooth @ np.linalg.inv(at_nodes)  # the transfer is smooth up to the cut-off

    def spread(
        nm: Array, inputs: Mapping[str, Any], defocus: Array, turn: Array
    ) -> tuple[Array, Array]:
        """Return the edge spread of a picture with its slope at distances from -span to span,
        twice."""
        error = jnp.zeros(max(terms)).at[np.array(terms) - 1].set(1e-9 * nm).at[3].add(defocus)
        across = jnp.stack([jnp.cos(turn), jnp.sin(turn)]) / inputs["pitch"]

        def otf(wave: Array) -> Array:
            at = jnp.multiply.outer((nodes + 1) * cutoff / 2, across)
            lens = error, wave, inputs["f_number"]
            return jv.optics.wavefront_otf(at, *lens, aperture=inputs["aperture"], samples=_PUPIL)

        wide, narrow = aperture_widths({"angle": jnp.degrees(turn)})
        pixel = jnp.sinc(frequency * wide) * jnp.sinc(frequency * narrow)
        real, imaginary = (between @ jax.vmap(otf)(inputs["wave"]).mean(axis=0)).T
        height = pixel / (4 * np.pi * span * frequency)
        odd, even = real * height, imaginary * height
        cycle = 2 * np.pi * frequency
        slope = np.cos(phase) @ (cycle * odd) - np.sin(phase) @ (cycle * even)
        share = 0.5 + np.sin(phase) @ odd + np.cos(phase) @ even
        table = jnp.stack([share, slope / _FINE], axis=-1)
        return table, table

    def predict(inputs: Mapping[str, Any], edge: Array, **coefficients: Array) -> Array:
        nm = jnp.stack([coefficients[f"z{term}"] for term in terms])
        here = jax.lax.stop_gradient(nm)

        def light(own: Array, changes: Array, defocus: Array, x: Array, y: Array) -> Array:
            at = dict(zip(_OF_EDGE, own[:, 0] + own[:, 1] * changes, strict=True))
            turn = jnp.radians(at["angle"])
            distance = distance_from_edge(
                {"x": x, "y": y}, turn, at["place"], at["curvature"], xp=jnp
            )
            # The pupil's direction is that of the first fit: its error has no effect on the blur.
            # Slopes by the coefficients are computed once, not for every parameter of an edge.
            fixed = inputs, defocus, jnp.radians(own[0, 0])
            slope, table = jax.jacfwd(spread, has_aux=True)(here, *fixed)
            table = table + slope @ (nm - here)
            place = jnp.clip((distance + span) * _FINE, 0, len(places) - 1.001)
            floor = jnp.floor(place)
            first = floor.astype(int)
            share = _cubic(place - floor, table[first], table[first + 1])
            level = at["low"] - inputs["black"] + (at["high"] - at["low"]) * share
            return inputs["black"] + level * (1 + at["shade_x"] * x + at["shade_y"] * y)

        each = inputs["own"], edge, inputs["defocus"], inputs["x"], inputs["y"]
        return jax.vmap(light)(*each)

    kind, named = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    asked = [inspect.Parameter(name, kind) for name in ("inputs", "edge")]
    asked += [inspect.Parameter(f"z{term}", named) for term in terms]
    predict.__signature__ = inspect.Signature(asked)
    return predict


def _cubic(x: Array, begin: Array, end: Array) -> Array:
    """Return the cubic on [0, 1] with these values and slopes, (..., 2), at both ends."""
    rise = end[..., 0] - begin[..., 0]
    bend = (1 - x) * (begin[..., 1] - rise) - x * (end[..., 1] - rise)
    return begin[..., 0] + x * (rise + (1 - x) * bend)
