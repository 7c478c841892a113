"""Estimate directions and irradiances of distant lights from the shading of a matte ball.

The ball's normals n(o), the rows of a matrix N, follow from its outline o. With irradiance E,
albedo rho and light direction l, the signal is m = g.n with g = E rho l, where n.l > 0. All lights
share the outline, whose prior with covariance C_o is the result of fitting it to the mask. The
outline's information is

    H_oo = C_o^-1 + sum_k (D_k' D_k - B_k' A_k^-1 B_k) / s_k^2,   A = N'N, B_k = N'D_k,

with D_k = d(N g_k)/do and the residuals' standard deviation s_k under light k. If residuals of
neighbouring pixels are correlated, the design effect of sectors of the ball reduces the effective
number of pixels.

A second fit has one more unknown that all lights share, the power p of m = |g| (n.l)^p. A gamma, a
nonlinear response or a surface that is not Lambertian make p differ from 1. If p were fixed at 1,
the outline would absorb most of the residuals."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from jaxvision.errors import InputError

from ..inference.formatting import format_percent
from .outline import Outline, surface

LIT = 0.2  # smallest n.l of the pixels that are fitted
ROUNDS = 4  # updates of the outline
SIGHT = 0.9  # share of the radius within which pixels are fitted
FEWEST = 50  # pixels
STEP = 1e-3  # pixels
UNLIT = 0.1  # -n.l of pixels that should read black
SMALL = 0.002  # of the largest signal: a reading of the unlit side too small to matter
SHOWN = 50.0  # chi-square of three numbers from which room light is called uneven
SECTORS, RINGS = 8, 3
MOVED = 1.0  # pixels, least distance of a ball that moved
WIDE = 10.0  # pixels, standard deviation of that distance before the image is seen
ODD = 0.01  # of the largest signal: least constant of an image that differs from the others
CLEAR = 5.0  # standard errors from which the power differs from 1
POWERS = 0.4, 2.5  # range of the power


@dataclass(frozen=True)
class Shading:
    """The fitted lights of a matte ball, and the outline that they share."""

    values: Float[np.ndarray, "3"]  # column, row and radius of the outline, pixels
    outline_covariance: Float[np.ndarray, "3 3"]  # covariance of the outline
    # direction of each light times its irradiance and the albedo, DN
    g: Float[np.ndarray, "lights 3"]
    own: Float[np.ndarray, "lights 3 3"]  # covariance of g for a known outline
    by_outline: Float[np.ndarray, "lights 3 3"]  # derivative of g with respect to the outline
    misfit: float  # rms residual over the largest signal, median over lights
    effect: float  # design effect of the residuals
    offset: Float[np.ndarray, " lights"]  # constant that each image alone would add to its g.n, DN
    # displacement of the ball in each image alone from the shared outline, columns and rows, pixels
    shift: Float[np.ndarray, "lights 2"]
    shift_sd: Float[np.ndarray, " lights"]  # its standard deviation, pixels
    # level of pixels that face away from the lights, DN above black; it was subtracted
    floor: float = 0.0
    power: float = 1.0  # fitted power of n.l, 1 for Lambert's law
    power_sd: float = 0.0  # its standard error
    # change of g if the power is free; None if it does not differ from 1
    moved: Float[np.ndarray, "lights 3"] | None = None
    # change of every g by room light that is brighter on one side of the ball, as the unlit pixels
    # show it; None if it is small
    tilt: Float[np.ndarray, " 3"] | None = None
    # level of the unlit pixels under each light, DN above black; NaN where they are few
    unlit: Float[np.ndarray, " lights"] = field(default_factory=lambda: np.zeros(0))


def shading_of(
    signals: Float[np.ndarray, "lights h w"],
    ball: Bool[np.ndarray, "h w"],
    clip: float,
    outline: Outline,
    *,
    names: list[str],
) -> Shading:
    """Fit lights and outline together by Gauss-Newton, to signals in DN above black.

    The level of the ball's unlit side, due to a wrong black level or room light, is subtracted.
    """
    found = _shading(signals, ball, clip, outline, names)
    floor, seen = _unlit_side(signals, ball, found, outline)
    if floor != 0:
        signals, clip = signals - floor, clip - floor
        found = _shading(signals, ball, clip, outline, names)
    if abs(floor) <= SMALL * np.linalg.norm(found.g, axis=1).max():
        floor = 0.0  # subtracted, and too small to be reported
    found = replace(found, floor=floor, **seen)
    free = _shading(signals, ball, clip, outline, names, free_power=True)
    found = replace(found, power=free.power, power_sd=free.power_sd)
    if not abs(free.power - 1) > CLEAR * free.power_sd:
        return found
    return replace(found, moved=free.g - found.g)


def moved_image(found: Shading, spreads: float) -> int | None:
    """Return the image whose ball lies farthest from the outline that all share, by its shading
    alone; None if all agree."""
    size = np.hypot(*found.shift.T)
    worst = int(np.argmax(size))
    clear = size[worst] > max(
        MOVED, spreads * float(np.median(size)), CLEAR * found.shift_sd[worst]
    )
    return worst if clear else None


def odd_image(found: Shading, spreads: float) -> int | None:
    """Return the image whose constant added to the shading, relative to its largest signal, differs
    most from the others; None if no image stands out."""
    relative = found.offset / np.linalg.norm(found.g, axis=1)
    off = np.abs(relative - np.median(relative))
    worst = int(np.argmax(off))
    return worst if off[worst] > max(ODD, spreads * float(np.median(off))) else None


def _unlit_side(
    signals: Float[np.ndarray, "lights h w"],
    ball: Bool[np.ndarray, "h w"],
    found: Shading,
    outline: Outline,
) -> tuple[float, dict[str, Any]]:
    """Return the level of the unlit side, where n.l < 0, in DN, and `tilt` and `unlit` of
    `Shading`. The level is 0 if it is within its standard error, and the tilt None if it is small.
    """
    rows, columns = np.nonzero(ball)
    pixels = np.stack([columns, rows], axis=1).astype(float)
    inner = np.hypot(*(pixels - found.values[:2]).T) < SIGHT * found.values[2]
    normals = surface(found.values, pixels[inner], outline.lens)[0]
    size = np.linalg.norm(found.g, axis=1)
    unlit = found.g @ normals.T < -UNLIT * size[:, None]
    readings = signals[:, rows[inner], columns[inner]]
    kept = unlit.sum(axis=1) >= FEWEST
    if not kept.any():
        return 0.0, {}
    of_light = np.full(len(readings), np.nan)
    of_light[kept] = [
        _middle(line[at]) for line, at in zip(readings[kept], unlit[kept], strict=True)
    ]
    floor, largest = float(np.nanmedian(of_light)), float(size.max())
    spread = 1.4826 * float(np.median(np.abs(readings[kept][unlit[kept]] - floor)))
    sd = 1.2533 * spread / np.sqrt(unlit[kept].sum())
    light, pixel = np.nonzero(unlit & kept[:, None])
    design = np.column_stack([np.ones(len(pixel)), normals[pixel]])
    room = np.linalg.lstsq(design, readings[light, pixel], rcond=None)[0]
    rest = readings[light, pixel] - design @ room
    covariance = np.linalg.pinv(design.T @ design)[1:, 1:] * max(np.var(rest), 1e-12)
    clear = room[1:] @ np.linalg.pinv(covariance) @ room[1:] > SHOWN
    large = np.linalg.norm(room[1:]) > SMALL * largest
    tilt = room[1:] if clear and large else None
    absent = not abs(floor) > 4 * sd
    return 0.0 if absent else floor, {"tilt": tilt, "unlit": of_light}


def _middle(readings: Float[np.ndarray, " pixels"]) -> float:
    """Return the mean of readings near their median; the mean is not limited to whole codes."""
    median = np.median(readings)
    off = np.abs(readings - median)
    return float(np.mean(readings[off <= 1 + 3 * 1.4826 * np.median(off)]))


def _shading(
    signals: Float[np.ndarray, "lights h w"],
    ball: Bool[np.ndarray, "h w"],
    clip: float,
    outline: Outline,
    names: list[str],
    *,
    free_power: bool = False,
) -> Shading:
    rows, columns = np.nonzero(ball)
    whole = np.stack([columns, rows], axis=1).astype(float)
    prior, start = np.zeros((4, 4)), np.append(outline.values, 1.0)
    prior[:3, :3] = np.linalg.inv(outline.covariance)
    free = slice(0, 4 if free_power else 3)
    values, power, effect, parts = outline.values.copy(), 1.0, 1.0, []
    information = prior[free, free]
    for _ in range(2 * ROUNDS if free_power else ROUNDS):
        apart = (whole - values[:2]) / values[2]
        kept = np.hypot(*apart.T) < SIGHT
        pixels, apart = whole[kept], apart[kept] / SIGHT
        ring = np.minimum(np.sum(apart**2, axis=1) * RINGS, RINGS - 1).astype(int)
        around = np.floor(np.arctan2(*apart.T) / (2 * np.pi) * SECTORS).astype(int) % SECTORS
        sector = around + SECTORS * ring
        readings = signals[:, rows[kept], columns[kept]]
        normals = surface(values, pixels, outline.lens)[0]
        steps = STEP * np.eye(3)
        slopes = np.stack(
            [
                surface(values + step, pixels, outline.lens)[0]
                - surface(values - step, pixels, outline.lens)[0]
                for step in steps
            ],
            axis=-1,
        ) / (2 * STEP)
        parts = [
            _solve_light(reading, normals, slopes, sector, clip, name, power)
            for reading, name in zip(readings, names, strict=True)
        ]
        effect = max(float(np.mean([part.effect for part in parts])), 1.0)
        information = (prior + sum(part.information for part in parts) / effect)[free, free]
        pull = prior @ (start - np.append(values, power))
        pull = (pull + sum(part.pull for part in parts) / effect)[free]
        step = np.linalg.solve(information, pull)
        values = values + step[:3]
        if free_power:
            power = float(np.clip(power + step[3], *POWERS))
    covariance = np.linalg.inv(information)
    usual = max(float(np.median([part.effect for part in parts])), 1.0)
    alone = np.array([part.information[:3, :3] for part in parts]) / usual + np.eye(3) / WIDE**2
    pulls = np.array([part.pull[:3] for part in parts]) / usual
    alone = np.linalg.inv(alone)
    return Shading(
        values,
        covariance[:3, :3],
        np.array([part.g for part in parts]),
        np.array([part.own for part in parts]) * effect,
        np.array([part.by_outline for part in parts]),
        float(np.median([part.misfit for part in parts])),
        effect,
        np.array([part.offset for part in parts]),
        np.einsum("lij,lj->li", alone, pulls)[:, :2],
        np.sqrt(np.einsum("lii->l", alone[:, :2, :2])),
        power=power,
        power_sd=float(np.sqrt(covariance[-1, -1])) if free_power else 0.0,
    )


@dataclass(frozen=True)
class _Light:
    g: np.ndarray
    own: np.ndarray
    by_outline: np.ndarray
    information: np.ndarray
    pull: np.ndarray
    misfit: float
    effect: float
    offset: float


def _solve_light(
    reading: np.ndarray,
    normals: np.ndarray,
    slopes: np.ndarray,
    sector: np.ndarray,
    clip: float,
    name: str,
    power: float,
) -> _Light:
    """Fit one light by least squares for a given outline and power, and return its contribution to
    the normal equations of outline and power.
    """
    usable = np.isfinite(normals[:, 2]) & (reading < clip)
    if (share := float(np.mean(reading >= clip))) > 0.5:
        raise InputError(f"{name}: {format_percent(share)} of the ball are saturated; expose less.")
    lit = usable & (reading > 0.3 * np.quantile(reading, 0.98))
    g, linear = np.zeros(3), reading
    for _ in range(6):
        if lit.sum() < FEWEST or np.quantile(reading, 0.98) < 2:
            raise InputError(
                f"{name}: {lit.sum()} pixels of the ball are lit, of at least {FEWEST} needed; "
                "expose longer, or leave the image out."
            )
        size = float(np.linalg.norm(g)) or float(np.quantile(reading, 0.98))
        linear = size * (np.maximum(reading, 0) / size) ** (1 / power) if power != 1 else reading
        g = np.linalg.lstsq(normals[lit], linear[lit], rcond=None)[0]
        lit = usable & (normals @ g > LIT * np.linalg.norm(g))
    n, left = normals[lit], linear[lit] - normals[lit] @ g
    inverse = np.linalg.inv(n.T @ n)
    variance = max(float(left @ left) / (lit.sum() - 3), 1e-12 * float(g @ g))
    shade = n @ g
    bent = shade * np.log(np.maximum(shade, 1e-300) / np.linalg.norm(g)) / power
    change = np.column_stack([np.einsum("pco,c->po", slopes[lit], g), bent])
    back = inverse @ (n.T @ change)
    beyond = change - n @ back
    constant = 1 - n @ (inverse @ n.sum(axis=0))
    sums = np.stack([np.bincount(sector[lit], column * left) for column in n.T], axis=1)
    effect = float(np.einsum("si,ij,sj->", sums, inverse, sums)) / (3 * variance)
    return _Light(
        g,
        inverse * variance,
        -back[:, :3],
        beyond.T @ beyond / variance,
        beyond.T @ left / variance,
        float(np.sqrt(variance) / np.linalg.norm(g)),
        effect,
        float(constant @ left / (constant @ constant)),
    )
