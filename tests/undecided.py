"""Conditions that rounding may decide in two ways within one program.

XLA may compute a comparison twice, with and without fused multiply-adds, so that `jnp.where(c, a /
jnp.where(c, b, 1), 0)` is inconsistent where c is met to the last digit. Here a program is run
operation by operation, and each use of such a flag gets the other answer, one at a time.
"""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

_INSIDE = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # names of the parameters that hold a call's program


def _steps(closed, into, arguments):
    """Append (operation, inputs, outputs) of a program, with those of its calls in their place."""
    jaxpr, slots = closed.jaxpr, {}
    for variable, value in zip(jaxpr.constvars, closed.consts, strict=True):
        slots[variable] = ("constant", value)
    for variable, slot in zip(jaxpr.invars, arguments, strict=True):
        slots[variable] = slot

    def read(x):
        return ("constant", x.val) if isinstance(x, Literal) else slots[x]

    for eqn in jaxpr.eqns:
        inside = next((eqn.params[name] for name in _INSIDE if name in eqn.params), None)
        if inside is not None and eqn.primitive.name not in ("while", "scan"):
            if not hasattr(inside, "consts"):
                inside = ClosedJaxpr(inside, ())
            found = _steps(inside, into, [read(x) for x in eqn.invars])
        else:
            found = [("slot", (len(into), k)) for k in range(len(eqn.outvars))]
            into.append((eqn, [read(x) for x in eqn.invars]))
        for variable, slot in zip(eqn.outvars, found, strict=True):
            slots[variable] = slot
    return [read(x) for x in jaxpr.outvars]


def _run(steps, results, arguments, changed=None):
    """Return the results and all values. `changed`: (step, input) -> array that this use gets
    instead."""
    values: dict = {("argument", i): x for i, x in enumerate(arguments)}

    def read(slot):
        return slot[1] if slot[0] == "constant" else values[slot]

    for i, (eqn, inputs) in enumerate(steps):
        given = [read(slot) for slot in inputs]
        for (step, place), value in (changed or {}).items():
            if step == i:
                given[place] = value
        out = eqn.primitive.bind(*given, **eqn.params)
        out = out if eqn.primitive.multiple_results else [out]
        for k, x in enumerate(out):
            values["slot", (i, k)] = x
    return [read(slot) for slot in results], values


def moved(arguments, ulps):
    """Return the arguments, each moved by some units in the last place in every combination along
    their first axis, and the index of those not moved."""
    ways = [*product(ulps, repeat=len(arguments))]
    steps = np.array(ways, np.float64).T.reshape(len(arguments), -1, *(1,) * arguments[0].ndim)
    stacks = [
        jnp.asarray(np.asarray(x, np.float64) + n * np.spacing(np.asarray(x)), x.dtype)
        for x, n in zip(arguments, steps, strict=True)
    ]
    return stacks, ways.index((0,) * len(arguments))


def disagreements(function, *arguments, ulps=(-2, -1, 0, 1, 2), within=1e-3):
    """Return (the number of flags that these arguments decide to the last digit, messages for uses
    whose other answer gives a result outside those of the neighbours by more than `within` of
    them).

    The neighbours are the arguments moved by a few units in the last place."""
    arguments = [jnp.asarray(x) for x in arguments]
    closed = jax.make_jaxpr(function)(*arguments)
    steps = []
    results = _steps(closed, steps, [("argument", i) for i in range(len(arguments))])
    neighbours, home = moved(arguments, ulps)

    def near(*neighbour):
        own, values = _run(steps, results, neighbour)
        return own, {slot: value for slot, value in values.items() if value.dtype == bool}

    own, decided = jax.vmap(near)(*neighbours)
    low, high = ([reduce(b) for b in own] for reduce in (np.fmin.reduce, np.fmax.reduce))
    decided = {slot: np.asarray(value) for slot, value in decided.items()}
    flags = {slot: (value != value[home]).any(axis=0) for slot, value in decided.items()}
    flags = {slot: differs for slot, differs in flags.items() if differs.any()}
    uses = [
        (i, place, slot)
        for i, (eqn, inputs) in enumerate(steps)
        if eqn.primitive.name == "select_n" or all(v.aval.dtype != bool for v in eqn.outvars)
        for place, slot in enumerate(inputs)
        if slot[0] != "constant" and slot in flags
    ]
    # as many uses at once as there are neighbours, for which the operations are compiled already
    count, wrong = len(neighbours[0]), []
    for first in range(0, len(uses), count):
        part, others = uses[first : first + count], {}
        for k, (i, place, slot) in enumerate(part):
            others[i, place] = np.repeat(decided[slot][home][None], count, axis=0)
            others[i, place][k] ^= flags[slot]
        same = [jnp.broadcast_to(x, (count, *x.shape)) for x in arguments]
        others = {use: jnp.asarray(value) for use, value in others.items()}
        got = jax.vmap(lambda others, *x: _run(steps, results, x, others)[0])(others, *same)
        for k, (i, _, _) in enumerate(part):
            for a, b, c in zip((np.asarray(x)[k] for x in got), low, high, strict=True):
                scale = within * np.maximum(np.abs(b), np.abs(c))
                good = (a >= b - scale) & (a <= c + scale) | (np.isnan(a) & np.isnan(b))
                if not good.all():
                    wrong.append(f"{steps[i][0].primitive} {i}: {a} beyond {b} to {c}")
    return len(flags), wrong
