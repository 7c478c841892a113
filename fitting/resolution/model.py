"""The model of a blurred edge: square pixel aperture, Gaussian or disc, and diffraction."""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.scipy.stats import norm
from jaxtyping import Array, Float

import jaxvision as jv

from ..inference.likelihoods import Clustered, Gaussian
from ..inference.parameters import Parameter
from ..inference.problem import Problem
from .pixels import EdgePixels, distance_from_edge

_NARROWEST = 1e-3  # pixels, smallest width in a denominator
_TINY = 1e-30
_NODES = 32
_ANGLES = np.pi * np.arange(1, _NODES + 1) / (_NODES + 1)
# A uniform disc of diameter 2 across a line: Gauss and Chebyshev's rule of the second kind.
_DISC = np.cos(_ANGLES), 2 / (_NODES + 1) * np.sin(_ANGLES) ** 2


class Blur(NamedTuple):
    """The blur of the edge in addition to the pixel's aperture.

    Attributes:
        shape: shape of the fitted blur, "gaussian" or "disc".
        diffraction: wavelength times f-number over the pixel pitch; None without diffraction.
    """

    shape: Literal["gaussian", "disc"]
    diffraction: float | None


def problem_of_edge(
    pixels: EdgePixels, sensor: jv.Sensor | None, blur: Blur
) -> tuple[Problem, dict[str, float]]:
    """Return the problem of fitting the model, and the start of its search."""
    low, high = pixels.level
    span = pixels.span
    black = 0.0 if sensor is None or sensor.offset is None else float(np.mean(sensor.offset))
    start = {"angle": pixels.angle, "place": pixels.place, "low": low, "high": high}
    start |= {"blur": 0.6, "curvature": 0.0, "shade_x": 0.0, "shade_y": 0.0}
    parameters = {  # the same for all pictures, so that a second fit compiles nothing
        "angle": Parameter(unit="degrees", start=0.0),
        "place": Parameter(unit="pixels", start=0.0),
        "low": Parameter(unit="DN", start=0.0),
        "high": Parameter(unit="DN", start=1.0),
        "blur": Parameter(unit="pixels", lower=0, upper=100),
        "curvature": Parameter(unit="1/pixels", lower=-0.02, upper=0.02),
        "shade_x": Parameter(unit="1/pixels", lower=-0.05, upper=0.05),
        "shade_y": Parameter(unit="1/pixels", lower=-0.05, upper=0.05),
    }

    likelihood: Any = Gaussian(sd=pixels.sd)
    if pixels.blocks is not None:
        likelihood = Clustered(likelihood, labels=pixels.blocks)
    predict = _model(blur, 8 * float(np.ceil(span / 8)))
    inputs = pixels.inputs | {"black": np.float64(black)}
    return Problem(parameters, predict, likelihood, pixels.value, inputs=inputs), start


@cache
def _model(kind: Blur, span: float) -> Callable[..., Array]:
    """Return the prediction of the edge, the same function for equal settings."""

    def predict(
        inputs: Mapping[str, Array],
        angle: Array,
        place: Array,
        low: Array,
        high: Array,
        blur: Array,
        curvature: Array,
        shade_x: Array,
        shade_y: Array,
    ) -> Array:
        distance = distance_from_edge(inputs, jnp.radians(angle), place, curvature, xp=jnp)
        at = {"angle": angle, "blur": blur}
        light = low - inputs["black"] + (high - low) * edge_spread(distance, at, kind, span)
        shade = 1 + shade_x * inputs["x"] + shade_y * inputs["y"]
        return inputs["black"] + light * shade

    return predict


def edge_spread(
    distance: Float[Array, "..."], at: Mapping[str, Any], blur: Blur, span: float
) -> Float[Array, "..."]:
    """Return the edge spread at a distance in pixels, from 0 (dark) to 1 (bright)."""
    if blur.diffraction is not None:  # odd harmonics of a square wave up to the cut-off frequency
        frequency = np.arange(1, 8 * span / blur.diffraction, 2) / (8 * span)
        height = edge_transfer(jnp.asarray(frequency), at, blur) / (4 * np.pi * span * frequency)
        return 0.5 + jnp.sin(2 * jnp.pi * jnp.multiply.outer(distance, frequency)) @ height
    wide, narrow = aperture_widths(at)
    far, near = (wide + narrow) / 2, (wide - narrow) / 2
    width = jnp.sqrt(jnp.asarray(at["blur"]) ** 2 + _NARROWEST**2)

    def ramp(x: Array) -> Array:
        """Return the double integral of the blur's edge spread."""
        if blur.shape == "gaussian":
            z = x / width
            return width**2 / 2 * ((z**2 + 1) * norm.cdf(z) + z * norm.pdf(z))
        radius = width / 2
        u = jnp.clip(x / radius, -1, 1)
        root, angle = jnp.sqrt(jnp.maximum(1 - u**2, _TINY)), jnp.arcsin(u)
        inside = (u**2 / 2 + 1 / 8) * angle + u * root * (13 / 24 + u**2 / 12)
        beyond = jnp.maximum(x - radius, 0)
        return radius**2 * (u**2 / 4 + 1 / 16 + inside / jnp.pi) + beyond * (radius + beyond / 2)

    rise = ramp(distance + far) - ramp(distance + near)
    return (rise - ramp(distance - near) + ramp(distance - far)) / (wide * narrow)


def aperture_widths(at: Mapping[str, Any]) -> tuple[Array, Array]:
    """Return the two widths, in pixels, of the trapezoid that is the line spread of a square
    pixel."""
    turn = jnp.radians(jnp.asarray(at["angle"]))
    cosine, sine = jnp.abs(jnp.cos(turn)), jnp.abs(jnp.sin(turn))
    return jnp.maximum(cosine, _NARROWEST), jnp.maximum(sine, _NARROWEST)


def edge_transfer(
    frequency: Float[Array, "..."], at: Mapping[str, Any], blur: Blur
) -> Float[Array, "..."]:
    """Return the OTF of pixel, blur and diffraction across the edge."""
    wide, narrow = aperture_widths(at)
    aperture = jnp.sinc(frequency * wide) * jnp.sinc(frequency * narrow)
    return aperture * blur_transfer(frequency, at, blur)


def blur_transfer(
    frequency: Float[Array, "..."], at: Mapping[str, Any], blur: Blur
) -> Float[Array, "..."]:
    """Return the OTF without the pixel's aperture, which is the same in all directions."""
    phase = jnp.pi * at["blur"] * frequency
    if blur.shape == "gaussian":
        found = jnp.exp(-2 * phase**2)
    else:
        nodes, weights = _DISC
        found = jnp.cos(jnp.multiply.outer(phase, nodes)) @ weights
    if blur.diffraction is None:
        return found
    wave, f_number = jnp.array(1e-6), jnp.array(1e6 * blur.diffraction)
    return found * jv.optics.diffraction_mtf(frequency, wave, f_number)
