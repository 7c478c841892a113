"""Exposure stacks simulated by NumPy, SciPy and Pillow: Poisson electrons, read noise, clipping, a
response curve and rounding, and photographs with typical faults."""

import io
from collections.abc import Callable

import numpy as np
from PIL import Image
from scipy import ndimage

Response = Callable[[np.ndarray], np.ndarray]


def srgb(x: np.ndarray) -> np.ndarray:
    """Return the sRGB encoding of linear values in 0..1."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def s_shaped(x: np.ndarray) -> np.ndarray:
    """Return a film-like curve: gamma 2.2 with a soft toe and shoulder."""
    u = x ** (1 / 2.2)
    return 0.4 * (3 * u**2 - 2 * u**3) + 0.6 * u


def gamma(exponent: float) -> Response:
    """Return x^(1 / exponent)."""
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
    """Return (irradiances (pixels,), codes uint16 (exposures, pixels)) of a log-uniform scene. Unit
    exposure fills the well."""
    irradiance = np.exp(rng.uniform(np.log(0.004), np.log(3), pixels))
    frames = []
    for t in times * np.exp(rng.normal(0, shutter_error, len(times))):
        electrons = rng.poisson(irradiance * t * full_well) + rng.normal(0, read_noise, pixels)
        exposed = response(np.clip(electrons / full_well, 0, 1))
        frames.append(np.round(pedestal + (2**bits - 1 - pedestal) * exposed))
    return irradiance, np.stack(frames).astype(np.uint16)


def log_exposures(response: Response, codes: np.ndarray, *, bits: int = 8) -> np.ndarray:
    """Return the true ln exposure of codes, by inverting the response on a fine grid."""
    x = np.concatenate([np.geomspace(1e-9, 1e-3, 100_001), np.linspace(1e-3, 1, 200_001)[1:]])
    return np.log(np.interp(codes / (2**bits - 1), response(x), x))


def jpeg_stack(
    response: Response,
    times: np.ndarray,
    rng: np.random.Generator,
    *,
    shape: tuple[int, int] = (120, 160),
    quality: int = 90,
    shift: float = 0.5,
    shutter_error: float = 0.01,
    leaves: int = 6,
    full_well: float = 20_000.0,
    read_noise: float = 4.0,
) -> np.ndarray:
    """Return codes, uint16 (exposures, h, w), of one scene in hand-held JPEG photographs. Each is
    shifted by up to `shift` pixels, and has its own shutter error and moving leaves."""
    (h, w), rim = shape, 8
    scene = _scene(rng, h + 2 * rim, w + 2 * rim)
    corners = rng.integers(0, [h - 20, w - 20], (leaves, 2)) + rim
    frames = []
    for t in times * np.exp(rng.normal(0, shutter_error, len(times))):
        moved = scene.copy()
        for row, column in corners:
            leaf = slice(row, row + 20), slice(column, column + 20)
            moved[leaf] = np.roll(scene, rng.integers(-4, 5, 2), (0, 1))[leaf]
        placed = ndimage.shift(moved, rng.uniform(-shift, shift, 2), order=3, mode="nearest")
        light = np.clip(placed[rim:-rim, rim:-rim] * t, 0, 50)
        electrons = rng.poisson(light * full_well) + rng.normal(0, read_noise, shape)
        exposed = response(np.clip(electrons / full_well, 0, 1))
        file = io.BytesIO()
        Image.fromarray(np.round(255 * exposed).astype(np.uint8)).save(
            file, "JPEG", quality=quality
        )
        frames.append(np.asarray(Image.open(file)))
    return np.stack(frames).astype(np.uint16)


def processed_stack(
    response: Response,
    times: np.ndarray,
    rng: np.random.Generator,
    *,
    shape: tuple[int, int] = (120, 160),
    blurred: float = 0.0,
    sharpened: float = 0.0,
    full_well: float = 20_000.0,
    read_noise: float = 4.0,
) -> np.ndarray:
    """Return codes, uint16 (exposures, h, w), of one scene from a camera that blurs after clipping,
    by a Gaussian of this many pixels, and sharpens the result, by this share of the difference to a
    Gaussian of one pixel."""
    scene, frames = _scene(rng, *shape), []
    for t in times:
        electrons = rng.poisson(np.clip(scene * t, 0, 50) * full_well)
        electrons = electrons + rng.normal(0, read_noise, shape)
        exposed = ndimage.gaussian_filter(np.clip(electrons / full_well, 0, 1), blurred)
        written = response(exposed)
        written += sharpened * (written - ndimage.gaussian_filter(written, 1.0))
        frames.append(np.round(255 * np.clip(written, 0, 1)))
    return np.stack(frames).astype(np.uint16)


def _scene(rng: np.random.Generator, h: int, w: int) -> np.ndarray:
    """Return the light of a scene over about three decades: texture with a 1 / f spectrum and 20
    rectangles, blurred as by a lens."""
    frequency = np.hypot(np.fft.fftfreq(h)[:, None], np.fft.fftfreq(w))
    frequency[0, 0] = 1
    log_light = np.fft.ifft2(np.fft.fft2(rng.normal(size=(h, w))) / frequency**1.1).real
    log_light /= log_light.std()
    for _ in range(20):
        row, column = rng.integers(0, h), rng.integers(0, w)
        part = slice(row, row + h // 5), slice(column, column + w // 5)
        log_light[part] = 0.6 * log_light[part] + rng.normal()
    log_light = 1.4 * (log_light - np.median(log_light)) / log_light.std()
    return ndimage.gaussian_filter(0.2 * np.exp(log_light), 0.7)
