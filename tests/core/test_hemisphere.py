"""Tests that local frames are right-handed and orthonormal for every normal, and that quadrature
nodes and samples integrate."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxvision.core._vector import Vec, as_array, as_vec
from jaxvision.geometry import hemisphere as hs

RNG = np.random.default_rng(8)


def test_a_vector_is_taken_apart_and_put_together():
    v = Vec(*jnp.arange(6.0).reshape(3, 2))
    x, y, z = v
    assert (x is v.x, y is v.y, z is v.z) == (True, True, True)
    np.testing.assert_array_equal(as_array(Vec(*v)), as_array(v))


def test_a_vector_over_a_number():
    v = Vec(*jnp.arange(6.0).reshape(3, 2))
    for divisor in (4.0, jnp.array([2.0, 0.5])):
        np.testing.assert_array_equal(as_array(v / divisor), as_array(v * (1 / divisor)))


def test_zeros_are_printed_without_a_sign():
    """Duff's formula gives some negative zeros."""
    frame = hs.local_frame(jnp.array([0.0, 0.0, 1.0]))
    assert str(frame.tangent) == "Vec(x=1, y=0, z=0)"
    assert str(frame.bitangent) == "Vec(x=0, y=1, z=0)"


def matrix(frame):
    """Return the matrix with rows tangent, bitangent and normal."""
    return np.stack([as_array(v) for v in (frame.tangent, frame.bitangent, frame.normal)])


def normals(dtype):
    """Return random normals, the six axes, and normals near the south pole, where an older formula
    fails."""
    around = RNG.normal(size=(50, 3))
    south = np.stack([[1e-4 * np.cos(a), 1e-4 * np.sin(a), -1] for a in np.linspace(0, 6, 12)])
    every = np.concatenate([around, np.eye(3), -np.eye(3), south, [[1e-8, 0, -1]]])
    return jnp.asarray(every / np.linalg.norm(every, axis=1, keepdims=True), dtype)


@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("tangent", [None, [0.3, -0.8, 0.1], [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]])
def test_frames_are_orthonormal_and_right_handed(dtype, tangent):
    wanted = None if tangent is None else jnp.asarray(tangent, dtype)
    frames = jax.vmap(lambda n: hs.local_frame(n, tangent=wanted))(normals(dtype))
    rows = np.moveaxis(matrix(frames), 0, 1)
    assert rows.dtype == dtype
    error = 30 * jnp.finfo(dtype).eps
    products = rows @ rows.transpose(0, 2, 1)
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), products.shape), atol=error)
    np.testing.assert_allclose(np.linalg.det(rows.astype(float)), 1, atol=error)


def test_the_tangent_is_the_nearest_to_the_wanted_one():
    normal = jnp.asarray([0.0, 0.6, 0.8])
    frame = hs.local_frame(normal, tangent=jnp.asarray([2.0, 1.0, -3.0]))
    wanted = np.array([2.0, 1.0, -3.0])
    across = wanted - (wanted @ np.asarray(normal)) * np.asarray(normal)
    np.testing.assert_allclose(as_array(frame.tangent), across / np.linalg.norm(across), rtol=1e-14)


def test_to_the_frame_and_back():
    frame = hs.local_frame(jnp.asarray([0.36, 0.48, 0.8]), tangent=jnp.asarray([1.0, 0.0, 0.0]))
    w = jnp.asarray(RNG.normal(size=3))
    local = hs.to_local(frame, w)
    np.testing.assert_allclose(local, matrix(frame) @ np.asarray(w), rtol=1e-13)
    np.testing.assert_allclose(hs.to_world(frame, local), w, rtol=1e-13)
    assert isinstance(hs.to_world(frame, as_vec(local)), Vec)


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["cosine", "uniform"])
def test_samples_follow_their_density(kind):
    """For a cosine density cos^2 is uniform, and for a uniform density cos. The azimuth is uniform
    for both."""
    u = jnp.asarray(RNG.uniform(size=(20_000, 2)))
    w = jax.vmap(getattr(hs, f"{kind}_direction"))(u)
    np.testing.assert_allclose(w.x**2 + w.y**2 + w.z**2, 1, rtol=1e-12)
    polar = w.z**2 if kind == "cosine" else w.z
    turn = (np.arctan2(w.y, w.x) / (2 * np.pi)) % 1
    for sample in (polar, turn):
        assert stats.kstest(np.asarray(sample), "uniform").pvalue > 1e-4
    assert abs(stats.pearsonr(polar, turn).statistic) < 0.03
    nodes, weights = hs.product_nodes(8, 16)
    density = jax.vmap(getattr(hs, f"{kind}_pdf"))(jnp.asarray(nodes))
    np.testing.assert_allclose(weights @ density, 1, rtol=1e-13)
    assert getattr(hs, f"{kind}_pdf")(jnp.asarray([0.6, 0.0, -0.8])) == 0


@pytest.mark.sweep
@pytest.mark.parametrize(("polar", "azimuths"), [(1, 1), (4, 8), (16, 33)])
def test_product_nodes_integrate_polynomials_exactly(polar, azimuths):
    """The exact integrals of x^a y^b z^c over the hemisphere are given by Gamma functions."""
    from scipy.special import gamma

    nodes, weights = hs.product_nodes(polar, azimuths)
    np.testing.assert_allclose(weights.sum(), 2 * np.pi, rtol=1e-14)
    np.testing.assert_allclose((nodes**2).sum(axis=1), 1, rtol=1e-14)
    degree = min(2 * polar - 1, azimuths - 1)
    for a in range(degree + 1):
        for b in range(degree + 1 - a):
            for c in range(degree + 1 - a - b):
                exact = 0.0
                if a % 2 == 0 and b % 2 == 0:
                    halves = gamma((a + 1) / 2) * gamma((b + 1) / 2) * gamma((c + 1) / 2)
                    exact = halves / gamma((a + b + c + 3) / 2)
                got = weights @ (nodes[:, 0] ** a * nodes[:, 1] ** b * nodes[:, 2] ** c)
                np.testing.assert_allclose(got, exact, rtol=1e-11, atol=1e-13)


def test_no_nodes_is_an_error():
    with pytest.raises(ValueError, match=r"at least 1, got 0 and 4"):
        hs.product_nodes(0, 4)


def test_a_direction_near_the_axis_keeps_its_digits():
    """For 1 - cos = 1e-10 in float32, sin = sqrt(2e-10). Computed from cos(theta) it would round to
    0."""
    w = hs.direction_at(jnp.float32(1e-10), jnp.float32(0))
    np.testing.assert_allclose(w.x, np.sqrt(2e-10), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_gradients_are_finite_at_the_edges(dtype):
    edges = jnp.asarray([[0, 0, 1], [0, 0, -1], [0, 0, 0]], dtype)

    def slopes(function, *batches):
        """Return the Jacobian of a function of arrays, for all combinations of the given rows."""
        slope = jax.jacobian(lambda *v: as_array(function(*v)), argnums=range(len(batches)))
        for i in range(len(batches)):
            slope = jax.vmap(
                slope, in_axes=tuple(0 if i == j else None for j in range(len(batches)))
            )
        return jax.jit(slope)(*batches)

    found = [
        slopes(lambda n: hs.local_frame(n).tangent, edges),
        slopes(lambda n, t: hs.local_frame(n, tangent=t).bitangent, edges, edges),
        slopes(hs.cosine_direction, jnp.asarray([[0, 0], [1, 1]], dtype)),
        slopes(hs.uniform_direction, jnp.asarray([[0, 0], [1, 1]], dtype)),
    ]
    assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
