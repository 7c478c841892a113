"""Read measured reflectance as samples for a fit: pairs of directions, values, and indices of the
incidence.

Cornell files contain scattered samples, which are used without resampling and with equal weights.
The tables of MERL and RGL are sampled on a grid that follows the highlight. In this grid, the light
is at 10, 20, ... 80 degrees from the normal. Half vectors h are at 28 elevations theta_h = (pi / 2)
x^2 with x evenly spaced, and at every 15 degrees of azimuth. Viewers are up to 80 degrees from the
normal. Samples have weights by the solid angle of the viewer, d omega_o = 4 (wi.h) d omega_h, with
wi the direction toward the light. A grid that is even in the viewer's angles would miss narrow
lobes, and its errors would depend on the positions of grid points relative to the lobes. If a table
depends on the light's azimuth, four azimuths are used.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxvision import Vec, as_vec
from jaxvision.brdf import evaluate
from jaxvision.brdf.measured import BRDFSamples, sample_directions
from jaxvision.brdf.rgl import RGL
from jaxvision.errors import InputError
from jaxvision.files.measured import read_measured
from jaxvision.scene import Material

from ...inference.formatting import format_percent

NANOMETRES = 1e9
LIGHT_ELEVATIONS = np.radians(np.arange(10, 90, 10.0))
LIGHT_AZIMUTHS = np.radians([0.0, 45.0, 90.0, 135.0])  # of anisotropic materials
HALF_ELEVATIONS = 28
HALF_AZIMUTHS = 24  # azimuths in a full turn; half of them suffice for a mirror-symmetric table
LOWEST_VIEWER = np.cos(np.radians(80.0))
SAME_INCIDENCE = np.radians(1.0)  # elevations closer than this count as one incidence
FEWEST_INCIDENCES = 3  # two to fit and one to test on
FEWEST_SAMPLES = 20
FEWEST_CLIPPED = 5  # samples at the largest value from which it may be a clip level
PILED = 3  # ratio to the samples at the next largest value, which rounding cannot explain
PEAK = 1.5  # ratio to the median of the others from which there is a lobe
HORIZON = np.radians(89.5)  # elevations beyond this count as the horizon
CUT = 0.05  # share of samples with exact zeros in one band alone that is reported
SWAPPED = 10  # pairs of samples with exchanged light and viewer that show a factor
TILTED = np.radians(10.0)  # least difference of their elevations
# f_r in sr^-1 beyond any measurement: an instrument that sees 1e-6 sr, which is finer than any
# goniometer, reads at most 1e6 from a perfect mirror; the blackest coatings reflect 1e-4.
LARGEST, SMALLEST = 1e6, 1e-9


@dataclass(frozen=True)
class MeasuredBRDF:
    """Samples of the reflectance of one material.

    Attributes:
        name: name of the file.
        wi: (n,) components of the unit vector toward the light, in the local frame.
        wo: (n,) components of the unit vector toward the viewer, in the local frame.
        values: (n, bands) f_r, sr^-1.
        weights: (n,) weights of the samples; their mean is 1.
        incidence: (n,) index into `incidences`.
        incidences: angles of the light from the normal, rad.
        elevation: (n,) angle of the viewer from the normal, rad.
        azimuth: (n,) azimuth of the viewer relative to the light's, rad in [0, pi].
        bands: names of the bands.
        wavelengths: (bands,) wavelengths, nm; None for RGB.
        findings: sentences on these data for the report.
    """

    name: str
    wi: Vec
    wo: Vec
    values: Float[np.ndarray, "n bands"]
    weights: Float[np.ndarray, " n"]
    incidence: Int[np.ndarray, " n"]
    incidences: Float[np.ndarray, " incidences"]
    elevation: Float[np.ndarray, " n"]
    azimuth: Float[np.ndarray, " n"]
    bands: tuple[str, ...]
    wavelengths: Float[np.ndarray, " bands"] | None
    findings: tuple[str, ...]

    @property
    def cosine(self) -> Float[np.ndarray, " n"]:
        return np.asarray(self.wi.z)


def read_measured_brdf(path: str | os.PathLike[str]) -> MeasuredBRDF:
    """Read samples from a Cornell, RGL or MERL file.

    Args:
        path: of the file.

    Returns:
        The samples.

    Raises:
        InputError: for a file that cannot be fitted.
    """
    path = Path(path)
    measured = read_measured(path)
    findings: tuple[str, ...] = ()
    if isinstance(measured, BRDFSamples):
        samples, weights = measured, np.ones(len(measured.theta_i))
        findings += ("Samples are scattered over the viewing directions and have equal weights.",)
    else:
        anisotropic = isinstance(measured, RGL) and len(measured.phi) > 2
        samples, weights = _sample_grid(measured, anisotropic=anisotropic)
        findings += (
            "The file's table was sampled for lights from 10° to 80° in steps of 10° and for half "
            "vectors that are denser near the normal, where lobes are; samples are weighted by "
            "the solid angle of the viewer.",
        )
        if anisotropic:
            findings += (
                "The material is anisotropic but every model here is isotropic: the fit is an "
                "average over four azimuths of the light.",
            )
    return from_samples(path.stem, samples, weights=weights, findings=findings, source=str(path))


def _sample_grid(
    material: Material, *, anisotropic: bool
) -> tuple[BRDFSamples, Float[np.ndarray, " n"]]:
    """Sample a table on the grid that the module docstring describes. Return the samples, with
    weights proportional to their solid angles.
    """
    x = (np.arange(HALF_ELEVATIONS) + 0.5) / HALF_ELEVATIONS
    turn = 2 * np.pi / HALF_AZIMUTHS * np.arange(HALF_AZIMUTHS)
    azimuths = turn if anisotropic else turn[: HALF_AZIMUTHS // 2 + 1]
    lights = LIGHT_AZIMUTHS if anisotropic else np.zeros(1)
    theta_i, phi_i, x, phi_h = (
        axis.ravel() for axis in np.meshgrid(LIGHT_ELEVATIONS, lights, x, azimuths, indexing="ij")
    )
    theta_h = np.pi / 2 * x**2
    wi = _direction(theta_i, phi_i)
    h = _direction(theta_h, phi_i + phi_h)
    cosine = np.sum(wi * h, axis=-1)
    wo = 2 * cosine[:, None] * h - wi
    # Half a turn also represents the other half, except for its ends, which both halves share.
    ends = np.isclose(np.sin(phi_h), 0) & (not anisotropic)
    solid_angle = cosine * np.sin(theta_h) * x * np.where(ends, 0.5, 1.0)
    seen = (wo[:, 2] > LOWEST_VIEWER) & (cosine > 0)
    wi, wo = wi[seen], wo[seen]
    dtype = jnp.result_type(*jax.tree.leaves(material))
    pairs = (as_vec(jnp.asarray(w, dtype)) for w in (wi, wo))
    values = jax.jit(jax.vmap(evaluate, (None, 0, 0)))(material, *pairs)
    samples = BRDFSamples(
        jnp.asarray(theta_i[seen]),
        jnp.asarray(phi_i[seen]),
        jnp.asarray(np.arctan2(np.hypot(wo[:, 0], wo[:, 1]), wo[:, 2])),
        jnp.asarray(np.arctan2(wo[:, 1], wo[:, 0])),
        values,
        getattr(material, "wavelengths", None),
    )
    return samples, solid_angle[seen]


def _direction(theta: np.ndarray, phi: np.ndarray) -> Float[np.ndarray, "n 3"]:
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


def from_samples(
    name: str,
    samples: BRDFSamples,
    *,
    weights: Float[np.ndarray, " n"],
    findings: tuple[str, ...] = (),
    source: str = "samples",
) -> MeasuredBRDF:
    """Check samples and sort them by incidence. Raises `InputError` for samples that cannot be
    fitted.

    Samples with a direction in the horizon are dropped. Negative values are used as noise about
    zero. `weights` are relative weights (n,) of the samples. `source` is named in messages.
    """
    theta_i, theta_o = (np.asarray(x, np.float64) for x in (samples.theta_i, samples.theta_o))
    values = np.asarray(samples.values, np.float64)
    seen = (theta_i < HORIZON) & (theta_o < HORIZON) & np.isfinite(values).all(axis=1)
    if seen.sum() < FEWEST_SAMPLES:
        raise InputError(
            f"{source}: {int(seen.sum())} of {len(seen)} samples are finite and above the "
            f"horizon; a fit needs at least {FEWEST_SAMPLES}."
        )
    farthest = values[seen].flat[np.abs(values[seen]).argmax()]
    if abs(farthest) > LARGEST:
        raise InputError(
            f"{source}: a value of {farthest:g} is beyond {LARGEST:g} sr^-1, which no measured "
            "BRDF reaches; remove the rows that mark missing data, or convert the unit."
        )
    clipped = seen & _clipped_samples(values, samples, seen)
    if clipped.any():
        left = seen & ~clipped
        enough = left.sum() >= FEWEST_SAMPLES
        enough = enough and len(_incidences(theta_i[left])[1]) >= FEWEST_INCIDENCES
        findings += (
            f"{format_percent(clipped.sum() / seen.sum(), decimals=1)} of the samples hold exactly "
            f"the largest value, {values[seen].max():g} sr^-1: they are clipped, and "
            + (
                "were left out."
                if enough
                else "were kept because too few samples would remain, so fitted lobes are too wide."
            ),
        )
        seen = left if enough else seen
    if not values[seen].max() > 0:
        raise InputError(f"{source}: no value is positive; the file holds no reflectance.")
    if (values[seen].mean(axis=0) <= 0).any():
        raise InputError(
            f"{source}: the mean of a band is not positive, so nothing is reflected there; take "
            "another file or remove the band."
        )
    incidence, incidences = _incidences(theta_i[seen])
    if len(incidences) < FEWEST_INCIDENCES:
        raise InputError(
            f"{source}: the light stands at {len(incidences)} elevation"
            f"{'s' if len(incidences) > 1 else ''}; at least {FEWEST_INCIDENCES} are needed to fit "
            "lobes and to test them on an angle that no fit has seen."
        )
    _check_signal(source, values[seen], incidence, incidences)
    lost = len(_incidences(theta_i)[1]) - len(incidences)
    if lost:
        findings += (
            f"{lost} of {lost + len(incidences)} angles of incidence lie along the surface, "
            "where no light falls, and were left out; angles are counted from the normal.",
        )
    findings += _cut_bands(values[seen], _band_names(values.shape[1], _nanometres(samples)))
    negative = float(np.mean(values[seen] < 0))
    if negative:
        findings += (
            f"{format_percent(negative, decimals=1)} of the values are negative, noise about zero; "
            "the cosine-weighted fit "
            "takes them as they are, the cube root as zero.",
        )
    wi, wo = sample_directions(samples)
    chosen = np.flatnonzero(seen)
    weights = weights[chosen]
    turn = np.asarray(samples.phi_o - samples.phi_i, np.float64)[chosen]
    azimuth = np.abs((turn + np.pi) % (2 * np.pi) - np.pi)
    findings += _reciprocity_remark(theta_i[chosen], theta_o[chosen], azimuth, values[chosen])
    nanometres = _nanometres(samples)
    return MeasuredBRDF(
        name=name,
        wi=_select(wi, chosen),
        wo=_select(wo, chosen),
        values=values[chosen],
        weights=weights / weights.mean(),
        incidence=incidence,
        incidences=incidences,
        elevation=theta_o[chosen],
        azimuth=azimuth,
        bands=_band_names(values.shape[1], nanometres),
        wavelengths=nanometres,
        findings=findings,
    )


def _nanometres(samples: BRDFSamples) -> Float[np.ndarray, " bands"] | None:
    metres = samples.wavelengths
    return None if metres is None else np.asarray(metres, np.float64) * NANOMETRES


def _cut_bands(values: Float[np.ndarray, "n bands"], bands: tuple[str, ...]) -> tuple[str, ...]:
    """Return a remark on bands that are exactly 0 where another band is not."""
    share = np.mean((values == 0) & (values > 0).any(axis=1, keepdims=True), axis=0)
    cut, worst = int(np.sum(share > CUT)), int(np.argmax(share))
    if not cut:
        return ()
    among = f"{cut} of {len(bands)} bands are, worst " if cut > 1 else ""
    return (
        f"Exactly 0 where another band is not: {among}{bands[worst]}, in "
        f"{format_percent(share[worst])} of the samples. Values were cut at zero, or the file ends "
        "early and was filled up; fits take these zeros as measured.",
    )


def _reciprocity_remark(
    theta_i: np.ndarray, theta_o: np.ndarray, azimuth: np.ndarray, values: np.ndarray
) -> tuple[str, ...]:
    """Return a remark if the values seem to be f_r times a cosine. By Helmholtz reciprocity, f_r is
    equal for two samples whose light and viewer are exchanged. The remark is made if the ratio of
    such samples is not 1, but equals the ratio of the cosines of their viewers or of their lights.
    """
    bright = values.mean(axis=1)
    light, viewer = np.meshgrid(theta_i, theta_o, indexing="ij")
    alike = (np.abs(light - viewer) < SAME_INCIDENCE) & (
        np.abs(np.subtract.outer(azimuth, azimuth)) < SAME_INCIDENCE
    )
    one, other = np.nonzero(alike & alike.T)
    paired = (theta_o[one] - theta_i[one] > TILTED) & (bright[one] > 0) & (bright[other] > 0)
    one, other = one[paired], other[paired]
    if len(one) < SWAPPED:
        return ()
    ratio = np.log(bright[one] / bright[other])
    cosines = np.log(np.cos(theta_o[one]) / np.cos(theta_i[one]))
    for sign, whose in ((1, "viewer's"), (-1, "light's")):
        if np.median(np.abs(ratio - sign * cosines)) < np.median(np.abs(ratio)) / 5:
            return (
                f"Where light and viewer are exchanged the values differ as the {whose} cosine "
                "does, and a BRDF is the same both ways: the file seems to hold f_r times that "
                "cosine; divide by it.",
            )
    return ()


def _clipped_samples(
    values: Float[np.ndarray, "n bands"], samples: BRDFSamples, seen: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return a mask of clipped samples. A band counts as clipped if its largest value occurs in
    more samples, spread over a part of the lobe, than repeated measurements of one direction or a
    rounding step would explain.
    """
    wi, wo = sample_directions(samples)
    half = np.stack([np.asarray(a + b) for a, b in zip(wi, wo, strict=True)], axis=-1)
    tilt = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
    found = np.zeros(len(seen), bool)
    for band in values.T:
        levels, counts = np.unique(band[seen], return_counts=True)
        top = seen & (band == levels[-1])
        places = np.unique(np.round(tilt[top] / SAME_INCIDENCE))
        piled = counts[-1] >= FEWEST_CLIPPED and len(places) > 2
        if piled and len(levels) > 1 and counts[-1] >= PILED * counts[-2]:
            found |= top & (levels[-1] > PEAK * np.median(band[seen & ~top]))
    return found


