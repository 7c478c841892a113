"""A sensor's predicted mean, variance and neighbour covariances in even light and in the dark, by
`jaxvision` alone, and the sampling errors of a few frames about them."""

from dataclasses import dataclass, replace
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxvision import Sensor, ShutterOffset, clipped_moments, expected_signal, signal_variance
from jaxvision.core.parallel_loops import map_
from jaxvision.sensor import neighbour_covariances

from ...inference.compiled import compiled_briefly
from ..levels import CLEAR_OF_CLIPPING, PhotonTransfer

QUANTITIES = ("mean", "variance", "along rows", "along columns")
SHORTEST = 1e-12  # s, of a flash or a bias frame
DITHERED = 0.6  # codes rms, below which rounding is not an independent error
REACHED = 6.0  # standard deviations of the pixels' offsets on either side
FINE = 0.1  # codes between two offsets, over which rounding is averaged
OFFSETS = ("dsnu", "row_dsnu", "column_dsnu")  # fields of a sensor
MOST = 1024  # most offsets; for a wider spread they are farther apart


def number_of(sensor: Sensor, field: str, *, absent: float = 0.0) -> float:
    """Return a number of a sensor, or `absent` if the sensor lacks this field."""
    value = getattr(sensor, field)
    return absent if value is None else float(value)


def rms_of(sensor: Sensor, fields: tuple[str, ...]) -> float:
    """Return the root sum of squares of the independent deviations that a sensor states."""
    return float(np.hypot.reduce([number_of(sensor, field) for field in fields]))


class Lit(eqx.Module):
    """The light and exposure of levels with and without light."""

    # (levels,) photons per pixel and exposure; electrons for a sensor without quantum efficiency
    light: Float[Array | np.ndarray, "..."]
    exposure: Float[Array | np.ndarray, "..."]  # (levels,) s
    lit: Float[Array | np.ndarray, "..."]  # (levels,) 1 with light, 0 without


@dataclass(frozen=True)
class Expected:
    """The mean, variance and neighbour covariances that one sensor predicts at each level."""

    values: Float[np.ndarray, "quantities levels"]  # predicted `QUANTITIES`, DN and DN^2
    # derivatives of `values` with respect to the logarithm of the light
    by_light: Float[np.ndarray, "quantities levels"]
    electrons: Float[np.ndarray, " levels"]  # mean charge of a pixel
    step: Float[np.ndarray, " levels"]  # DN per additional electron at the mean charge
    rows: float  # variance of the noise that the pixels of a row share, new in every frame, DN^2
    # variance of the noise that the pixels of a column share, new in every frame, DN^2
    columns: float
    frames: float  # variance of the noise that all pixels of a frame share, DN^2
    rounding: float  # variance of the rounding error, DN^2
    dark_current: float  # e-/s

    @property
    def signal(self) -> Float[np.ndarray, " levels"]:
        """Approximate signal above black, DN."""
        return self.step * self.electrons

    @property
    def share(self) -> Float[np.ndarray, " levels"]:
        """The signal of each level divided by the signal of the brightest level."""
        return self.signal / max(float(self.signal.max()), 1e-300)

    @property
    def shot(self) -> Float[np.ndarray, " levels"]:
        """Variance of shot noise, DN^2."""
        return self.step**2 * self.electrons

    @property
    def before_rounding(self) -> Float[np.ndarray, " levels"]:
        """Variance without the rounding error, DN^2."""
        return np.maximum(self.values[1] - self.rounding, 0.0)


@dataclass(frozen=True)
class Frames:
    """Statistics of the frames at each level, taken from `Levels`."""

    mean: Float[np.ndarray, " levels"]  # DN
    variance: Float[np.ndarray, " levels"]  # temporal, DN^2
    # covariances along rows and along columns, DN^2; None where they are not known
    neighbours: Float[np.ndarray, "2 levels"] | None
    frames: Float[np.ndarray, " levels"]  # number of frames
    pixels: float  # number of pixels
    shape: tuple[float, float] | None  # rows and columns; None where they are not known
    # variance of a frame's mean by noise that was subtracted, DN^2
    unsteady: Float[np.ndarray, " levels"]
    light_error: Float[np.ndarray, " levels"]  # relative error of the light of each level
    variance_error: float  # relative scatter of the variances for unknown reasons

    @property
    def measured(self) -> Float[np.ndarray, "quantities levels"]:
        """The observed `QUANTITIES`, as far as they are known, DN and DN^2."""
        around = () if self.neighbours is None else tuple(self.neighbours)
        return np.array([self.mean, self.variance, *around])


