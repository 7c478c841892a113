"""Measure errors of one function in ULP, at hard cases and over its domain.

A ULP is the spacing of numbers in the result's precision at the TRUE value, never at a larger one
next to it. A true value below the smallest normal number may be returned as 0 (XLA flushes
subnormal numbers), and one above the largest as infinity."""

import zlib
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from oracle_numbers import DIGITS, LONG, MP
from registry.entry import Entry

HARD = 32  # hard cases of a function, padded from its domain to one size and one program
MANY, SLOW = 1_000_000, 300  # points drawn in float32
CHECKED = 3  # of the worst points, checked with 60 digits
STEP = "1e-20"
FINE = 120  # digits for derivatives with steps of 1e-20


@dataclass
class Row:
    """The measurement of one part of a function in one precision."""

    entry: Entry
    part: str
    dtype: str
    worst: float
    mean: float
    at: tuple
    got: float
    true: float
    points: int
    non_finite: int
    on_hard: float
    gradient: float = float("nan")
    endless_slopes: int = 0
    compiled: float = float("nan")
    one_by_one: float = float("nan")
    digest: int = 0

    @property
    def holds(self) -> bool:
        entry = self.entry
        slope = entry.gradient if self.dtype == "float32" else 1e-9 * (entry.gradient or 0) / 1e-5
        return (
            self.worst <= entry.bound
            and not self.non_finite
            and not self.endless_slopes
            and (entry.gradient is None or not self.gradient > slope)
        )


def seed_of(entry):
    return zlib.crc32(entry.title.encode())


def drawn(entry, n, dtype):
    """Return `n` points of the domain in a precision, hard cases first."""
    rng = np.random.default_rng(seed_of(entry))
    columns = [part.draw(rng, n) for part in entry.domain]
    for i, column in enumerate(columns):
        for k, case in enumerate(entry.hard[:n]):
            column[k] = np.asarray(case[i], np.float64)
    return tuple(column.astype(dtype) for column in columns)


def parts_of(entry, result):
    """Return the results as a list of arrays over points."""
    leaves = jax.tree.leaves(result)
    if len(leaves) == 1 and len(entry.parts) > 1:
        leaves = [leaves[0][..., i] for i in range(len(entry.parts))]
    assert len(leaves) == len(entry.parts), (entry.title, len(leaves))
    return [np.asarray(leaf).reshape(len(leaf), -1)[:, 0] for leaf in leaves]


def truth(entry, m, points):
    """Return the oracle's results, one array for each part."""
    with np.errstate(all="ignore"):
        result = entry.oracle(m, *(m.array(column) for column in points))
    result = result if isinstance(result, tuple) else (result,)
    kind = object if m is DIGITS else m.dtype
    return [np.broadcast_to(np.asarray(part, kind), len(points[0])) for part in result]


def ulps(got, true, scale=1.0, turn=None):
    """Return |got - true| in ULP of the dtype of `got`, divided by `scale`."""
    limits = np.finfo(got.dtype)
    exact = np.abs(true)
    error = np.abs((got.astype(true.dtype) if true.dtype != object else DIGITS.array(got)) - true)
    if turn is not None:
        error = np.minimum(error, np.abs(error - turn))
    near = np.minimum(exact, float(limits.max)).astype(np.float64).astype(got.dtype)
    spacing = np.maximum(np.spacing(near), np.spacing(limits.tiny)).astype(np.float64)
    with np.errstate(all="ignore"):
        units = (error / spacing).astype(np.float64) / scale
    tiny = np.array(exact < float(limits.tiny), bool) & (np.abs(got) <= limits.tiny)
    huge = np.array(exact > float(limits.max), bool) & ~(np.abs(got) < limits.max)
    return np.where(tiny | huge, 0.0, units)


def conditions(entry, points, step=None):
    """Return 1 + sum |x df/dx| / |f| of each part, by differences of the oracle."""
    m = DIGITS if entry.of_digits or step else LONG
    columns, h = [m.array(column) for column in points], m.c(step or "1e-6")
    values = truth(entry, m, points)
    totals = [np.ones(len(points[0])) for _ in values]
    with np.errstate(all="ignore"):
        for i, column in enumerate(columns):
            for k in range(1 if column.ndim == 1 else column.shape[1]):
                place = np.s_[:] if column.ndim == 1 else np.s_[:, k]

                def moved(factor, i=i, column=column, place=place):
                    other = column.copy()
                    other[place] = other[place] * factor
                    result = entry.oracle(m, *columns[:i], other, *columns[i + 1 :])
                    return result if isinstance(result, tuple) else (result,)

                for p, (up, down) in enumerate(zip(moved(1 + h), moved(1 - h), strict=True)):
                    safe = np.where(values[p] == 0, 1, values[p])
                    slope = np.abs((up - down) / (2 * h) / safe)
                    totals[p] = totals[p] + slope.astype(np.float64)
    return [np.where(np.isfinite(total), total, np.inf) for total in totals]