def _check_signal(
    source: str,
    values: Float[np.ndarray, "n bands"],
    incidence: Int[np.ndarray, " n"],
    incidences: Float[np.ndarray, " incidences"],
) -> None:
    """Refuse negative values beyond noise, and an incidence without reflected light."""
    lowest = values.min()
    if -lowest > values.max():
        raise InputError(
            f"{source}: a value of {lowest:g} lies farther below zero than any above it, so it is "
            "not noise; remove the rows that mark missing data."
        )
    brightest = np.array([values[incidence == i].max() for i in range(len(incidences))])
    dark = int(np.argmin(brightest))
    if brightest[dark] < SMALLEST:
        there = f" at {np.degrees(incidences[dark]):.0f} degrees of incidence"
        raise InputError(
            f"{source}: no value{there if brightest.max() >= SMALLEST else ''} is above "
            f"{SMALLEST:g} sr^-1, so nothing is reflected; remove such rows, or convert the unit."
        )


def _incidences(
    theta_i: Float[np.ndarray, " n"],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " incidences"]]:
    """Return each sample's incidence, and the light's elevations to within a degree."""
    order = np.argsort(theta_i, kind="stable")
    steps = np.diff(theta_i[order], prepend=theta_i[order[0]]) > SAME_INCIDENCE
    incidence = np.empty(len(theta_i), int)
    incidence[order] = np.cumsum(steps)
    return incidence, np.bincount(incidence, theta_i) / np.bincount(incidence)


def _select(v: Vec, chosen: np.ndarray) -> Vec:
    return Vec(*(jnp.asarray(np.asarray(x, np.float64)[chosen]) for x in (v.x, v.y, v.z)))


def _band_names(count: int, wavelengths: np.ndarray | None) -> tuple[str, ...]:
    if wavelengths is not None:
        return tuple(f"{x:.0f} nm" for x in wavelengths)
    if count == 3:
        return ("red", "green", "blue")
    return ("grey",) if count == 1 else tuple(f"band {i + 1}" for i in range(count))
