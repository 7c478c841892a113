"""One sensor for a camera of several amplifier taps or mosaic sites, from a separate calibration of
each.

The vector o_i contains the properties of tap i alone: gain, black level, efficiency, read noise and
PRNU. The vector s contains the properties that all taps share: dark current, light offset, response
curve, brighter-fatter effect and mixing. The separate calibration of tap i gives the estimates o_i
and s_i, where s_i has the covariance S_i. Together they give

    s = (sum S_i^-1)^-1 sum S_i^-1 s_i          o_i' = o_i + C_i S_i^-1 (s - s_i)

where C_i is the covariance of o_i with s_i, and o_i' is the updated o_i. The updated values s and
o_i' are those of the Gaussian posterior of all taps, conditional on a common s. Because the
equations are linear, they also convert draws of the separate posteriors to draws of the joint
posterior.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import chdtrc

from jaxvision import HeavyTailedReadNoise, Sensor, Taps, bayer
from jaxvision.errors import InputError
from jaxvision.files.cameras import write_sensor

from ..inference.compiled import compiled_briefly
from ..inference.formatting import format_p
from ..inference.precision import double_precision
from ..rig import PARTS, Camera
from .calibration import NoiseCalibration, refitted
from .levels import PhotonTransfer
from .periodic import taps_in_words
from .regressions import MISFIT
from .sensor import Numbers, best_and_draws, drawn_numbers, sensors_of
from .statement import CURVE, SHARING

PHASES = {bayer(phase): phase for phase in ("RGGB", "GRBG", "GBRG", "BGGR")}
RED_FIRST = ("RGGB", "GRBG")  # patterns whose first row (with green 1) has the red pixels
OWN = ("gain", "quantum_efficiency", "read_noise", "prnu")  # individual properties of each tap
# Common properties, and the power of electrons per DN that converts each to charge.
COMMON = {
    "dark_current": ("dark currents", 0),
    "light_offset": ("offsets of the light", 0),
    "compression": ("curves of the response", 1),
    "compression_2": ("curves of the response", 2),
    "brighter_fatter": ("repulsions of charges", 1),
    "pixel_mixing": ("mixings of neighbours", 0),
}
COLOUR_SITES = ("red", "green 1", "green 2", "blue")
UNEQUAL_GREENS = 0.1  # logarithm of a ratio of the two green signals that no filters have
OWN_NAMES = ("system_gain", "black_level", "responsivity", "signal_rate", "read_noise")


@dataclass(frozen=True)
class SensorOfSites:
    """The sensor of a camera of several taps, with its draws and findings.

    Attributes:
        best: the best fit.
        draws: the sensor `best` with a leading axis of draws at every number.
        findings: sentences on quantities that should be equal for all sites but differ.
    """

    best: Sensor
    draws: Sensor
    findings: tuple[str, ...]


@double_precision
def sensor_of_sites(calibrations: Mapping[str, NoiseCalibration], camera: Camera) -> SensorOfSites:
    """Combine the separate calibrations of a camera's sites to one sensor.

    Args:
        calibrations: the calibration of each site or tap, by name.
        camera: its `taps` and `pattern` define the sites.

    Returns:
        The sensor; `Sensor.taps` has the numbers of each site.

    Raises:
        InputError: where a site has no calibration, or no likelihood.

    Example:
        >>> from fitting import noise
        >>> rng, odd = np.random.default_rng(0), np.arange(40) % 2  # amplifiers of the columns
        >>> def frames(light):
        ...     e = rng.poisson(light, (2, 40, 40)) + 5 * rng.standard_normal((2, 40, 40))
        ...     return (64 + 4 * odd + (0.25 + 0.05 * odd) * e).round()
        >>> light = [1000, 2000, 4000, 6000, 8000, 9000]
        >>> camera = noise.Camera(bits=12, taps=(1, 2))
        >>> at = {"camera": camera, "dark_exposures": [0.01]}
        >>> taken = [frames(x) for x in light], [frames(0)], [0.01] * 6, light
        >>> each = {
        ...     site: noise.calibrate(noise.from_frames(*taken, **at, channel=site))
        ...     for site in camera.sites
        ... }
        >>> noise.sensor_of_sites(each, camera).best.taps.offset.round(1).tolist()
        [-2.0, 2.0]
    """
    missing = [site for site in camera.sites if site not in calibrations]
    if missing:
        raise InputError(f"{', '.join(missing)}: not calibrated, so there is no camera of all.")
    each = [calibrations[site] for site in camera.sites]
    called = [term for one in each for term in one.chosen.space]
    each = [refitted(one, tuple(t for t in (*CURVE, *SHARING) if t in called)) for one in each]
    seen = {name for one in each for name in drawn_numbers(one).beside} - {"full_well"}
    numbers = [drawn_numbers(one, asked=frozenset(seen)) for one in each]
    count = min(len(one.natural) for one in numbers)
    for i, one in enumerate(numbers):  # draws of two taps by one seed become independent
        order = 1 + np.random.default_rng(i).permutation(count - 1)
        numbers[i] = one.select_draws(np.concatenate([[0], order]))
    numbers, findings = _common_die(numbers)
    widest = int(np.argmax([float(one.top) / one.parameter("system_gain")[0] for one in numbers]))
    sensors = [sensors_of(one) for one in numbers]
    rates = None
    if not numbers[0].about.photons_known:
        rates = np.stack(
            [one.parameter("signal_rate") / one.parameter("system_gain") for one in numbers], 1
        )
    every = _join_taps(tuple(sensors), rates, widest, camera)
    return SensorOfSites(*best_and_draws(every), findings)


def joined_sensors(
    sensors: Sequence[tuple[Sensor, Sensor]], camera: Camera
) -> tuple[Sensor, Sensor]:
    """Combine sensors of all sites; shared parameters become means over the sites."""
    each = []
    for i, (best, draws) in enumerate(sensors):
        count = min(leaf.shape[0] for _, own in sensors for leaf in jax.tree.leaves(own))
        order = np.random.default_rng(i).permutation(count)
        each.append(
            jax.tree.map(lambda x, own, at=order: np.concatenate([x[None], own[at]]), best, draws)
        )
    for name in vars(each[0]):
        there = [value for one in each if (value := getattr(one, name)) is not None]
        if not there or (len(there) == len(each) and name in (*OWN, "offset")):
            continue
        mean = jax.tree.map(lambda *values: np.mean(values, axis=0), *there)
        each = [
            eqx.tree_at(
                lambda x, name=name: getattr(x, name), one, mean, is_leaf=lambda x: x is None
            )
            for one in each
        ]
    return best_and_draws(_join_taps(tuple(each), None, 0, camera))


@double_precision
def write_sensor_of_sites(
    calibrations: Mapping[str, NoiseCalibration], camera: Camera, path: Path
) -> None:
    """Write one sensor for all sites to a file, and its posterior draws to a second file."""
    found = sensor_of_sites(calibrations, camera)
    about = f"Fitted by photon transfer; taps are {', '.join(camera.sites)}; light is photons per "
    write_sensor(found.best, path, draws=found.draws, about=about + "pixel and second.")


def camera_of_taps(taps: Taps) -> Camera | None:
    """Return the `Camera` whose `pattern` and `taps` state the taps of a sensor as in a rig, with
    the names of the taps in reading order as its `sites`. Return None if no rig can state these
    taps."""
    tile = np.asarray(taps.pattern)
    known: dict[str, Any] = {} if taps.names else {"taps": tile.shape}
    if taps.names is not None:
        names = np.asarray(taps.names)[tile]
        phase = "".join(name[:1].upper() for name in names[:2, :2].ravel())
        ends = [re.findall(r"tap (\d+),(\d+)$", name) for name in names.ravel()]
        known = {"pattern": phase if phase in PHASES.values() else None}
        if all(ends):
            last = np.array([end[0] for end in ends], int).max(axis=0)
            known["taps"] = tuple((last + 1).tolist())
    if taps.stretched:
        parts = tuple(np.floor_divide(tile.shape, taps.cell))
        known["taps"] = next((part for part in PARTS if PARTS[part] == parts), None)
    elif taps.names is None and taps.pattern in PHASES:
        known = {"pattern": PHASES[taps.pattern]}
    try:
        camera = Camera(bits=16, **known)
    except ValueError:
        return None
    named = taps.names is None or camera.sites == tuple(taps.names[i] for i in tile.ravel())
    return camera if named and camera.layout == tile.shape else None


def stated_in_words(camera: Camera) -> str:
    """Write the pattern and taps of a camera as in a rig file."""
    keys = [f'camera.pattern = "{camera.pattern}"'] if camera.pattern else []
    keys += [f"camera.taps = {taps_in_words(camera.taps)}"] if camera.taps else []
    return " and ".join(keys)


def tap_of(taps: Taps, site: str, pattern: str | None) -> int | None:
    """Return the index of the tap that reads a mosaic site of some frames. This tap has the name of
    the site or, in a mosaic of another phase, the colour of the site. The two green sites are
    distinguished by the red or blue pixels of their row. Return None if the names do not determine
    the tap."""
    camera = camera_of_taps(taps)
    if camera is None or (camera.pattern is None) != (pattern is None):
        return None
    if pattern != camera.pattern and len(camera.sites) > len(pattern or ""):
        return None  # the amplifier of a pixel depends on its position
    if (pattern in RED_FIRST) != (camera.pattern in RED_FIRST):
        site = {"green 1": "green 2", "green 2": "green 1"}.get(site, site)
    if site not in camera.sites:
        return None
    return int(np.ravel(taps.pattern)[camera.sites.index(site)])


def tap_sensor(sensor: Sensor, tap: int) -> Sensor:
    """Return the sensor of one tap; without efficiency its light is in the tap's electrons."""
    taps = sensor.taps
    if taps is None:
        return sensor
    found: dict[str, Any] = {}
    for name in OWN:
        factors, own = getattr(taps, name), getattr(sensor, name)
        if factors is None or (own is None and name != "gain"):
            continue
        factor = factors[tap]
        if isinstance(own, HeavyTailedReadNoise):
            found[name] = replace(own, rms=factor * own.rms, tail_rms=factor * own.tail_rms)
        else:
            found[name] = factor * (1.0 if own is None else own)
    if taps.offset is not None:
        found["offset"] = taps.offset[tap] + (0.0 if sensor.offset is None else sensor.offset)
    return replace(sensor, taps=None, **found)


