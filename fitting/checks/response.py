"""Simulated exposure stacks, from a tripod or hand-held, for the coverage of fits of response
curves."""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import gaussian_filter, shift
from scipy.special import ndtr, ndtri
from scipy.stats import t

from jaxvision.development import jpeg

from ..inference.estimates import QUANTILES, Estimate
from ..response.calibration import calibrate
from ..response.curve import ResponseCurve
from ..response.read import from_stack
from ..rig import Camera

SHAPE, RIM = (96, 128), 8  # pixels; width of the simulated border, for shifts
FULL_WELL, READ_NOISE = 20_000.0, 4.0  # e-
CODES = (30, 80, 190, 230)
NAMES = (*(f"ln X at code {code}" for code in CODES), "gamma")
EIGHT, THREE = tuple(2.0 ** np.arange(-4, 4)), (0.25, 1.0, 4.0)  # s
LEAF, LEAVES, FLUTTER = 16, 5, 4  # leaves: size in pixels, number, motion in pixels


@dataclass(frozen=True)
class Stack:
    """A simulated exposure stack."""

    times: tuple[float, ...] = EIGHT  # exposures, s
    # function from linear values in 0..1 to codes over full scale
    encode: Callable[[np.ndarray], np.ndarray] = lambda x: x ** (1 / 2.2)
    decode: Callable[[np.ndarray], np.ndarray] = lambda v: v**2.2  # the inverse of `encode`
    gamma: float | None = 2.2  # gamma of `encode`; None where `encode` is not a power law
    shutter_sd: float = 0.0  # relative error of each exposure
    black: float = 0.0  # black level, DN
    # error of the black level, DN, of which the fit knows the standard deviation
    black_sd: float = 0.0
    stated: bool = False  # whether the fit knows `shutter_sd`
    quality: int | None = None  # of JPEG files; None for lossless files
    # largest shift of an image along each axis by a hand-held camera, pixels. If it is not 0,
    # leaves in the scene move too.
    hand: float = 0.0


SRGB = Stack(
    encode=lambda x: np.where(
        x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055
    ),
    decode=lambda v: np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4),
    gamma=None,
)
CASES = {
    "clean": Stack(),
    "three exposures": Stack(times=THREE),
    "sRGB": SRGB,
    "shutters off by 1 %": Stack(shutter_sd=0.01),
    "three exposures off by 1 %": Stack(times=THREE, shutter_sd=0.01),
    "shutters off by 1 %, as stated": Stack(shutter_sd=0.01, stated=True),
    "three exposures off by 1 %, as stated": Stack(times=THREE, shutter_sd=0.01, stated=True),
    "black off by 1 DN, as stated": Stack(black=16.0, black_sd=1.0),
    "JPEG": Stack(quality=90),
    "hand-held JPEG": Stack(quality=90, hand=0.5, shutter_sd=0.01),
}


def places(stack: Stack, seed: int) -> np.ndarray:
    """Simulate and fit once. Return the cumulative probability of each true value."""
    images = photographs(stack, seed)
    camera = Camera(
        bits=8, black_level=stack.black, black_sd=stack.black_sd or None, saturation=255.0
    )
    stated_sd = stack.shutter_sd if stack.stated else None
    read = from_stack(list(images), stack.times, camera=camera, exposure_sd=stated_sd)
    channel, black = calibrate(read).channels[0], _black(stack, seed)
    own = [_code_probability(channel.curve, stack, code, black) for code in CODES]
    of_gamma = (
        np.nan if stack.gamma is None else _interval_deviate(channel.gamma.gamma, stack.gamma)
    )
    return np.array([*own, of_gamma])


