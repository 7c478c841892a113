"""Measured BRDF tables at difficult angles, in both precisions: on the normal, at wi = wo, at
grazing angles, on nodes and beyond them. Values are compared with 50-digit results; gradients are
finite.
"""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import exact
from oracles import measured as oracle
from precisions import both_precisions, eps

from jaxvision import Vec, as_dtype, brdf
from jaxvision.brdf.half_difference import (
    HalfDifferenceTable,
    from_half_difference,
    half_difference,
)
from jaxvision.brdf.measured import AnisotropicTable, IsotropicTable, tabulate_sampler
from jaxvision.brdf.rgl import rgl_material

RNG = np.random.default_rng(5)


def at(theta, phi):
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


AWKWARD = {
    "both on the normal": (at(0, 0), at(0, 0)),
    "a hair from the normal": (at(1e-6, 0.3), at(2e-6, 1.0)),
    "the same direction": (at(0.8, 0.4), at(0.8, 0.4)),
    "nearly the same": (at(0.8, 0.4), at(0.8 + 1e-6, 0.4)),
    "mirror pair": (at(0.8, 0.4), at(0.8, 0.4 + np.pi)),
    "mirror pair at grazing": (at(1.5707, 0), at(1.5707, np.pi)),
    "both grazing": (at(1.5707, 0), at(1.5707, 2.0)),
    "one on the horizon": (np.array([1.0, 0, 0]), at(0.5, 0)),
    "one below": (at(2.0, 0), at(0.5, 0)),
    "opposite": (at(0.5, 0), -at(0.5, 0)),
    "azimuth of half a turn": (at(0.5, np.pi), at(0.7, -np.pi)),
}


def materials(dtype):
    theta, phi = np.array([0.0, 0.6, 1.2]), np.array([0.0, 2.0])
    random = RNG.uniform(0.1, 1, (3, 3, 2, 1))
    fields = oracle.rgl_fields(np.random.default_rng(1), thetas=3, side=3, fine=9)
    table = {name: jnp.asarray(x, dtype) for name, x in fields.items()}
    made = {
        "isotropic": IsotropicTable(theta, theta, phi, random, outside="extrapolate"),
        "anisotropic": AnisotropicTable(
            theta, phi, theta, phi, RNG.uniform(0.1, 1, (3, 2, 3, 2, 1)), outside="zero"
        ),
        "rgl": rgl_material(
            table["theta_i"],
            table["phi_i"],
            jnp.moveaxis(table["rgb"], 2, -1),
            table["ndf"],
            table["sigma"],
            table["vndf"],
            table["luminance"],
        ),
    }
    made = {name: as_dtype(m, dtype) for name, m in made.items()}
    plain = as_dtype(HalfDifferenceTable(RNG.uniform(0.1, 1, (4, 3, 2, 1))), dtype)
    return made | {"half difference": tabulate_sampler(plain, thetas=2, rows=5, columns=9)}


@pytest.mark.slow
@both_precisions
def test_values_and_gradients_are_finite_at_degenerate_pairs(dtype):
    wi, wo = (jnp.asarray(np.array(w), dtype) for w in zip(*AWKWARD.values(), strict=True))
    u = jnp.asarray([[0.0, 0.0, 0.9], [0.5, 0.25, 0.9], [1 - eps(dtype), 1 - eps(dtype), 0.9]])
    u = u.astype(dtype)
    for name, material in materials(dtype).items():

        def everything(material, wi, wo):
            drawn = jax.vmap(lambda v, wo=wo: brdf.sample(material, wo, v))(u)
            made = brdf.evaluate(material, wi, wo), brdf.pdf(material, wi, wo), drawn
            return sum(x.sum() for x in jax.tree.leaves(made)), made

        both = jax.value_and_grad(everything, (0, 1, 2), has_aux=True)
        (_, value), gradient = jax.jit(jax.vmap(both, (None, 0, 0)))(material, wi, wo)
        for leaf in jax.tree.leaves((value, gradient)):
            assert leaf.dtype == dtype
            assert jnp.isfinite(leaf).all(), name
        reflected, density, drawn = value
        assert (reflected >= 0).all()
        assert (density >= 0).all()
        np.testing.assert_allclose(jnp.linalg.norm(drawn, axis=-1), 1, atol=8 * eps(dtype))
        below = [list(AWKWARD).index(k) for k in ("one on the horizon", "one below", "opposite")]
        assert (reflected[jnp.asarray(below)] == 0).all()