def _common_die(each: Sequence[Numbers]) -> tuple[list[Numbers], tuple[str, ...]]:
    """Condition all taps on common shared properties; also return what differs."""
    labels = set.intersection(*(set(one.about.labels) for one in each))
    shared = [
        name
        for name in COMMON
        if name in labels and all(one.parameter(name)[1:].std() for one in each)
    ]
    own = [name for name in OWN_NAMES if name in labels]
    tables = [np.stack([_to_common_unit(one, name) for name in (*own, *shared)], 1) for one in each]
    sentences: tuple[str, ...] = ()
    if shared:
        count = len(own)
        spreads = [np.cov(table[1:], rowvar=False) for table in tables]
        weights = [_inverse(one[count:, count:]) for one in spreads]
        total = sum(w @ table[:, count:].T for w, table in zip(weights, tables, strict=True))
        together = _inverse(np.sum(weights, axis=0)) @ total
        moved = []
        for table, spread, weight in zip(tables, spreads, weights, strict=True):
            change = spread[:count, count:] @ weight @ (together - table[:, count:].T)
            moved.append(np.concatenate([table[:, :count] + change.T, together.T], axis=1))
        sentences = _unequal(
            shared, [x[0, count:] for x in tables], [s[count:, count:] for s in spreads]
        )
        tables = moved
    shape = {
        name: None
        if (x := [getattr(one.about, name) for one in each])[0] is None
        else np.mean(x, 0)
        for name in ("kernel", "shares")
    }
    found = []
    for one, table in zip(each, tables, strict=True):
        labels, natural = one.about.labels, one.natural.copy()
        for name, column in zip((*own, *shared), table.T, strict=True):
            natural[:, labels.index(name)] = column
        one = replace(one, about=replace(one.about, **shape), natural=natural)
        for name in shared:
            per_charge = (one.top / one.parameter("system_gain")) ** COMMON[name][1]
            natural[:, labels.index(name)] = one.parameter(name) * per_charge
        found.append(one)
    return _average_other_parameters(found), sentences


