"""Tests that NaN in gives NaN out, for every public function of numbers, with the calls of
`examples/`. Each argument is made NaN as a whole, which must affect the result, and one number at a
time, which must affect each number of the result that another finite value there would change."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from examples import ROOMS, examples_of
from public_names import traced

# Modules where rays decide by comparisons, which are false for NaN, and the beginnings of names
# that are tested nevertheless.
RAYS = {
    "geometry": (),
    "light_to_numbers": (),
    "lights": (),
    "radiosity": ("transport.radiosity.form_factors.",),
    "transport": (),
}
# Functions that define their result for NaN, or compare a number with a random draw, with their
# arguments. A draw whose probability is NaN is not taken.
EXCEPTIONS = {
    "brdf.dichromatic.sample": ("body", "interface"),
    "brdf.evaluation.sample": ("diffuse", "specular"),
    "brdf.rgl.albedo": ("vndf",),  # inverted by a search
    "brdf.rgl.sample": ("vndf", "luminance", "[2]"),
    "brdf.torrance_sparrow.sample": ("diffuse", "specular", "interface"),
    "development.white_balancing.neutral_gains": ("[0] number",),  # NaN is a missing pixel
    "histogram.counts.soft_histogram": ("[0]",),  # counted in no bin
    "histogram.equalisation.equalise": ("[0] number",),  # NaN does not count for other pixels
    "histogram.local_equalisation.equalise_locally": ("[0] number",),
    "histogram.matching.match_histogram": ("[0] number",),
    "optics.defocus.chromatic_defocus": ("[2]",),  # a depth of NaN is in focus
    "optics.defocus.gather_defocus": ("[2]",),
    "optics.defocus.layered_defocus": ("[2]",),
    "optics.defocus.scatter_defocus": ("[2]",),
    "point_ops.tone_mapping.scaled_to_key": ("[0] number",),  # excluded from the mean
    "sensor.fixed_pattern.hot_rates": ("fraction",),
    "sensor.fixed_pattern.sensitivity": ("dead_pixels",),
    "sensor.raw.collect": ("dead_pixels", "hot_pixels", "fraction"),
    "sensor.raw.raw_image": ("dead_pixels", "hot_pixels", "fraction"),
    "sensor.read_out.read_out_noise": ("fraction",),
}
# SciPy solvers refuse numbers that are not finite.
REFUSE = {"development.colour_matrix.camera_colour", "development.colour_matrix.fit_colour_matrix"}


WHOLE = -1  # all numbers of an argument
ROUNDING = 1e-6  # of the largest number in a result


def is_float(leaf):
    return jnp.issubdtype(leaf.dtype, jnp.floating)


def read_inputs(jaxpr, wanted):
    """Return which inputs of a program its `wanted` outputs depend on."""
    needed = {v for v, is_wanted in zip(jaxpr.outvars, wanted, strict=True) if is_wanted}
    needed = {v for v in needed if isinstance(v, jax.extend.core.Var)}
    for equation in reversed(jaxpr.eqns):
        used = [v in needed for v in equation.outvars]
        if not any(used):
            continue
        inputs = [True] * len(equation.invars)
        inner = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
        if equation.primitive.name in ("jit", "pjit", "custom_jvp_call") and inner is not None:
            inputs = read_inputs(inner.jaxpr, used)
        needed |= {
            v
            for v, is_read in zip(equation.invars, inputs, strict=True)
            if is_read and isinstance(v, jax.extend.core.Var)
        }
    return [v in needed for v in jaxpr.invars]


def swallowed(function, arguments):
    """Return the names of floating-point arguments that the function reads without passing on a NaN
    in all numbers or in one."""
    paths, structure = jax.tree_util.tree_flatten_with_path(arguments)
    leaves = [leaf for _, leaf in paths]
    numbers = [i for i, leaf in enumerate(leaves) if is_float(leaf) and leaf.size]

    def results(leaves):
        found = jax.tree.leaves(function(*jax.tree.unflatten(structure, leaves)))
        return [x for x in found if is_float(x)]

    def changed(case):
        """Return the results with one argument, or one number in it, multiplied by a factor."""
        argument, number, factor = case
        broken = list(leaves)
        for i in numbers:
            at = jnp.arange(leaves[i].size).reshape(leaves[i].shape)
            meant = (argument == i) & ((number == WHOLE) | (number == at))
            broken[i] = jnp.where(meant, factor.astype(leaves[i].dtype), 1) * leaves[i]
        return results(broken)

    program = jax.make_jaxpr(results)(leaves).jaxpr
    is_read = read_inputs(program, [True] * len(program.outvars))
    numbers = [i for i in numbers if is_read[i]]
    if not numbers:
        return []
    cases = [
        (i, number, factor)
        for i in numbers
        for number in (WHOLE, *sorted({k * (leaves[i].size - 1) // 3 for k in range(4)}))
        for factor in (np.nan, 0.9, 1.1)
    ]
    columns = tuple(jnp.asarray(column) for column in zip(*cases, strict=True))
    found = jax.jit(lambda: jax.lax.map(changed, columns))()
    found = {case: [np.asarray(x[k]) for x in found] for k, case in enumerate(map(str, cases))}
    names = [jax.tree_util.keystr(path) for path, _ in paths]
    wrong = []
    for i, number, factor in cases:
        if not np.isnan(factor):
            continue
        broken, low, high = (found[str((i, number, f))] for f in (factor, 0.9, 1.1))
        if number == WHOLE:
            came = any(np.isnan(x).any() for x in broken)
        else:
            came = all(
                np.isnan(x)[moves(a, b)].all() for x, a, b in zip(broken, low, high, strict=True)
            )
        if not came:
            wrong.append(names[i] + ("" if number == WHOLE else f" number {number}"))
    return wrong


def moves(low, high):
    """Return where two results differ by more than rounding."""
    known = np.isfinite(low) & np.isfinite(high)
    apart = np.abs(np.where(known, high - low, 0))
    return apart > ROUNDING * np.max(np.abs(np.where(known, low, 0)), initial=0)


def faults(calls):
    known, wrong = traced(), {}
    for name, (arguments, options) in calls.items():
        lost = swallowed(partial(known[name], **options), arguments)
        excused = EXCEPTIONS.get(name, ())
        lost = [place for place in lost if not any(word in place for word in excused)]
        if lost:
            wrong[name] = lost
    return wrong


@pytest.mark.slow
@pytest.mark.parametrize("room", sorted(ROOMS))
def test_nan_in_gives_nan_out(room):
    swept = RAYS.get(room, ("",))
    calls = {n: call for n, call in examples_of(room).items() if n not in REFUSE}
    wrong = faults({n: call for n, call in calls.items() if n.startswith(swept)})
    assert not wrong, wrong