def photographs(stack: Stack, seed: int) -> np.ndarray:
    """Simulate photographs with motion (if hand-held), Poisson electrons, read noise, clipping, the
    response, rounding and JPEG compression (if any)."""
    rng = np.random.default_rng(seed)
    scene, frames, black = _scene(rng), [], _black(stack, seed)
    corners = rng.integers(RIM, np.array(SHAPE) + RIM - LEAF, (LEAVES, 2))
    for time in stack.times * np.exp(stack.shutter_sd * rng.standard_normal(len(stack.times))):
        light = _shift_scene(scene, corners, stack.hand, rng) if stack.hand else scene
        light = np.clip(light[RIM:-RIM, RIM:-RIM] * time, 0, 50)
        electrons = rng.poisson(light * FULL_WELL) + READ_NOISE * rng.standard_normal(SHAPE)
        encoded = stack.encode(np.maximum(electrons / FULL_WELL, 0))
        codes = np.clip(np.round(black + (255 - stack.black) * encoded), 0, 255)
        if stack.quality is not None:
            picture = jpeg(jnp.asarray(codes[..., None] / 255), quality=stack.quality)
            codes = np.round(255 * np.asarray(picture)[..., 0])
        frames.append(codes)
    return np.stack(frames).astype(np.uint16)


def _shift_scene(
    scene: np.ndarray, corners: np.ndarray, hand: float, rng: np.random.Generator
) -> np.ndarray:
    moved = scene.copy()
    for row, column in corners:
        leaf = slice(row, row + LEAF), slice(column, column + LEAF)
        moved[leaf] = np.roll(scene, rng.integers(-FLUTTER, FLUTTER + 1, 2), (0, 1))[leaf]
    return shift(moved, rng.uniform(-hand, hand, 2), order=3, mode="nearest")


def _scene(rng: np.random.Generator) -> np.ndarray:
    """Return the light of a random scene over three decades: texture with a 1 / f spectrum and
    rectangles, blurred by a lens."""
    h, w = np.array(SHAPE) + 2 * RIM
    frequency = np.hypot(np.fft.fftfreq(h)[:, None], np.fft.fftfreq(w))
    frequency[0, 0] = 1
    log_light = np.fft.ifft2(np.fft.fft2(rng.standard_normal((h, w))) / frequency**1.1).real
    log_light /= log_light.std()
    for _ in range(20):
        row, column = rng.integers(0, h), rng.integers(0, w)
        part = slice(row, row + h // 5), slice(column, column + w // 5)
        log_light[part] = 0.6 * log_light[part] + rng.standard_normal()
    log_light = 1.4 * (log_light - np.median(log_light)) / log_light.std()
    return gaussian_filter(0.2 * np.exp(log_light), 0.7)


def _black(stack: Stack, seed: int) -> float:
    return stack.black + stack.black_sd * np.random.default_rng([seed, 1]).standard_normal()


def _code_probability(curve: ResponseCurve, stack: Stack, code: int, black: float) -> float:
    place = int(np.argmin(np.abs(curve.codes - code)))
    if not curve.seen[place]:
        return np.nan
    codes = (curve.codes[[place, curve.bins.middle]] - black) / (255 - stack.black)
    true, middle = np.log(stack.decode(codes))
    miss = (true - middle - curve.log_exposure[place]) / curve.standard_error[place]
    return float(t.cdf(miss, curve.freedom[place]))


def _interval_deviate(estimate: Estimate, truth: float) -> float:
    """Return the cumulative probability of the truth, interpolated between the ends of the reported
    68 % and 95 % intervals on the scale of normal deviates."""
    assert estimate.interval_68 is not None
    assert estimate.interval_95 is not None
    low68, high68 = estimate.interval_68
    low95, high95 = estimate.interval_95
    ends = np.array([low95, low68, estimate.value, high68, high95])
    z = ndtri(QUANTILES)
    inside = np.interp(truth, ends, z)
    below, above = (truth - low95) / (low68 - low95), (truth - high95) / (high95 - high68)
    outside = min(below, 0.0) * (z[1] - z[0]) + max(above, 0.0) * (z[4] - z[3])
    return float(ndtr(inside + outside))