OfLevels = TypeVar("OfLevels", Lit, Expected, Frames)


def select_levels(found: OfLevels, shown: Bool[np.ndarray, " levels"]) -> OfLevels:
    """Return the record for some of the levels. The levels are the last axis of every array."""
    arrays = {k: x for k, x in vars(found).items() if isinstance(x, np.ndarray | Array)}
    return replace(found, **{name: array[..., shown] for name, array in arrays.items()})


def levels_of(
    measurement: PhotonTransfer, usable: np.ndarray, *, light_error: float, variance_error: float
) -> tuple[Lit, Frames]:
    """Return the usable bright levels and all darks as one sequence of levels."""
    bright, dark = measurement.bright, measurement.dark
    darks = dark.mean.size

    def row(name: str) -> np.ndarray:
        return np.concatenate(
            [np.asarray(getattr(bright, name))[usable], np.asarray(getattr(dark, name))]
        )

    lit = Lit(row("light"), row("exposure"), np.repeat([1.0, 0.0], [len(usable), darks]))
    unsteady, neighbours, shape = np.zeros(len(usable) + darks), None, None
    if bright.covariances is not None and dark.covariances is not None:
        covariances = row("covariances")
        neighbours = np.array([covariances[:, 0, 1], covariances[:, 1, 0]])
        if bright.flicker is not None:
            neighbours[:, : len(usable)] -= np.asarray(bright.flicker)[:, usable]
    if bright.unsteady is not None:
        unsteady[: len(usable)] = np.asarray(bright.unsteady)[usable]
    if bright.shared is not None:
        rows, columns = (float(size) for size in bright.shared.shape)
        shape = rows, columns
    light = np.asarray(lit.light)
    rounded = float(measurement.light_step) / np.sqrt(12) if measurement.photons_known else 0.0
    of_light = np.divide(rounded, light, out=np.zeros_like(light), where=light > 0)
    return lit, Frames(
        mean=row("mean"),
        variance=row("variance"),
        neighbours=neighbours,
        frames=row("frames"),
        pixels=float(bright.pixels),
        shape=shape,
        unsteady=unsteady,
        light_error=np.hypot(light_error, of_light),
        variance_error=variance_error,
    )


@compiled_briefly
def expected(
    sensors: Sensor, lit: Lit, *, neighbours: bool
) -> Float[Array, "draws quantities levels"]:
    """Predict the quantities in codes for several sensors, without clipping."""

    def predict(sensor: Sensor) -> Array:
        one = jax.vmap(lambda at: _quantities(sensor, at, neighbours=neighbours), out_axes=1)
        return one(lit)

    return eqx.filter_vmap(predict)(sensors)


def _quantities(sensor: Sensor, at: Lit, *, neighbours: bool) -> Array:
    sensor, light = _level_sensor(sensor, at)
    found = [expected_signal(sensor, light)]
    if not neighbours:
        found.append(signal_variance(sensor, light))
        return jnp.stack([one.reshape(()) for one in found])
    around = neighbour_covariances(sensor, light, reach=1)
    around = around.reshape(2, 2)
    return jnp.stack([found[0].reshape(()), around[0, 0], around[0, 1], around[1, 0]])


def _level_sensor(sensor: Sensor, at: Lit) -> tuple[Sensor, Array]:
    """Return the sensor at ONE level's exposure without frame noise, and its light per s."""
    time = jnp.maximum(at.exposure, SHORTEST)
    offset = sensor.light_offset
    if offset is not None and not isinstance(offset, ShutterOffset):
        offset = at.lit * offset  # light through the shutter does not affect darks
    sensor = replace(sensor, exposure_time=time, frame_noise=None, light_offset=offset)
    return sensor, jnp.full((1, 1, 1), at.light / time)


@compiled_briefly
def charge_and_step(sensor: Sensor, lit: Lit) -> tuple[Array, Array, Array]:
    """Return electrons, codes per electron, and code per logarithm of light, by level."""

    def level_slopes(at: Lit) -> tuple[Array, Array, Array]:
        def codes_and_charge(more: Array) -> tuple[Array, Array]:
            own, light = _level_sensor(sensor, replace(at, light=at.light + more))
            plain = replace(own, gain=None, offset=None, nonlinearity=None, bits=None)
            return jnp.sum(expected_signal(own, light)), jnp.sum(expected_signal(plain, light))

        nothing = jnp.zeros_like(at.light)
        (_, electrons), (codes, charge) = jax.jvp(
            codes_and_charge, (nothing,), (jnp.ones_like(nothing),)
        )
        return electrons, codes / charge, codes * at.light

    return jax.vmap(level_slopes)(lit)


