"""Comparison of the light levels of a series with each other, by signal, by distribution of light
over the frame, and by noise."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.special import stdtrit

from ..inference.formatting import format_percent
from .compared import HALF, MOSTLY, OTHER_NOISE, SURE, UNEVEN, ComparedLevels, rms
from .frame import FrameSample, OddFrames

SPIKE = 0.15  # least relative difference of a level's light from both neighbouring levels
FEWEST_LEVELS = 4  # to predict a level from its neighbours
FEWEST_ON_A_CURVE = 6  # to compare a level with a curve through the others
ONCE = 1e-3  # probability that a level of a faultless series is reported
STATED_WRONGLY = 0.02  # least relative deviation; shutters and lamps are accurate to a percent
SHADOW = 0.005  # least deviation, rms over the frame, half the usual spread of pixel gains
LIKE_SHOT_NOISE = 0.5  # relative variance per signal below which a level is saturated
LIKE_BANDS = 3.0  # of the rms effect of moving bands on the mean of a level's frames
UNLIKE = 2.0  # ratio to the scatter of the other levels, which 256 blocks determine to 5 %
ALONE_ON_IT = 1e-3  # least assumed share of a level's deviation that remains after a fit
CLIPPED = 1e-3  # share of the pixels at the top code
SATURATED = 0.1  # the same for darks, of which hot pixels alone saturate fewer
FEWEST_DARKS = 4  # levels of darks, for a line over exposure through all but one
LIT = 10.0  # least deviation of a dark level from that line, in standard deviations of a pixel


def _lit_levels(levels: ComparedLevels) -> list[int]:
    """Return the indices of the levels that have light and still have frames, ordered by light."""
    there = [i for i, frames in enumerate(levels.frames) if frames and levels.light[i] > 0]
    return sorted(there, key=lambda i: levels.light[i])


def _signals(levels: ComparedLevels, there: list[int]) -> np.ndarray:
    assert levels.black is not None
    return np.maximum(levels.means(there) - levels.black[there], 1e-9)


def dark_levels(levels: ComparedLevels) -> None:
    """Remove saturated levels of darks. Also remove a level if its mean deviates from a line over
    exposure through the other levels; the dark current makes the mean linear in exposure. For
    darks, `light` is the exposure."""
    for level, frames in enumerate(levels.frames):
        top = float(np.mean([frame.at_top for frame in frames])) if frames else 0.0
        if top > SATURATED:
            names = tuple(frame.name for frame in frames)
            reason = f"{format_percent(top)} of the pixels are saturated, though they are darks"
            levels.odd.append(OddFrames(names, reason, spare=True))
            levels.frames[level] = []
    while True:
        there = [i for i, frames in enumerate(levels.frames) if frames]
        exposure = levels.light[there]
        if len(there) < FEWEST_DARKS or len(np.unique(exposure)) < FEWEST_DARKS - 1:
            return
        means = levels.means(there)
        away, scatter = np.zeros(len(there)), np.zeros(len(there))
        for i in range(len(there)):
            rest = np.arange(len(there)) != i
            line = np.polynomial.Polynomial.fit(exposure[rest], means[rest], 1)
            away[i] = means[i] - line(exposure[i])
            scatter[i] = np.abs(means[rest] - line(exposure[rest])).max()
        noise = np.maximum(levels.noise[there], 1 / np.sqrt(12))
        beyond = np.abs(away) / np.maximum(LIT * noise, SURE * scatter)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 1:
            return
        reason = (
            f"the mean is {means[worst]:.5g} DN, where a line over exposure through the other "
            f"darks gives {means[worst] - away[worst]:.5g} DN, as if light fell in or their "
            "exposure was another one"
        )
        levels.remove(there[worst], reason)


def light_of_levels(levels: ComparedLevels) -> None:
    """Remove two kinds of level: levels without signal although the rig states light, and levels
    whose signal per light is higher, or lower, than at both neighbours. No smooth response explains
    the second kind."""
    assert levels.black is not None
    there = _lit_levels(levels)
    if len(there) < FEWEST_LEVELS:
        return
    signal, light = _signals(levels, there), levels.light[there]
    predicted = float(np.median(signal / light)) * light
    noise = np.maximum(levels.noise[there], 1 / np.sqrt(12))
    means = levels.means(there)
    for place in np.flatnonzero((signal < HALF * noise) & (predicted > SURE * noise)):
        reason = (
            f"the mean is {means[place]:.5g} DN, {levels.black[there[place]]:.5g} DN without "
            f"light, where the other levels predict a signal of {predicted[place]:.3g} DN, as if "
            "the lamp was off or the shutter closed"
        )
        levels.remove(there[place], reason)
    there = _lit_levels(levels)
    if len(there) < FEWEST_LEVELS:
        return
    signal, light = _signals(levels, there), levels.light[there]
    for place in _peaks(np.log(signal / light), np.log1p(SPIKE), levels.noise[there] / signal):
        frames = levels.frames[there[place]]
        if not frames:
            continue
        other = _find_exchange(signal, light, place)
        if other is not None and levels.frames[there[other]]:
            with_it = levels.frames[there[other]]
            names = tuple(frame.name for frame in (*frames, *with_it))
            reason = (
                f"the signals of {frames[0].name} and {with_it[0].name} fit the other levels if "
                "their light is exchanged"
            )
            levels.odd.append(OddFrames(names, reason))
            levels.frames[there[place]] = levels.frames[there[other]] = []
            continue
        usual = signal[place] / light[place] / _neighbour_mean(signal / light, place)
        reason = f"the signal is {usual:.3g} times what its neighbouring levels predict"
        top = float(np.mean([frame.at_top for frame in frames]))
        if top > MOSTLY:
            reason = f"{format_percent(top)} of the pixels are saturated, and {reason}"
        step, least = _step(frames), _step([f for i in there for f in levels.frames[i]])
        if step > least:
            reason += (
                f"; its values are multiples of {step}, those of other levels are not, as if they "
                "were multiplied or left-aligned (the upper bits of a wider number)"
            )
        levels.remove(there[place], reason)
    _stated_wrongly(levels)


def _step(frames: Sequence[FrameSample]) -> int:
    """Return the greatest common divisor of whole pixel values; 1 if they are not whole."""
    values = np.concatenate([frame.sample.ravel() for frame in frames])
    whole = np.isfinite(values).all() and (values == np.floor(values)).all()
    return max(int(np.gcd.reduce(values.astype(np.int64))), 1) if whole else 1


def _stated_wrongly(levels: ComparedLevels) -> None:
    """Remove levels whose signal per light deviates from a smooth curve through all other levels. A
    deviation of a single level means wrongly stated light, because a nonlinear response or a light
    leak would affect several levels."""
    assert levels.black is not None
    while True:
        there = _unsaturated_levels(levels)
        if len(there) < FEWEST_ON_A_CURVE:
            return
        signal, light = _signals(levels, there), levels.light[there]
        rates = signal / light / np.median(signal / light)
        # Drift of the black level, in the level's frames and in its darks.
        drift = [levels.wander * np.sqrt(2 / len(levels.frames[i])) for i in there]
        chance = np.hypot([levels.chance(i) for i in there], drift) / signal
        away, scatter, degrees = _deleted_residuals(rates, _response(light), rates, chance * rates)
        limit = -stdtrit(degrees, ONCE / len(there) / 2) * scatter
        beyond = np.abs(away) / np.maximum(limit, STATED_WRONGLY * rates)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 1:
            return
        factor = rates[worst] / max(rates[worst] - away[worst], 1e-9)
        reason = (
            f"the signal is {factor:.3g} times what a curve through the other levels predicts, "
            "so its exposure time (or its light) is not the stated one"
        )
        levels.remove(there[worst], reason)


def _unsaturated_levels(levels: ComparedLevels) -> list[int]:
    """Return unsaturated lit levels by light, without the last before saturation."""
    there = _lit_levels(levels)
    if len(there) < FEWEST_LEVELS:
        return there
    varied = np.array([levels.pixel_noise(i) ** 2 for i in there])
    rates = varied / _signals(levels, there)
    clipped = np.array([max(frame.at_top for frame in levels.frames[i]) > CLIPPED for i in there])
    saturated = clipped | (rates < LIKE_SHOT_NOISE * np.median(rates))
    saturated &= np.arange(len(there)) >= len(there) // 2
    first = int(np.argmax(saturated)) if saturated.any() else len(there) + 1
    return there[: max(first - 1, 0)]


def _response(light: np.ndarray) -> Float[np.ndarray, "levels terms"]:
    """Return terms of the signal per light: a constant, a curve, and an offset divided by light."""
    x = light / light.max()
    terms = [np.ones_like(x), x, light.min() / light]
    return np.stack(terms if len(x) < 2 * len(terms) + 2 else [*terms, x**2], axis=1)


def _deleted_residuals(
    values: Float[np.ndarray, "levels ..."],
    design: np.ndarray,
    scatter: np.ndarray,
    least: np.ndarray,
) -> tuple[Float[np.ndarray, "levels ..."], Float[np.ndarray, " levels"], int]:
    """Return each level's deviation from a fit to all others, its error, and degrees of freedom."""
    q, _ = np.linalg.qr(design / scatter[:, None])
    weighted = (values.T / scatter).T.reshape(len(values), -1)
    rest = weighted - q @ (q.T @ weighted)
    free = np.maximum(1 - np.sum(q**2, axis=1), ALONE_ON_IT)
    degrees = len(values) - design.shape[1] - 1
    squares = np.sum(rest**2) - np.sum(rest**2, axis=1) / free
    own = np.sqrt(np.maximum(squares, 0.0) / degrees / weighted.shape[1] / free) * scatter
    away = (rest / free[:, None] * scatter[:, None]).reshape(values.shape)
    return away, np.maximum(own, least / np.sqrt(free)), degrees


