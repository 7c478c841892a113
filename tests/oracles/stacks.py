"""Exposure stacks simulated in NumPy alone: Poisson electrons, read noise, clipping, a response
curve, rounding."""

from collections.abc import Callable

import numpy as np

Response = Callable[[np.ndarray], np.ndarray]


def srgb(x: np.ndarray) -> np.ndarray:
    """The sRGB encoding of linear values in 0..1."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def s_shaped(x: np.ndarray) -> np.ndarray:
    """A film-like curve: gamma 2.2 with a soft toe and shoulder."""
    u = x ** (1 / 2.2)
    return 0.4 * (3 * u**2 - 2 * u**3) + 0.6 * u


def gamma(exponent: float) -> Response:
    """x^(1 / exponent)."""
    return lambda x: x ** (1 / exponent)


def exposure_stack(
    response: Response,
    times: np.ndarray,
    rng: np.random.Generator,
    *,
    pixels: int = 16384,
    full_well: float = 8000.0,
    read_noise: float = 4.0,
    shutter_error: float = 0.0,
    bits: int = 8,
    pedestal: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """(irradiances (pixels,), codes uint16 (exposures, pixels)) of a log-uniform scene; unit
    exposure fills the well."""
    irradiance = np.exp(rng.uniform(np.log(0.004), np.log(3), pixels))
    frames = []
    for t in times * np.exp(rng.normal(0, shutter_error, len(times))):
        electrons = rng.poisson(irradiance * t * full_well) + rng.normal(0, read_noise, pixels)
        exposed = response(np.clip(electrons / full_well, 0, 1))
        frames.append(np.round(pedestal + (2**bits - 1 - pedestal) * exposed))
    return irradiance, np.stack(frames).astype(np.uint16)


def log_exposures(response: Response, codes: np.ndarray, *, bits: int = 8) -> np.ndarray:
    """True ln exposure of codes, by inverting the response on a fine grid."""
    x = np.concatenate([np.geomspace(1e-9, 1e-3, 100_001), np.linspace(1e-3, 1, 200_001)[1:]])
    return np.log(np.interp(codes / (2**bits - 1), response(x), x))
