"""What a material makes of light at most: the suprema of its shading.

The shading f_r cos of a family is a body, at most `body` times the cosine, and a lobe, at most a
function of the angles of a cell. Each family has one function here; a family without one is not
bounded, and what depends on it is kept. No units but sr^-1.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..brdf.blinn import Blinn, BlinnBRDF, NormalisedBlinn
from ..brdf.dichromatic import Dichromatic
from ..brdf.fresnel import Conductor, Dielectric, Interface, Schlick
from ..brdf.gaussian_lobe import GaussianLobe, GaussianLobeBRDF
from ..brdf.glass import Glass
from ..brdf.half_difference import HalfDifferenceTable
from ..brdf.lambert import Lambert
from ..brdf.measured import AnisotropicTable, IsotropicTable
from ..brdf.microfacet import LEAST_ROUGHNESS
from ..brdf.mirror import Mirror
from ..brdf.oren_nayar import OrenNayar
from ..brdf.phong import NormalisedPhong, Phong, PhongBRDF
from ..brdf.rgl import RGL
from ..brdf.torrance_sparrow import TorranceSparrow
from ..scene import Material
from .angles import Angles
from .bodies import numbers
from .stages import Ends

_MONOTONE = 3.7  # index up to which a dielectric's reflectance rises with the angle


class Lobe(NamedTuple):
    """A lobe beside a body.

    Attributes:
        spectrum: (bands,) or (1,), k_s.
        most: from angles to the largest f_r cos / k_s, (c, s) in sr^-1.
        size: sr / sr, the largest integral of f_r cos / k_s over all light.
        slope: sr^-1 rad^-1, the largest change of f_r cos / k_s with the direction of light above
            the horizon; None where none is known.
        neutral: whether its shape is the same for all bands.
        step: whether it ends at the horizon at once, not as a cosine does.
    """

    spectrum: np.ndarray
    most: Callable[[Angles], np.ndarray]
    size: float
    slope: float | None
    neutral: bool
    step: bool

    @property
    def gain(self) -> float:
        """2 pi times the largest f_r cos of any angles, over `size`: by what factor the lobe's
        share of a small solid angle may exceed that angle over 2 pi. No unit."""
        one = np.ones((1, 1))
        peak = self.most(Angles(0 * one, one, 0 * one, one, 0 * one, one))
        return 2 * np.pi * float(peak.max()) / self.size if self.size > 0 else np.inf


class Reflection(NamedTuple):
    """The suprema of one material.

    Attributes:
        body: (bands,) sr^-1, sup of the diffuse part's f_r.
        lobe: or None.
        plain: (bands,) sr^-1: the most by which the body, but for its share `grazing`, differs from
            a Lambertian of the same k_d; 0 for one.
        mirror: (bands,) or (1,), reflectance of a mirror, or None.
        why: "" or why there is no bound; then `body` is inf.
        grazing: share of `body` that bounds f_r cos(theta_i), not f_r: it does not fall toward the
            horizon.
    """

    body: np.ndarray
    lobe: Lobe | None = None
    plain: np.ndarray | float = 0.0
    mirror: np.ndarray | None = None
    why: str = ""
    grazing: float = 0.0


def _peak(x: Any, name: str) -> np.ndarray:
    """The largest size of a spectrum at the two ends."""
    return np.maximum(*(np.abs(numbers(getattr(end, name))) for end in x))


def _least(x: Any, name: str) -> float:
    return min(float(numbers(getattr(end, name)).min()) for end in x)


def _most(x: Any, name: str) -> float:
    return max(float(numbers(getattr(end, name)).max()) for end in x)


def _power(cosines: np.ndarray, n: float) -> np.ndarray:
    return np.where(cosines > 0, np.maximum(cosines, 1e-300) ** n, 0 if n > 0 else 1)


def _cos_mirror(angles: Angles) -> np.ndarray:
    return np.where(angles.off_mirror < np.pi / 2, np.cos(angles.off_mirror), 0)


def _power_slope(n: float) -> float:
    """max |d cos^n / d angle| = sqrt(n) (1 - 1/n)^((n-1)/2) = n cos^(n-1) sin at its largest; 1 at
    n = 1. Below, it is steeper than any slope at a right angle, and 0 a step."""
    if n < 1:
        return np.inf
    return float(np.sqrt(n) * (1 - 1 / n) ** ((n - 1) / 2)) if n > 1 else 1.0


def _phong(x: Ends[Any]) -> Reflection:
    """k_s [cos theta_s]^n; the least exponent is the broadest."""
    n, top = _least(x, "exponent"), _most(x, "exponent")
    scale = (top + 2) / (2 * np.pi) if isinstance(x.low, NormalisedPhong) else 1.0
    cosine = not isinstance(x.low, Phong)

    def most(a: Angles) -> np.ndarray:
        return scale * _power(_cos_mirror(a), n) * (a.cos_i if cosine else 1)

    # of the power, which is least between n = 1 and 2, and of the cosine
    slope = scale * (max(_power_slope(n), _power_slope(top)) + cosine)
    size = scale * 2 * np.pi / (n + 1)
    lobe = Lobe(_peak(x, "specular"), most, size, slope, True, not cosine)
    return Reflection(_peak(x, "diffuse"), lobe)


def _gaussian(x: Ends[Any]) -> Reflection:
    """k_s exp(-(c theta_s)^2); its integral is at most pi / c^2."""
    c = min(abs(_least(x, "concentration")), abs(_most(x, "concentration")))
    top = max(abs(_least(x, "concentration")), abs(_most(x, "concentration")))
    cosine = isinstance(x.low, GaussianLobeBRDF)

    def most(a: Angles) -> np.ndarray:
        return np.exp(-((c * a.off_mirror) ** 2)) * (a.cos_i if cosine else 1)

    size = min(2 * np.pi, np.pi / c**2 if c > 0 else np.inf)
    slope = top * np.sqrt(2 / np.e) + cosine
    lobe = Lobe(_peak(x, "specular"), most, size, slope, True, not cosine)
    return Reflection(_peak(x, "diffuse"), lobe)


def _blinn(x: Ends[Any]) -> Reflection:
    """k_s (n.h)^n; dwi = 4 wo.h dh, so that its integral is at most 8 pi / (n + 1)."""
    n, top = _least(x, "exponent"), _most(x, "exponent")
    scale = 1.0
    if isinstance(x.low, NormalisedBlinn):
        scale = (top + 2) * (top + 4) / (8 * np.pi * (n + 2 ** (-n / 2)))
    cosine = not isinstance(x.low, Blinn)

    def most(a: Angles) -> np.ndarray:
        return scale * _power(a.cos_half, n) * (a.cos_i if cosine else 1)

    size = scale * min(2 * np.pi, 8 * np.pi / (n + 1))
    return Reflection(
        _peak(x, "diffuse"), Lobe(_peak(x, "specular"), most, size, None, True, not cosine)
    )


def _oren_nayar(x: Ends[OrenNayar]) -> Reflection:
    """k_d (A + B sin tan): times cos(theta_i) at most k_d (A cos(theta_i) + B), for cos sin tan is
    at most 1, not cos. Lambert's differs by at most max((1 - A) cos, B) k_d. In full (equations 27
    to 30) the second and the third term exclude each other in cos(phi), and the light between
    facets adds at most .34 rho v / (v + .13). The body is never less than the k_d of the Lambertian
    that may take its place.
    """
    v_low, v = _least(x, "sigma") ** 2, _most(x, "sigma") ** 2
    a_most, a_least = (1 - 0.5 * s / (s + 0.33) for s in (v_low, v))
    b = 0.45 * v / (v + 0.09)
    k_d = _peak(x, "diffuse")
    if x.low.form == "qualitative":
        whole, plain = np.maximum(a_most + b, 1), k_d * max(1 - a_least - b, 0)
    else:
        facets = 0.34 * np.pi * k_d * v / (v + 0.13)
        whole = np.maximum(a_most + b + facets, 1)
        plain = k_d * np.maximum(1 - a_least, facets)
    return Reflection(k_d * whole, plain=plain, grazing=float(np.max(b / whole)))


def _torrance_sparrow(x: Ends[TorranceSparrow]) -> Reflection:
    """k_s F D V cos, each factor at its largest over the angles of a cell.

    D = (1 + t)^2 / (pi ax ay (1 + t / a^2)^2) for GGX, exp(-t / a^2) in place of the quotient for
    Beckmann, t = tan^2 of the half vector's angle. Smith: V cos_i <= 1 / (4 (c_o + H_o)), with
    c_o + H_o = (c_o + sqrt(c_o^2 + a^2 s_o^2)) / 2 for GGX and at least max(c_o, a s_o / (2 sqrt
    pi)) for Beckmann. V-cavity: V cos_i <= 1 / (4 max(c_o, d^2 / (c_i + c_o))). The integral is at
    most 1, for facets only lose light.
    """
    wide = max(_most(x, "roughness"), LEAST_ROUGHNESS)
    small = np.min([np.broadcast_to(numbers(end.roughness), (2,)) for end in x], axis=0)
    narrow = np.maximum(small, LEAST_ROUGHNESS)
    peak, tight = 1 / (np.pi * narrow[0] * narrow[1]), narrow.min()

    def facets(cos_half: np.ndarray) -> np.ndarray:
        least = 1 / np.maximum(cos_half, 1e-150) ** 2  # 1 + t
        if x.low.distribution == "ggx":

            def shape(s: np.ndarray | float) -> np.ndarray | float:
                return (s / (1 + (s - 1) / wide**2)) ** 2

            return peak * np.maximum(shape(least), wide**4 if wide > 1 else 0)
        s = np.maximum(least, 2 * wide**2)
        return peak * np.minimum(s, 1e150) ** 2 * np.exp(-np.minimum((s - 1) / wide**2, 700))

    def seen(a: Angles) -> np.ndarray:
        if x.low.shadowing == "v-cavity":
            both = np.maximum(a.cos_i + a.cos_o_most, 1e-150)
            below = np.maximum(a.cos_o, a.cos_between**2 / both)
        elif x.low.distribution == "ggx":
            root = np.sqrt(a.cos_o**2 + tight**2 * (1 - a.cos_o**2))
            below = np.minimum((a.cos_o + root) / 2, 1)
        else:
            k = tight / (2 * np.sqrt(np.pi))
            below = np.maximum(a.cos_o, k / np.sqrt(1 + k * k))
        return 0.25 / np.maximum(below, 1e-150)

    fresnel, neutral = _fresnel(x.of("interface"))

    def most(a: Angles) -> np.ndarray:
        return fresnel(a.cos_between) * facets(a.cos_half) * seen(a)

    lobe = Lobe(_peak(x, "specular"), most, float(fresnel(0.0)), None, neutral, False)
    return Reflection(_peak(x, "diffuse"), lobe)


def _fresnel(x: Ends[Interface | None]) -> tuple[Callable[[Any], Any], bool]:
    """The largest reflectance of any band where the cosine is at least a given one; and whether all
    bands share it."""
    low, high = x
    match low, high:
        case Dielectric(), Dielectric():
            eta = np.stack([numbers(low.eta), numbers(high.eta)])
            neutral = low.eta.shape == (1,)
            if np.all(eta == 1):
                return lambda c: 0 * c, True
            if np.all((eta >= 1) & (eta <= _MONOTONE)):
                ends = float(eta.min()), float(eta.max())
                return lambda c: _dielectric(c, *ends), neutral
            return lambda c: 0 * c + 1, neutral
        case Schlick(), Schlick():
            f0 = max(float(numbers(end.f0).max()) for end in (low, high))
            return lambda c: np.maximum(f0, f0 + (1 - f0) * (1 - c) ** 5), low.f0.shape == (1,)
        case Conductor(), Conductor():
            return lambda c: 0 * c + 1, low.eta.shape == low.k.shape == (1,)
    return lambda c: 0 * c + 1, True


def fresnel_least(x: Ends[Interface | None]) -> float:
    """The least reflectance of any band at any angle; 0 where it is not known."""
    low, high = x
    match low, high:
        case Dielectric(), Dielectric():
            eta = min(float(numbers(end.eta).min()) for end in (low, high))
            return ((eta - 1) / (eta + 1)) ** 2 if eta >= 1 else 0.0
        case Schlick(), Schlick():
            return max(min(float(numbers(end.f0).min()) for end in (low, high)), 0.0)
    return 0.0


def _dielectric(c: Any, least: float, most: float) -> Any:
    """No less than Fresnel's reflectance of unpolarised light, of indices between two, >= 1; equal
    to it where they are one. That of s grows with the index; that of p is largest at an end, or
    where eta^2 is twice the squared sine."""

    def amplitudes(eta: Any) -> tuple[Any, Any]:
        g = np.sqrt(eta**2 - 1 + c * c)
        return (c - g) / (c + g), (eta**2 * c - g) / (eta**2 * c + g)

    s, p = amplitudes(most)
    most_p = p * p
    if least < most:
        inner = np.clip(np.sqrt(np.maximum(2 * (1 - np.square(c)), 1)), least, most)
        for eta in (least, inner):
            most_p = np.maximum(most_p, amplitudes(eta)[1] ** 2)
    return (s * s + most_p) / 2


def _table(x: Ends[Any]) -> Reflection:
    """The largest entry: what is linear between nodes stays below it, unless it is extrapolated."""
    values = np.maximum(*(np.abs(numbers(end.values)) for end in x))
    body = values.reshape(-1, values.shape[-1]).max(0)
    if getattr(x.low, "outside", "clamp") == "extrapolate":
        return Reflection(body + np.inf, why="a table that is extrapolated has no largest value")
    return Reflection(body, plain=np.inf)


def _rgl(x: Ends[RGL]) -> Reflection:
    bands = x.low.values.shape[-1]
    why = "no bound of an adaptive table is known"
    return Reflection(np.full(bands, np.inf), plain=np.inf, why=why)


def _dichromatic(x: Ends[Dichromatic]) -> Reflection:
    """The sum of its parts, each times its spectrum; the interface's own body counts as body."""
    body, interface = reflection_of(x.of("body")), reflection_of(x.of("interface"))
    c_b, c_i = _peak(x, "body_spectrum"), _peak(x, "interface_spectrum")
    diffuse = c_b * body.body + c_i * interface.body
    parts = [(own.lobe, c) for own, c in ((body, c_b), (interface, c_i)) if own.lobe is not None]
    grazing = max(body.grazing, interface.grazing)
    why = body.why or interface.why
    if not parts:
        return Reflection(diffuse, plain=np.inf, why=why, grazing=grazing)
    first, colour = parts[0]
    if len(parts) == 2:
        return Reflection(diffuse + np.inf, plain=np.inf, why="two lobes in one material")
    spectrum = colour * first.spectrum
    lobe = first._replace(spectrum=spectrum)
    return Reflection(diffuse, lobe, np.inf, why=why, grazing=grazing)