def slopes(entry, points):
    """Yield for each argument and part its derivatives (points, components), which of them are
    kinks, and the largest f / x, by differences in many digits."""
    h = DIGITS.c(STEP)
    columns = [DIGITS.array(column) for column in points]
    middle = truth(entry, DIGITS, points)
    for i, column in enumerate(columns):
        found = [[] for _ in middle]
        for place in (
            [np.s_[:]] if column.ndim == 1 else [np.s_[:, k] for k in range(column.shape[1])]
        ):
            step = np.where(column[place] == 0, h, np.abs(column[place]) * h)

            def at(sign, i=i, column=column, place=place, step=step):
                other = column.copy()
                other[place] = other[place] + sign * step
                with np.errstate(all="ignore"):
                    result = entry.oracle(DIGITS, *columns[:i], other, *columns[i + 1 :])
                result = result if isinstance(result, tuple) else (result,)
                return [np.broadcast_to(np.asarray(part, object), len(step)) for part in result]

            for p, (up, down) in enumerate(zip(at(1), at(-1), strict=True)):
                ahead, behind = (up - middle[p]) / step, (middle[p] - down) / step
                kink = np.abs(ahead - behind) > DIGITS.c("1e-9") * (np.abs(ahead) + np.abs(behind))
                safe = np.where(column[place] == 0, DIGITS.c(1), column[place])
                found[p].append(((ahead + behind) / 2, kink.astype(bool), abs(middle[p] / safe)))
        for p, parts in enumerate(found):
            slope, kink, size = (np.stack(each, axis=-1) for each in zip(*parts, strict=True))
            yield i, p, slope, kink.any(-1), size.max(-1)


def gradient_errors(entry, points):
    """Return (worst relative error of a derivative, number of non-finite ones) in the precision of
    the points."""
    program = jax.jit(jax.vmap(jax.jacrev(lambda *a: _flat(entry, a), argnums=_numbers(entry))))
    found = [np.asarray(g) for g in program(*map(jnp.asarray, points))]
    limits = np.finfo(points[0].dtype)
    worst, endless = 0.0, sum(int((~np.isfinite(g)).sum()) for g in found)
    with MP.workdps(FINE):
        expected = list(slopes(entry, points))
    for i, p, true, kink, size in expected:
        got = found[i][:, p].reshape(true.shape)
        scale = np.maximum(np.abs(true).max(-1), size * entry.of_quotient).astype(np.float64)
        known = np.where(np.isfinite(got), got, 0)
        error = np.abs(DIGITS.array(known) - true).max(-1).astype(np.float64)
        counted = (scale < float(limits.max)) & (scale > float(limits.tiny)) & ~kink
        worst = max(worst, (error[counted] / scale[counted]).max(initial=0.0))
    return worst, endless


def _numbers(entry):
    return tuple(range(len(entry.domain)))


def _flat(entry, arguments):
    """Return all results of one point in one vector."""
    leaves = jax.tree.leaves(entry.call(*arguments))
    return jnp.concatenate([leaf.reshape(-1) for leaf in leaves])[: len(entry.parts)]


def errors_at(entry, got, points, m, step=None):
    """Return the errors of each part at each point."""
    scales = conditions(entry, points, step) if entry.conditioned else [1.0] * len(entry.parts)
    exact = truth(entry, m, points)
    turns = [entry.turn(m) if name == "hue" and entry.turn else None for name in entry.parts]
    return [ulps(*each) for each in zip(got, exact, scales, turns, strict=True)]


def measured(entry, dtype, *, n=None, gradients=True, eager=False):
    """Return a row for each part of a function, from `n` points of its domain with hard cases among
    them."""
    dtype = np.dtype(dtype)
    if n is None:
        n = SLOW if entry.of_digits else MANY
        n = n if dtype == np.float32 else max(n // 5, HARD)
    program = jax.jit(jax.vmap(entry.call))
    points = drawn(entry, n, dtype)
    got = parts_of(entry, program(*map(jnp.asarray, points)))
    assert all(part.dtype == dtype for part in got), (entry.title, [part.dtype for part in got])
    m = DIGITS if entry.of_digits else LONG
    swept = errors_at(entry, got, points, m)
    few = tuple(column[:HARD] for column in points)
    hard = errors_at(entry, [part[:HARD] for part in got], few, DIGITS)
    rows = []
    for p, name in enumerate(entry.parts):
        broken = ~np.isfinite(swept[p])
        known = np.where(broken, 0, swept[p])
        checked = np.argsort(known)[-CHECKED:]
        again = tuple(column[checked] for column in points)
        exact = truth(entry, DIGITS, again)[p]
        errors = errors_at(entry, [part[checked] for part in got], again, DIGITS)[p]
        k = int(np.argmax(errors))
        on_hard = np.where(np.isfinite(hard[p]), hard[p], 0)
        rows.append(
            Row(
                entry,
                name,
                dtype.name,
                worst=float(max(errors.max(), on_hard.max())),
                mean=float(known.mean()),
                at=tuple(np.asarray(column[k]).tolist() for column in again),
                got=float(got[p][checked[k]]),
                true=float(exact[k]),
                points=n,
                non_finite=int(broken.sum()),
                on_hard=float(on_hard.max()),
                digest=zlib.crc32(got[p].tobytes()),
            )
        )
    if gradients and entry.gradient is not None:
        worst, endless = gradient_errors(entry, few)
        for row in rows:
            row.gradient, row.endless_slopes = worst, endless
    if eager:
        whole = parts_of(entry, jax.vmap(entry.call)(*map(jnp.asarray, few)))
        for p, row in enumerate(rows):
            row.compiled = _apart(got[p][:HARD], whole[p])
        alone = [entry.call(*(jnp.asarray(column[k]) for column in few)) for k in range(CHECKED)]
        stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *alone)
        for p, (row, part) in enumerate(zip(rows, parts_of(entry, stacked), strict=True)):
            row.one_by_one = _apart(whole[p][:CHECKED], part)
    return rows


def _apart(a, b):
    """Return the largest difference of two results, in ULP of the second."""
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(all="ignore"):
        units = np.abs(a.astype(np.float64) - b) / np.spacing(np.abs(b)).astype(np.float64)
    return float(np.where(same, 0, units).max(initial=0))


in_float32 = partial(measured, dtype=np.float32)