def exact_half_difference(wi, wo):
    """Return theta_h, theta_d, phi_d of the same floating-point vectors in 50 digits."""
    i, o = exact.vector(wi), exact.vector(wo)
    i, o = (mp.matrix(v) / mp.norm(mp.matrix(v)) for v in (i, o))
    h = (i + o) / mp.norm(i + o)
    theta_h, phi_h = mp.atan2(mp.hypot(h[0], h[1]), h[2]), mp.atan2(h[1], h[0])
    x, y = mp.cos(phi_h) * i[0] + mp.sin(phi_h) * i[1], mp.cos(phi_h) * i[1] - mp.sin(phi_h) * i[0]
    x, z = (
        mp.cos(theta_h) * x - mp.sin(theta_h) * i[2],
        mp.sin(theta_h) * x + mp.cos(theta_h) * i[2],
    )
    return theta_h, mp.atan2(mp.hypot(x, y), z), mp.atan2(y, x)


@both_precisions
@pytest.mark.parametrize("apart", [1e-3, 1e-5, 0.3])
def test_small_half_and_difference_angles_keep_their_digits(dtype, apart):
    """The angles are right where the arccosine of a cosine loses all digits."""
    one = jax.jit(half_difference)
    for phi in (0.3, 2.0, -1.1):
        wi = jnp.asarray(at(0.7 + apart, phi), dtype)
        wo = jnp.asarray(at(0.7 - apart / 3, phi + np.pi + apart), dtype)
        found, truth = one(wi, wo), exact_half_difference(wi, wo)
        assert abs(float(found.theta_h) - float(truth[0])) < 4 * eps(dtype)
        assert abs(float(found.theta_d) - float(truth[1])) < 4 * eps(dtype)
        assert abs(float(found.phi_d) - float(truth[2])) < 8 * eps(dtype) * (1 + 1 / apart)

        near = jnp.asarray(at(0.7, phi), dtype), jnp.asarray(at(0.7 + apart, phi), dtype)
        found, truth = one(*near), exact_half_difference(*near)
        assert abs(float(found.theta_d) - float(truth[1])) < 4 * eps(dtype)


@both_precisions
def test_difference_angles_round_trip_at_degenerate_pairs(dtype):
    """For theta_h and theta_d near 0 and near a right angle, the round trip is right to some
    eps."""
    there = jax.jit(from_half_difference)
    back = jax.jit(half_difference)
    for wi, wo in AWKWARD.values():
        if np.allclose(wi, -wo):
            continue
        wi, wo = jnp.asarray(wi, dtype), jnp.asarray(wo, dtype)
        again = there(back(wi, wo))
        for new, old in zip(again, (wi, wo), strict=True):
            assert isinstance(new, Vec)
            np.testing.assert_allclose([new.x, new.y, new.z], old, atol=16 * eps(dtype))


@pytest.mark.slow
def test_sampling_a_density_with_zeros():
    """With rows, columns and a whole slice of zeros in the tables, samples lie where the density is
    positive."""
    dtype = jnp.float32
    fields = oracle.rgl_fields(np.random.default_rng(1), thetas=2, side=4, fine=9)
    fields["luminance"][:, :, 1:3] = 0
    fields["luminance"][:, :, :, 2:] = 0
    fields["vndf"][:, 1] = 0
    table = {name: jnp.asarray(x, dtype) for name, x in fields.items()}
    material = rgl_material(
        table["theta_i"],
        table["phi_i"],
        jnp.moveaxis(table["rgb"], 2, -1),
        table["ndf"],
        table["sigma"],
        table["vndf"],
        table["luminance"],
    )
    wo = jnp.asarray(at(0.3, 0.2), dtype)
    u = jnp.asarray(RNG.random((500, 3)), dtype)
    wi = jax.jit(jax.vmap(brdf.sample, (None, None, 0)))(material, wo, u)
    density = jax.jit(jax.vmap(brdf.pdf, (None, 0, None)))(material, wi, wo)
    ahead = wi @ wo > -1 + 1e-3  # not drawn through the back of a half vector
    assert ahead.mean() > 0.9
    assert (density[ahead & (wi[:, 2] > 0)] > 0).mean() > 0.999