def _lambert(x: Ends[Lambert]) -> Reflection:
    return Reflection(_peak(x, "diffuse"))


def _mirror(x: Ends[Mirror]) -> Reflection:
    return Reflection(np.zeros(1), mirror=_peak(x, "reflectance"))


def _glass(x: Ends[Glass]) -> Reflection:
    """In `render` glass is black; in a ray tree it passes at most all of what arrives."""
    return Reflection(np.zeros(1), mirror=np.ones(1))


SUPREMA: dict[type[Material], Callable[[Any], Reflection]] = {
    Lambert: _lambert,
    Phong: _phong,
    PhongBRDF: _phong,
    NormalisedPhong: _phong,
    GaussianLobe: _gaussian,
    GaussianLobeBRDF: _gaussian,
    Blinn: _blinn,
    BlinnBRDF: _blinn,
    NormalisedBlinn: _blinn,
    OrenNayar: _oren_nayar,
    TorranceSparrow: _torrance_sparrow,
    IsotropicTable: _table,
    AnisotropicTable: _table,
    HalfDifferenceTable: _table,
    RGL: _rgl,
    Dichromatic: _dichromatic,
    Mirror: _mirror,
    Glass: _glass,
}


def reflection_of(material: Ends[Any]) -> Reflection:
    """The suprema of a material between its two ends; inf for a family of one's own."""
    own = SUPREMA.get(type(material.low))
    if own is None:
        kind = type(material.low).__name__
        return Reflection(np.array([np.inf]), plain=np.inf, why=f"no bound of {kind} is known")
    return own(material)