def distribution_of_levels(levels: ComparedLevels) -> None:
    """Remove levels whose distribution of light over the frame differs from that of all other
    levels, for example because of a shadow. Without such a change, each block of pixels has the
    same share of the frame's signal at all levels, except for a smooth change toward black (if the
    black level is uneven) and toward saturation (if the response is nonlinear)."""
    assert levels.black is not None
    while True:
        there = _unsaturated_levels(levels)
        if len(there) < FEWEST_ON_A_CURVE:
            return
        signal = _signals(levels, there)
        every = [[levels.blocks(i, frame) for frame in levels.frames[i]] for i in there]
        fields = [np.mean(own, axis=0) for own in every]
        if len({field.shape for field in fields}) > 1:
            return
        # Scatter of the light distribution from frame to frame, as from moving bands.
        apart = np.array(
            [rms(np.std(own, axis=0)) / np.sqrt(max(len(own) - 1, 1)) for own in every]
        )
        x = signal / signal.max()
        design = np.stack([np.ones_like(x), x.min() / x, x], axis=1)
        blocks = fields[0].size
        chance = np.array(
            [
                levels.noise[i] * np.sqrt(blocks / sum(f.sample.size for f in levels.frames[i]))
                for i in there
            ]
        )
        chance = chance / signal
        # Bands are few waves, so those of all frames of a level may nearly agree by chance.
        moving = np.mean(np.maximum(apart**2 - chance**2, 0.0)) ** 0.5
        chance = np.maximum(np.maximum(chance, apart), 1e-9)
        values = np.stack([field.ravel() for field in fields])
        away, scatter, _ = _deleted_residuals(values, design, chance, chance)
        size = np.array([rms(own) for own in away])
        beyond = size / np.maximum(np.maximum(UNLIKE * scatter, LIKE_BANDS * moving), SHADOW)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 1:
            return
        reason = (
            f"the distribution of light over the frame differs from all other levels by "
            f"{100 * size[worst]:.2g} % rms, as with a shadow or something in front of the sensor"
        )
        levels.remove(there[worst], reason)


