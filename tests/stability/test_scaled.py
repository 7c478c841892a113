"""Compositions at arguments of other sizes than those of `examples/`.

In each of several calls most arguments, and most fields of their records, are multiplied by their
own power of ten between -3 and 2, except unit vectors; the corners of a polygon have one factor.
The result in float32 is compared with the result in float64 for the same numbers. Its error may be
`ALLOWED` times the unavoidable error: the effect in float64 of changing the last float32 digit of
the arguments, plus the rounding of the result, each the largest in its array. So an
ill-conditioned result passes, and a formula that loses five binary digits more does not. A number
that is finite in float64, and within float32's range, must be finite.
"""

import inspect
import zlib
from fnmatch import fnmatchcase
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from public_names import traced
from registry.composed import COMPOSED
from widened import calls, in_dtype

from jaxvision import Vec

CALLS, ALLOWED = 8, 32
SHARE = 0.6  # of the arguments are scaled, from the second call on
NUDGES = 4  # directions in which the arguments change in their last digit
DIGIT = float(np.finfo(np.float32).eps) / 2
TINY, HUGE = 1e-37, 1e37  # the range of float32 with some margin

# Arguments whose size is given: points of the unit square, numbers of bits, and temperatures, with
# which a dark current doubles every few kelvin.
OF_ONE_SIZE = ("u", "*.bits", "*temperature")
# {name: (arguments that keep their size, reason)}.
KEPT = {
    "development.white_balancing.grey_world_gains": ("norm", "it must be at least 1"),
    "rendering.hemisphere_integral.hemisphere_radiance": (
        "material.*",
        "its error, a difference of two integrals, drowns in a larger part that has none",
    ),
    "lights.light_field.light_field_sample": ("light_field.[af]*", "the windows must be parallel"),
    "lights.light_field.refocus": ("light_field.[af]*", "the windows must be parallel"),
}
OWN_RULE = "its rule depends on the precision, with an error that is documented, above rounding"
# {name: reason why it is not compared}.
EXCUSED = {
    "development.jpeg_loss.jpeg": "a last digit decides to which number a coefficient rounds",
    "geometry.rays.offset_origin": "its step is in last digits of its own precision",
    "optics.distortion.undistort": "it ends within 4 eps of the larger coordinate, which may be "
    "many digits of the other, and far from the axis there is no inverse",
    "rendering.light_field.render_light_field": "it is `render`, which is compared, many times",
    "transport.radiosity.exchange.exchanged": OWN_RULE,
    "transport.radiosity.exchange.form_factor_table": OWN_RULE,
    "transport.radiosity.form_factors.parallel_exchange": OWN_RULE,
    "transport.radiosity.form_factors.perpendicular_exchange": OWN_RULE,
    "transport.radiosity.form_factors.polygon_to_polygon": "its error is a difference of two "
    "orders, which may be rounding alone",
    "transport.radiosity.solution.direct_irradiance": "`rectangle_irradiance` documents what it "
    "loses at a slant, and quads that emit are lifted by last digits of the precision",
}


def is_float(leaf):
    known = hasattr(leaf, "dtype") and not isinstance(leaf, type)
    return known and jnp.issubdtype(leaf.dtype, jnp.floating)


def is_one(x):
    """Return whether an argument is scaled as a whole: a vector, or the corners of a polygon."""
    corners = isinstance(x, list | tuple) and all(isinstance(v, Vec) for v in x)
    return isinstance(x, Vec) or (corners and len(x) > 0)


def is_direction(x):
    """Return whether an argument holds unit vectors alone."""
    if isinstance(x, Vec):
        x = np.stack([*x], axis=-1)
    vectors = hasattr(x, "shape") and x.shape[-1:] == (3,)
    return vectors and np.allclose((np.asarray(x) ** 2).sum(-1), 1, atol=2e-3)


def resized(arguments, rng, kept):
    """Return the arguments, some of whose arrays and vectors have another size."""

    def one(path, x):
        factor = 10 ** rng.uniform(-3, 2) if rng.random() < SHARE else 1.0
        place = jax.tree_util.keystr(path, simple=True, separator=".")
        if is_direction(x) or any(fnmatchcase(place, pattern) for pattern in kept):
            return x
        return jax.tree.map(lambda leaf: leaf * factor if is_float(leaf) else leaf, x)

    return jax.tree.map_with_path(one, arguments, is_leaf=is_one)


def nudged(arguments, rng):
    """Return the arguments with every number changed by about half a last digit of float32."""

    def one(x):
        return x * (1 + DIGIT * rng.standard_normal(x.shape)) if is_float(x) else x

    return jax.tree.map(one, arguments)


def named_call(name):
    """Return (arrays, settings) of the example, each by its name."""
    arguments, options = calls()[name]
    named = dict(zip(inspect.signature(traced()[name]).parameters, arguments, strict=False))
    arrays = {k: v for k, v in options.items() if any(map(eqx.is_array, jax.tree.leaves(v)))}
    return named | arrays, {k: v for k, v in options.items() if k not in arrays}


def program(name, settings, dtype):
    """Return a compiled function of the floating-point results in one precision."""
    settings = {k: dtype if k == "dtype" else v for k, v in settings.items()}
    function = partial(traced()[name], **settings)
    compiled = jax.jit(
        lambda arguments: [*filter(is_float, jax.tree.leaves(function(**arguments)))]
    )
    return lambda arguments: [
        np.asarray(leaf, np.float64) for leaf in compiled(in_dtype(arguments, dtype))
    ]


def excess(got, true, moved):
    """Return the error over the unavoidable error; infinite where a number should be finite and is
    not."""
    known = np.isfinite(true) & (np.abs(true) < HUGE)
    if not known.any():
        return 0.0
    if not np.isfinite(got[known]).all():
        return np.inf
    must = max(np.abs(m - true)[known].max() for m in moved) + 2 * DIGIT * np.abs(true[known]).max()
    return float(np.abs(got - true)[known].max() / (must + TINY))


def excesses(name, seed=0):
    """Yield (the worst excess of its results, arguments) for each call of a composition."""
    example, settings = named_call(name)
    narrow, wide = program(name, settings, jnp.float32), program(name, settings, jnp.float64)
    kept = (*OF_ONE_SIZE, KEPT[name][0]) if name in KEPT else OF_ONE_SIZE
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    for number in range(CALLS):
        arguments = resized(example, rng, kept) if number else example
        exact = in_dtype(in_dtype(arguments, jnp.float32), jnp.float64)
        got, true = narrow(exact), wide(exact)
        moved = [wide(nudged(exact, rng)) for _ in range(NUDGES)]
        ratios = map(excess, got, true, zip(*moved, strict=True))
        yield max(ratios, default=0.0), exact


def test_excluded_names_are_compositions():
    assert KEPT.keys() | EXCUSED.keys() <= COMPOSED.keys()
    assert not KEPT.keys() & EXCUSED.keys()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(COMPOSED.keys() - EXCUSED.keys()))
def test_float32_errors_at_scaled_arguments(name):
    worst, arguments = max(excesses(name), key=lambda found: found[0])
    assert worst <= ALLOWED, arguments