def _inverse(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "n n"]:
    """Invert a covariance of mixed units; parameters of zero variance get zeros."""
    scale = np.sqrt(np.diagonal(matrix))
    scale = np.outer(scale, scale)
    scale[scale == 0] = np.inf
    return np.linalg.pinv(matrix / scale) / scale


def _to_common_unit(numbers: Numbers, name: str) -> Float[np.ndarray, " draws"]:
    """Return a parameter in a unit that is common to all taps. A parameter whose effect grows with
    the charge is given per electron."""
    per_charge = (numbers.parameter("system_gain") / numbers.top) ** COMMON.get(name, ("", 0))[1]
    return numbers.parameter(name) * per_charge


def _unequal(
    shared: Sequence[str], values: Sequence[np.ndarray], spreads: Sequence[np.ndarray]
) -> tuple[str, ...]:
    """Return findings on shared parameters that differ significantly between taps."""
    differing = {}
    for i, name in enumerate(shared):
        of, variance = (np.array([x[i] for x in values]), np.array([s[i, i] for s in spreads]))
        if not variance.all():
            continue
        mean = np.average(of, weights=1 / variance)
        p_value = float(chdtrc(len(of) - 1, np.sum((of - mean) ** 2 / variance)))
        if p_value < MISFIT:
            differing[COMMON[name][0]] = p_value
    return tuple(
        f"The {what} of the taps differ by more than their errors ({format_p(p_value)}), but the "
        "sensor of all has one; calibrate each by --channel for a separate camera file."
        for what, p_value in differing.items()
    )


