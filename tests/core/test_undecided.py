"""Tests conditions that rounding leaves undecided. Whichever branch each of their uses takes, the
value and the gradient are those of inputs a few ULP away."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from undecided import disagreements

import jaxvision as jv
from jaxvision.brdf._lobe import diffuse_share, log_cosine
from jaxvision.brdf.fresnel import fresnel_conductor, fresnel_dielectric
from jaxvision.brdf.gaussian_lobe import squared_angle_between
from jaxvision.brdf.microfacet import normal_distribution
from jaxvision.core import _numerics
from jaxvision.core._monotone import monotone_slopes as _monotone_slopes
from jaxvision.geometry._triangle import triangle_distance
from jaxvision.geometry.hemisphere import local_frame
from jaxvision.lights.polygon import _slopes
from jaxvision.lights.window import _map_interval
from jaxvision.optics import aperture, overlap
from jaxvision.sensor.moments import Moments, censored
from jaxvision.sensor.sampling import _sinc
from jaxvision.transport.radiosity import form_factors


def _distribution(x, z):
    h = jv.Vec(x, jnp.zeros_like(x), z)
    return normal_distribution(h, jnp.ones(2, x.dtype), distribution="beckmann")


def _edge_on(x, z):
    """Intersect a ray with a triangle whose plane nearly contains the ray, 0.1 by 0.2 of a length
    from its origin."""
    ray = jv.Ray(jv.Vec(*(jnp.zeros_like(x),) * 3), jv.Vec(*jnp.eye(3, dtype=x.dtype)[2]))
    corners = ([x, -0.1, 1.0], [x, 0.1, 1.0], [x + z, 0.0, 1.5])
    corners = [jv.Vec(*(jnp.asarray(c, x.dtype) for c in corner)) for corner in corners]
    return triangle_distance(ray, local_frame(ray.direction), *corners)


def _angle(x):
    zero, one = 0 * x, 1 + 0 * x
    return squared_angle_between(jv.Vec(one, x - 0.5, zero), jv.Vec(zero, one, zero))


def _censored(low, high):
    return censored(Moments(0 * low, 1 + 0 * low), low=low, high=high).mean


def _just_met(dtype):
    """Return the smallest slant at which a ray hits that triangle."""
    low, high = 0.0, 1e-3
    for _ in range(100):
        middle = jnp.asarray((low + high) / 2, dtype)
        if middle in (low, high):
            break
        with jax.disable_jit():
            meets = _edge_on(jnp.zeros_like(middle), middle) < jnp.inf
        low, high = (low, float(middle)) if meets else (float(middle), high)
    return 0.0, high


CRITICAL = float(np.sqrt(1 - 1 / 1.5**2))  # critical angle of glass, from inside
# (function of one or two numbers, numbers at which one of its conditions is decided by the last
# digit)
CASES = {
    "safe_sqrt": (lambda x, y: _numerics.safe_sqrt(x * x - y * y), (0.6, 0.6)),
    "power": (lambda x, y: _numerics.power(x - y, jnp.asarray(0.5, x.dtype)), (0.6, 0.6)),
    "log1p": (_numerics.log1p, (-0.25,)),
    "log_cosine": (log_cosine, (1.0,)),
    "diffuse_share": (lambda a, b: diffuse_share(a[None], b[None]), (0.3, 0.3)),
    "fresnel_dielectric": (lambda c, n: fresnel_dielectric(c, n[None])[0], (CRITICAL, 1 / 1.5)),
    "fresnel_conductor": (lambda n: fresnel_conductor(1.0, n[None], 0 * n[None])[0], (2 + 3**0.5,)),
    "squared_angle_between": (_angle, (0.5,)),
    "normal_distribution": (_distribution, (1.0, 1e-5)),
    "monotone_slopes": (
        lambda x, y: _monotone_slopes(jnp.arange(3.0, dtype=x.dtype), jnp.stack([x, y, y + 1]))[1],
        (0.3, 0.3),
    ),
    "triangle_distance": (_edge_on, None),
    "angle_over_sine": (lambda s, c: _slopes(s, c, c)[0], (0.03 * 0.36, 0.6)),
    "spread": (lambda x: _map_interval(x - 0.3, x / x, x / x).span, (0.3,)),
    "segment": (overlap._segment, (1.0,)),
    "overlap_of_discs": (lambda d, r: overlap.overlap_of_discs(d, r, r / 2), (0.3, 0.6)),
    "mean_within": (lambda a, b: aperture._mean_within(a, b, jnp.zeros_like(a)), (1.0, 0.5)),
    "mean_within, at both": (
        lambda a, b: aperture._mean_within(a - 0.6, b, jnp.zeros_like(a)),
        (0.6, 1.0),
    ),
    "image_distance": (jv.image_distance, (0.1, 0.05)),
    "working_f_number": (
        lambda z, f: jv.optics.working_f_number(jnp.asarray(8.0, z.dtype), z, f),
        (0.1, 0.05),
    ),
    "vergence_difference": (jv.optics.vergence_difference, (0.1, 0.05)),
    "gain": (lambda x: form_factors._gain(x, x), (0.3,)),
    "log_remaining": (lambda x: form_factors._log_remaining(x, 1 - x), (0.5,)),
    "sinc": (jax.grad(lambda x: _sinc(x)), (0.5,)),
    "censored": (_censored, (0.0, 0.5)),
    "censored, single": (_censored, (0.0, 1.0)),
    "log_curve": (jv.point_ops.log_curve, (0.5, 2.0)),
    "log_curve, both small": (jv.point_ops.log_curve, (0.9, 0.1)),
    "srgb_encode": (jv.srgb_encode, (0.0031308,)),
    "srgb_decode": (jv.srgb_decode, (0.04045,)),
}
COSTLY = {"monotone_slopes", "fresnel_conductor", "triangle_distance", "censored", "safe_sqrt"}
DECIDED = {("log1p", "float32"), ("censored", "float32"), ("censored, single", "float64")}


@pytest.mark.parametrize("dtype", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", CASES)
@pytest.mark.sweep(*(name for name in CASES if name not in COSTLY))
def test_an_undecided_condition_does_not_matter(name, dtype):
    function, numbers = CASES[name]
    with jax.enable_x64(dtype == "float64"):
        numbers = _just_met(dtype) if numbers is None else numbers
        numbers = [jnp.asarray(x, dtype) for x in numbers]
        value = disagreements(function, *numbers)
        # in reverse mode the branches of `where` are added, so both or neither may count
        places = tuple(range(len(numbers)))
        function = jax.jacfwd(lambda *x, of=function: jnp.sum(of(*x)), argnums=places)
        taken = name != "triangle_distance"  # its gradient is not used
        slope = disagreements(function, *numbers, within=0.02) if taken else (0, [])
    (flags, wrong), (of_slope, wrong_slopes) = value, slope
    assert flags + of_slope > 0 or (name, dtype) in DECIDED, "the numbers decide no condition"
    wrong += wrong_slopes
    assert not wrong, wrong
