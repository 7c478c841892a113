"""Tests that every primitive has a fallback in public JAX, with the same values and derivatives, in
every program.

This file is also the program that computes them, in a separate process where the fallbacks are
forced: `python test_plain_jax.py FILE`."""

import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

PACKAGE = Path(__file__).parents[2] / "jaxvision"
FORCED = {"JAXVISION_PLAIN_JAX": "1"}
# each way to correlate, with kernels for all bands and for each: (method, border, kernel)
CORRELATIONS = [
    ("direct", "none", (3, 4, 1)),
    ("direct", "mirror", (4, 3, 2)),
    ("direct", "zero", (1, 3, 2)),
    ("conv", "wrap", (3, 2, 2)),
    ("fft", "clamp", (3, 6, 1)),
]


def derivatives(f, *arguments):
    """Return f, the gradient of sum(sin(f)), and the derivatives of both along the arguments."""

    def both(*x):
        gradient = jax.grad(lambda *x: jnp.sum(jnp.sin(f(*x))), argnums=(0, 1))
        return f(*x), gradient(*x)

    return jax.jvp(both, arguments, arguments)


def correlations():
    from jaxvision.filters._bilinear import correlate_stack

    rng = np.random.default_rng(4)
    cases = {}
    for method, border, size in CORRELATIONS:
        f = partial(correlate_stack, anchor=(0, 1), border=border, method=method)
        image, kernel = (jnp.asarray(rng.normal(size=s)) for s in ((2, 7, 6, 2), size))
        images, kernels = jnp.stack([image, -image], 3), jnp.stack([kernel, kernel**2], 2)
        cases[f"{method} {border}"] = (
            jax.jit(partial(derivatives, f))(image, kernel),
            jax.vmap(f, (3, 2))(images, kernels),
        )
    return cases


def pictures():
    """Return direct light and traced paths, with their gradients by material and position of a ball
    and by a lamp, and the derivative of direct light along them."""
    from jaxvision import (
        Lambert,
        PhongBRDF,
        Pinhole,
        PointLight,
        Quad,
        RectangleLight,
        Scene,
        Sphere,
        Surface,
        render,
    )
    from jaxvision.transport import Paths, path_traced

    floor = Surface(Quad([-2.0, -2, 0], [4.0, 0, 0], [0, 4.0, 0]), Lambert([0.2, 0.1]))
    ball = Surface(Sphere([0.3, 0.1, 0.5], 0.3), PhongBRDF([0.1, 0.2], [0.2, 0.3], 20.0))
    down = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    view = Pinhole([0.05, 0.02, 1.3], down, 1.0, 0.3, resolution=(4, 5))

    def direct(ball, lamp):
        return render(Scene([floor, ball], [lamp, PointLight([1, 0.2, 1], [2.0, 1])]), view)

    def traced(ball, lamp):
        scene = Scene([floor, ball], [lamp])
        return path_traced(jax.random.key(3), scene, view, method=Paths(2, 2)).radiance

    def gradient(picture, *x):
        return jax.value_and_grad(lambda *x: jnp.sum(picture(*x)), argnums=(0, 1))(*x)

    point = ball, PointLight([0, 0.2, 1], [1.0, 2])
    panel = ball, RectangleLight([-0.5, -0.5, 1.5], [0, 1.0, 0], [1.0, 0, 0], [3.0, 2])
    return {
        "direct": jax.jit(partial(gradient, direct))(*point),
        "slope": jax.jit(partial(jax.jvp, direct))(point, point),
        "paths": jax.jit(partial(gradient, traced))(*panel),
    }


def everything():
    """Return all numbers, each array under a name."""
    cases = {**correlations(), **pictures()}
    paths, _ = jax.tree_util.tree_flatten_with_path(cases)
    return {jax.tree_util.keystr(path): np.asarray(value) for path, value in paths}


@pytest.mark.slow
def test_the_fallbacks_give_the_same_values_and_derivatives(tmp_path):
    from jaxvision.core._loops import fusion

    if fusion.PLAIN:
        pytest.skip("nothing but the fallbacks is in use")
    file = tmp_path / "plain.npz"
    command = [sys.executable, __file__, str(file)]
    subprocess.run(command, env=os.environ | FORCED, check=True)
    with np.load(file) as plain:
        ours = everything()
        assert sorted(plain) == sorted(ours)
        for name, value in ours.items():
            size = np.abs(value).max(initial=0)
            np.testing.assert_allclose(plain[name], value, 1e-12, 1e-12 * size, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize(
    "lacks",
    [
        "del jax.interpreters.mlir.lower_fun",
        "jax.interpreters.mlir.lower_fun = lambda function: function",
        "jax.extend.core.Primitive = None",
    ],
)
def test_a_jax_with_other_internals_uses_the_fallbacks(lacks):
    program = (
        f"import jax, jax.extend.core, jax.interpreters.mlir; {lacks}\n"
        "from jaxvision.core._loops import fusion; assert fusion.PLAIN"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_the_installed_jax_has_the_internals():
    from jaxvision.core._loops import fusion

    forced = os.environ.get("JAXVISION_PLAIN_JAX", "0") not in ("", "0")
    assert fusion.PLAIN is forced


@pytest.mark.slow
def test_the_modules_own_tests_pass_with_the_fallbacks():
    files = [
        Path(__file__).parents[1] / room / f"test_{file}.py"
        for room, file in (
            ("core", "staging"),
            ("rendering", "shading"),
            ("filters", "filters"),
            ("filters", "filters_varying"),
        )
    ]
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *files]
    subprocess.run(command, env=os.environ | FORCED, check=True)


def test_two_modules_use_private_parts_of_jax():
    below = re.compile(r"jax\.(_src|interpreters|extend|experimental\.xla_metadata)\b")
    users = {
        p.relative_to(PACKAGE).as_posix()
        for p in PACKAGE.rglob("*.py")
        if below.search(p.read_text())
    }
    assert users == {"core/_loops/primitives.py", "accuracy/rounding.py"}


if __name__ == "__main__":
    from jaxvision.core._loops import fusion

    assert fusion.PLAIN
    np.savez(sys.argv[1], **everything())