def noise_of_levels(levels: ComparedLevels) -> None:
    """Remove levels whose variance per signal is a peak or dip among its neighbours."""
    there = _lit_levels(levels)
    if len(there) < FEWEST_LEVELS:
        return
    signal = _signals(levels, there)
    varied = np.array([levels.pixel_noise(i, lines=False) ** 2 for i in there])
    rates = np.maximum(varied, 1e-12 * signal) / signal
    saturated = rates < 0.5 * np.median(rates)
    count = len(there) if saturated.all() else int(np.flatnonzero(~saturated)[-1]) + 1
    sizes = np.array([levels.frames[i][0].sample.size for i in there])
    for place in _peaks(np.log(rates[:count]), np.log(OTHER_NOISE), np.sqrt(2 / sizes)):
        ratio = rates[place] / _neighbour_mean(rates, place)
        less = "with copies, averaged or smoothed frames"
        more = "if the camera moved or its gain changed"
        levels.remove(
            there[place],
            f"the variance of their difference is {ratio:.2g} times that of neighbouring levels "
            f"at the same signal, as {less if ratio < 1 else more}",
        )


def _neighbour_mean(values: np.ndarray, place: int) -> float:
    return float(np.mean(values[[place - 1, place + 1]]))


def _peaks(values: np.ndarray, size: float, chance: np.ndarray) -> list[int]:
    """Return positions of significant peaks and dips beyond `size`, the largest first."""
    left, found = list(range(len(values))), []
    while len(left) > 2:
        own, around = np.array(left[1:-1]), (np.array(left[:-2]), np.array(left[2:]))
        away = [values[own] - values[side] for side in around]
        same = np.sign(away[0]) == np.sign(away[1])
        beyond = np.where(same, np.minimum(*np.abs(away)), 0.0)
        beyond = np.where(beyond > SURE * chance[own], beyond, 0.0)
        if beyond.max() <= size:
            return found
        found.append(int(own[int(np.argmax(beyond))]))
        left.remove(found[-1])
    return found


def _find_exchange(signal: np.ndarray, light: np.ndarray, place: int) -> int | None:
    """Return the level whose frames were probably exchanged with these; None if there is none."""
    rates = signal / light
    usual = float(np.median(rates))
    for other in range(len(light)):
        swapped = signal[[place, other]] / light[[other, place]] / usual
        if other != place and light[other] != light[place]:
            stated = np.abs(np.log(rates[[place, other]] / usual))
            if np.all(np.abs(np.log(swapped)) < UNEVEN) and np.all(stated > np.log1p(SPIKE)):
                return other
    return None