def _average_other_parameters(each: Sequence[Numbers]) -> list[Numbers]:
    """Replace shared noise, DSNU and full well of taps by their means, e-."""
    gains = [one.parameter("system_gain") for one in each]
    for name in {name for one in each for name in one.beside} - {"prnu"}:
        power = {"full_well": 1, "column_prnu": 0}.get(name, 2)
        there = [
            one.beside[name] / gain**power
            for one, gain in zip(each, gains, strict=True)
            if name in one.beside
        ]
        mean = np.mean(there, axis=0)
        for one, gain in zip(each, gains, strict=True):
            one.beside[name] = mean * gain**power
    return list(each)


@compiled_briefly
def _join_taps(
    sensors: tuple[Sensor, ...],
    rates: np.ndarray | None,
    widest: int,
    camera: Camera,
) -> Sensor:
    """Make each draw's sensor with taps; `rates` of the signal replace efficiencies."""

    def join_sensor(each: tuple[Sensor, ...], rate: Array | None) -> Sensor:
        own = {}
        for name in OWN:
            values = [getattr(sensor, name) for sensor in each]
            if values[0] is not None:
                own[name] = jnp.stack(values)
        if rate is not None:
            own["quantum_efficiency"] = rate
        means = {name: jnp.mean(values) for name, values in own.items()}
        safe = {name: jnp.where(mean > 0, mean, 1.0) for name, mean in means.items()}
        offsets = jnp.stack([jnp.asarray(sensor.offset) for sensor in each])
        taps = Taps(
            tuple(map(tuple, np.arange(len(each)).reshape(camera.layout).tolist())),
            offset=offsets - jnp.mean(offsets),
            stretched=camera.has_tap_regions,
            cell=camera.cell if camera.has_tap_regions else (1, 1),
            names=camera.sites,
            **{name: values / safe[name] for name, values in own.items()},
        )
        if rate is not None:
            del means["quantum_efficiency"]
        return replace(each[widest], taps=taps, offset=jnp.mean(offsets), **means)

    return eqx.filter_vmap(join_sensor)(sensors, rates)


def unequal_greens(measurements: Mapping[str, PhotonTransfer]) -> tuple[str, ...]:
    """Return a sentence if the signals of mosaic sites show another phase."""
    signals = {}
    for site in COLOUR_SITES:
        if (own := measurements.get(site)) is None:
            return ()
        dark = np.asarray(own.dark.mean)[np.asarray(own.dark_of)]
        light = np.asarray(own.bright.light)
        per_light = ((np.asarray(own.bright.mean) - dark)[light > 0]) / light[light > 0]
        if not per_light.size:
            return ()
        signals[site] = max(float(np.median(per_light)), np.finfo(float).tiny)
    red, first, second, blue = (signals[site] for site in COLOUR_SITES)
    apart, others = abs(np.log(second / first)), abs(np.log(blue / red))
    if apart < UNEQUAL_GREENS or others > apart / 4:
        return ()
    return (
        f"The green 2 sites have {second / first:.2f} times the signal of the green 1 sites, and "
        f"the blue sites {blue / red:.2f} times that of the red sites, as if these were the green "
        "ones: the frames are mirrored, rotated or cropped, or the mosaic has another phase than "
        "camera.pattern says. The names of all sites are then wrong.",
    )