def touched_by_ends(
    sensor: Sensor, values: np.ndarray, electrons: np.ndarray, *, lowest: float = 0.0
) -> np.ndarray:
    """Return a mask of levels that the scale's ends, full well or coarse rounding affect."""
    mean, deviation = values[0], np.sqrt(np.maximum(values[1], 0))
    near = np.zeros(mean.shape, bool)
    if sensor.bits is not None:
        near |= mean - lowest < CLEAR_OF_CLIPPING * deviation
        near |= mean + CLEAR_OF_CLIPPING * deviation > 2.0 ** float(sensor.bits) - 1
        near |= deviation < DITHERED
    if sensor.full_well is not None:
        near |= electrons + CLEAR_OF_CLIPPING * np.sqrt(electrons) > float(sensor.full_well)
    return near


def clipped(
    sensor: Sensor, lit: Lit, *, lowest: float = 0.0
) -> tuple[Float[np.ndarray, "2 levels"], Float[np.ndarray, "values values"]]:
    """Return mean and variance near the ends of the scale, averaged over the pixels' offsets, and
    the covariance between mean and variance over these offsets. The parts of a pixel's mean and
    variance that are linear or quadratic in its offset do not contribute to this covariance.
    Divided by the number of pixels, it is the sampling covariance of averages over all pixels,
    between sensors with equal mean and spread of the offsets. Codes below `lowest` are set to
    `lowest`."""
    spread = number_of(sensor, "gain", absent=1.0) * rms_of(sensor, OFFSETS)
    count = 2 ** int(np.ceil(np.log2(np.clip(2 * REACHED * spread / FINE, 1, MOST))))
    places = np.linspace(-REACHED, REACHED, count + 1) if count > 1 else np.zeros(1)
    weights = np.exp(-(places**2) / 2)
    weights /= weights.sum()
    found = np.array(_clipped_moments(sensor, lit, spread * places - lowest))
    found[:, 0] += lowest
    mean = np.tensordot(weights, found, 1)
    left = (found - mean).reshape(len(places), -1)
    root = np.sqrt(weights)[:, None]
    powers = root * places[:, None] ** np.arange(3)
    left = root * left
    left = left - powers @ (np.linalg.pinv(powers) @ left)
    return mean, left.T @ left


@compiled_briefly
def _clipped_moments(sensor: Sensor, lit: Lit, offsets: Array | np.ndarray) -> Array:
    black = 0.0 if sensor.offset is None else sensor.offset

    def moments_at(at: Lit, offset: Array) -> Array:
        own, light = _level_sensor(replace(sensor, offset=offset), at)
        return jnp.stack([moment.reshape(()) for moment in clipped_moments(own, light)], axis=-1)

    return map_(
        lambda offset: jax.vmap(lambda at: moments_at(at, black + offset), out_axes=-1)(lit),
        offsets,
    )


def noise(levels: Frames, found: Expected) -> Float[np.ndarray, "quantities levels"]:
    """Return the sampling variances of the observed quantities about their expectation.

    Args:
        levels: the levels, with their numbers of frames and pixels, and errors from level to level.
        found: expected statistics.

    Returns:
        Variances of the mean, DN^2, then of the variances, DN^4.
    """
    frames, pixels, degrees = levels.frames, levels.pixels, levels.frames - 1
    total = found.values[1]
    own = np.maximum(total - found.rows - found.columns, 0)
    lines = []
    if levels.shape is not None:
        lines = [(found.rows, *levels.shape), (found.columns, *levels.shape[::-1])]
    mean = own / pixels + found.frames + sum(line / count for line, count, _ in lines)
    mean = (mean + levels.unsteady) / frames + (levels.light_error * found.by_light[0]) ** 2
    fourth = found.step**4 * found.electrons
    variance = (2 * total**2 / degrees + fourth / frames) / pixels
    variance = variance + sum(2 * line**2 / count for line, count, _ in lines) / degrees
    variance = variance + (levels.variance_error * total) ** 2
    variance = variance + (levels.light_error * found.by_light[1]) ** 2
    variances = [mean, variance]
    if len(found.values) == len(QUANTITIES):
        for (line, count, across), (other, of_other, _) in (lines, lines[::-1]):
            pairs = pixels * (1 - 1 / across)
            shared = 2 * line * (line + 2 * own / across) / count + other**2 / of_other
            variances.append((own**2 / pairs + shared) / degrees)
    return np.array(variances)
