"""Count how many digits of a function's results are correct in spite of float32 rounding, and find
the operation that loses most digits.

The function is traced to its jaxpr, and every operation runs in float64 on float32 operands. If the
result is not a float32 number, it is rounded up or down at random. The probability of each
direction makes the expectation exact, but is at least 3/8, so that even a few runs show how many
digits of a small term are lost in a sum. An exact result is not changed, so that compensated sums
and products work. The scatter of the results over several runs is the rounding error (Parker,
"Monte Carlo Arithmetic", UCLA CSD-970002, 1997). Special functions and long sums may have a float32
error above one ULP. Such an error is added with a random sign. A result that underflows becomes, at
random, 0 or the smallest normal number. A loop, a branch or a linear solve is reported as one
operation, but each operation inside it is rounded separately.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal

from ..core._types import as_dtype
from ..errors import InputError

WHOLE = float(-np.log10(np.finfo(np.float32).eps / 2))  # digits of float32
_INSIDE = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # parameters that contain the jaxpr of a call
_AS_ONE = ("scan", "while", "cond", "custom_linear_solve")
_WIDE = {
    np.dtype(np.float32): np.dtype(np.float64),
    np.dtype(np.complex64): np.dtype(np.complex128),
}
_RARELY = 3 / 8  # probability of an inexact result's farther neighbour, at least
_OWN = 2.0  # ULP, beyond which an operation has an error of its own
_LOSS = 1.0  # lost digits, beyond which an operation is named


@dataclass(frozen=True)
class Digits:
    """The number of correct digits of each output of a function, and the operation that loses most
    digits.

    Attributes:
        digits: number of correct digits, at most 7.2, in arrays of the shapes of the outputs; NaN
            where an output is not finite.
        operation: for an output that lost more than one digit, the operation that lost the most
            digits of its operands, with its source line; "" for other outputs.
        lost: number of digits lost by that operation.
    """

    digits: Any
    operation: str
    lost: float

    @property
    def fewest(self) -> float:
        """The smallest number of correct digits of any finite output; NaN if no output is
        finite."""
        known = self._check_known()
        finite = known[np.isfinite(known)]
        return float(finite.min()) if finite.size else (WHOLE if not known.size else np.nan)

    def _check_known(self) -> np.ndarray:
        return np.concatenate([np.zeros(0), *(np.ravel(x) for x in jax.tree.leaves(self.digits))])

    def __str__(self) -> str:
        unknown, count = int(np.isnan(self._check_known()).sum()), self._check_known().size
        if count and unknown == count:
            return "No result is finite at these arguments."
        left = f"{self.fewest:.1f} of {WHOLE:.1f} digits are left"
        if unknown:
            left = f"{unknown} of {count} results are not finite; of the others {left}"
        return f"{left}; {self.operation} loses {self.lost:.1f}." if self.operation else f"{left}."


def digits(function: Callable[..., Any], *arguments: Any, runs: int = 16, seed: int = 0) -> Digits:
    """Estimate how many digits of a function's float32 results are correct at the given arguments.

    Arguments and constants are assumed to be exact. In float64 the function loses the same number
    of digits, out of 16 instead of 7.2. Only rounding errors are counted: a truncated series has
    all digits even if the truncation error is large.

    Args:
        function: function from arrays to a pytree of arrays, which `jax.jit` can trace.
        arguments: pytrees of arrays; floating ones are rounded to float32.
        runs: number of runs with different random roundings, at least 2.
        seed: seed of the random roundings.

    Returns:
        The digits of each output, and the operation that loses most.

    Raises:
        InputError: for fewer than 2 runs, and for a function that rounds to fewer digits than
            float32 has, as float16 and bfloat16.

    Example:
        >>> from jaxvision.accuracy import digits
        >>> x = jnp.float32(1e-3)
        >>> near = digits(lambda x: 1 - jnp.cos(x), x)
        >>> near.fewest < 2, near.operation.split()[0]
        (True, 'sub')
        >>> digits(lambda x: 2 * jnp.sin(x / 2) ** 2, x).fewest > 6.5
        True
    """
    if runs < 2:
        raise InputError(f"digits: give at least 2 runs, got {runs}.")
    single = as_dtype(jax.tree.map(jnp.asarray, arguments), jnp.float32)
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*single)
    names: list[str] = []
    with jax.enable_x64(True):
        once = jax.jit(partial(_evaluate, closed.jaxpr, names=names))
        keys = jax.random.split(jax.random.key(seed), runs)
        flat = jax.tree.leaves(single)
        found = [once(key, list(closed.consts), flat) for key in keys]
        results, traces = zip(*(jax.tree.map(np.asarray, one) for one in found), strict=True)
    spread = [_digits_of(np.stack(own)) for own in zip(*results, strict=True)]
    left = jax.tree.unflatten(jax.tree.structure(shapes), spread)
    lost = [
        _fewest([np.stack(x) for x in zip(*(inputs for inputs, _ in own), strict=True)])
        - _fewest([np.stack([x for _, x in own])])
        for own in zip(*traces, strict=True)
    ]
    most = int(np.argmax(lost)) if lost else 0
    if Digits(left, "", 0.0).fewest > WHOLE - _LOSS or not lost or lost[most] <= _LOSS:
        return Digits(left, "", 0.0)
    return Digits(left, names[most], float(lost[most]))


def _digits_of(values: np.ndarray) -> np.ndarray:
    """Return the number of digits on which all runs, (runs, ...), agree, at most 7.2."""
    values = values.astype(np.complex128 if np.iscomplexobj(values) else np.float64)
    if not np.size(values):
        return np.full(values.shape[1:], WHOLE)
    with np.errstate(all="ignore"):
        error = values.std(0, ddof=1) / np.abs(values.mean(0))
        left = np.clip(-np.log10(error), 0, WHOLE)
    return np.where(np.all(values == 0, axis=0), WHOLE, left)  # NaN for results that are not finite


def _fewest(values: list[np.ndarray]) -> float:
    """Return the fewest common digits of any number that is finite in all runs."""
    found = [_digits_of(own)[~np.isnan(_digits_of(own))] for own in values]
    return min((float(own.min()) for own in found if own.size), default=WHOLE)


def _evaluate(
    jaxpr: Any, key: Any, consts: list[Any], arguments: list[Any], *, names: list[str]
) -> tuple[list[Any], list[Any]]:
    """Evaluate a jaxpr with random rounding. Return the results of the jaxpr and, for each rounded
    operation, the operands and the result. The names of these operations are appended to `names`.
    """
    known: dict[Any, Any] = dict(
        zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *arguments], strict=True)
    )
    traces: list[Any] = []

    def value(x: Any) -> Any:
        return (
            jnp.asarray(x.val, getattr(x.aval, "dtype", None))
            if isinstance(x, Literal)
            else known[x]
        )

    for number, eqn in enumerate(jaxpr.eqns):
        for kind in (getattr(x.aval, "dtype", np.float32) for x in eqn.outvars):
            if jnp.issubdtype(kind, jnp.floating) and jnp.finfo(kind).bits < 32:
                raise InputError(
                    f"digits: {_name_operation(eqn)} rounds to {kind}, whose digits are not "
                    "counted; give the function float32 alone."
                )
        own, inputs = jax.random.fold_in(key, number), [value(x) for x in eqn.invars]
        inner = next((eqn.params[word] for word in _INSIDE if word in eqn.params), None)
        if eqn.primitive.name in _AS_ONE:
            results = _run_as_one(eqn, own, inputs)
        elif inner is not None:
            open_ = getattr(inner, "jaxpr", inner)
            results, more = _evaluate(
                open_, own, list(getattr(inner, "consts", ())), inputs, names=names
            )
            traces += more
        else:
            results = _round(eqn, own, inputs)
        if inner is None or eqn.primitive.name in _AS_ONE:
            floating = [x for x in inputs if jnp.issubdtype(x.dtype, jnp.floating)]
            if results and jnp.issubdtype(results[0].dtype, jnp.floating) and floating:
                names.append(_name_operation(eqn))
                traces.append((floating, results[0]))
        known |= dict(zip(eqn.outvars, results, strict=True))
    return [value(x) for x in jaxpr.outvars], traces


def _round(eqn: Any, key: Any, inputs: list[Any]) -> list[Any]:
    """Evaluate one operation in float64 and round inexact results at random."""

    def bound(inputs: list[Any], params: dict[str, Any]) -> list[Any]:
        results = eqn.primitive.bind(*inputs, **params)
        return list(results) if eqn.primitive.multiple_results else [results]

    params = eqn.primitive.get_bind_params(eqn.params)
    native = bound(inputs, params)
    if eqn.primitive.name in ("convert_element_type", "iota") or not any(
        x.dtype in _WIDE for x in native
    ):
        return native
    wide = [x.astype(_WIDE.get(x.dtype, x.dtype)) for x in inputs]
    params = {n: None if n == "preferred_element_type" else v for n, v in params.items()}
    return [
        _round_at_random(x, own, jax.random.fold_in(key, i)) if x.dtype in _WIDE.values() else own
        for i, (x, own) in enumerate(zip(bound(wide, params), native, strict=True))
    ]


def _run_as_one(eqn: Any, key: Any, inputs: list[Any]) -> list[Any]:
    """Evaluate a loop, branch or linear solve with random rounding inside."""
    params = eqn.params

    def run(inner: Any, key: Any, arguments: list[Any]) -> list[Any]:
        return _evaluate(inner.jaxpr, key, list(inner.consts), arguments, names=[])[0]

    match eqn.primitive.name:
        case "scan":
            body = params["jaxpr"].jaxpr
            carried = _count_unstacked(eqn.outvars, body.outvars)
            ends = _count_unstacked(eqn.invars, body.invars)
            first = ends - carried

            def step(carry: Any, x: Any) -> Any:
                key, own = jax.random.split(carry[0])
                out = run(params["jaxpr"], own, [*inputs[:first], *carry[1], *x])
                return (key, out[:carried]), out[carried:]

            start = (key, inputs[first:ends])
            options = {name: params[name] for name in ("length", "reverse")}
            (_, carry), stacked = jax.lax.scan(step, start, inputs[ends:], **options)
            return [*carry, *stacked]
        case "while":
            counts = params["cond_nconsts"], params["body_nconsts"]
            of_test, of_body = inputs[: counts[0]], inputs[counts[0] : sum(counts)]

            def continues(carry: Any) -> Any:
                return run(params["cond_jaxpr"], carry[0], [*of_test, *carry[1]])[0]

            def turn(carry: Any) -> Any:
                key, own = jax.random.split(carry[0])
                return key, run(params["body_jaxpr"], own, [*of_body, *carry[1]])

            return jax.lax.while_loop(continues, turn, (key, inputs[sum(counts) :]))[1]
        case "cond":
            ways = [partial(run, branch, key) for branch in params["branches"]]
            return jax.lax.switch(jnp.int32(inputs[0]), ways, inputs[1:])
    sizes, inner = params["const_lengths"], params["jaxprs"]
    before = sizes.matvec + sizes.vecmat
    consts, right = inputs[before : before + sizes.solve], inputs[sum(sizes) :]
    return run(inner.solve, key, [*consts, *right])


def _count_unstacked(outside: list[Any], inside: list[Any]) -> int:
    """Count the constants and carries of a scan: inputs that have as many axes outside as in its
    body."""
    return sum(x.aval.ndim == y.aval.ndim for x, y in zip(outside, inside, strict=True))


def _round_at_random(exact: Any, native: Any, key: Any) -> Any:
    """Round a float64 number up or down to float32 at random. If the float32 operation itself,
    `native`, has an error above two ULP, that error is added with a random sign."""
    if jnp.iscomplexobj(exact):
        parts = zip((exact.real, exact.imag), (native.real, native.imag), (2, 3), strict=True)
        return jax.lax.complex(
            *(_round_at_random(x, y, jax.random.fold_in(key, i)) for x, y, i in parts)
        )
    smallest = float(jnp.finfo(jnp.float32).tiny)
    lost = (native == 0) & (exact != 0) & (jnp.abs(exact) < smallest)
    near, off = exact.astype(jnp.float32), native.astype(jnp.float64) - exact
    unit = jnp.abs(jnp.nextafter(near, jnp.float32(jnp.inf)) - near).astype(jnp.float64)
    sign = jax.random.rademacher(jax.random.fold_in(key, 1), exact.shape, jnp.float64)
    least = jnp.where(sign > 0, smallest * jnp.sign(exact), 0).astype(jnp.float32)
    exact = jnp.where(jnp.isfinite(off) & (jnp.abs(off) > _OWN * unit), exact + sign * off, exact)
    near = exact.astype(jnp.float32)
    rest = exact - near.astype(jnp.float64)
    other = jnp.nextafter(near, jnp.where(rest > 0, jnp.inf, -jnp.inf).astype(jnp.float32))
    gap = jnp.abs(other.astype(jnp.float64) - near.astype(jnp.float64))
    inexact = (rest != 0) & jnp.isfinite(gap) & (gap > 0)
    chance = jnp.where(inexact, jnp.maximum(jnp.abs(rest) / gap, _RARELY), 0)
    rounded = jnp.where(jax.random.uniform(key, exact.shape) < chance, other, near)
    return jnp.where(lost, least, rounded)


def _name_operation(eqn: Any) -> str:
    """Return the name of an operation, with the user's function and line."""
    traceback = eqn.source_info.traceback
    frames = traceback.frames if traceback is not None else ()
    own = next((f for f in frames if "/jax/" not in f.file_name and __file__ != f.file_name), None)
    where = "" if own is None else f" in {own.function_name}, line {own.line_num}"
    return f"{eqn.primitive.name}{where}"
