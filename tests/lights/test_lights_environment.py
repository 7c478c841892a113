"""Tests the environment map: its orientation, its samples against their density, and its
irradiance."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxvision import InputError, MonteCarlo, Quadrature, environment_map
from jaxvision.files.images import read_environment, write_image
from jaxvision.geometry.hemisphere import product_nodes
from jaxvision.lights import direction_pdf, direction_sample, irradiance, radiance_from
from jaxvision.lights.environment import environment_radiance
from jaxvision.lights.harmonics import harmonic_irradiance, harmonics, irradiance_coefficients

H, W = 8, 16
RNG = np.random.default_rng(8)
PICTURE = RNG.gamma(0.5, size=(H, W, 2))
POINT = np.zeros(3)
look, smooth = jax.jit(environment_radiance), jax.jit(harmonic_irradiance)


@cache
def painted():
    return environment_map(PICTURE)


def toward(theta, phi):
    return jnp.asarray([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def pixel(row, column):
    """Return the direction of a pixel's centre, from the documented convention."""
    return toward(np.pi * (row + 0.5) / H, np.pi - 2 * np.pi * (column + 0.5) / W)


def sphere(polar, azimuths):
    """Return directions and weights over the whole sphere."""
    up, weights = product_nodes(polar, azimuths)
    return np.concatenate([up, up * [1, 1, -1]]), np.concatenate([weights, weights])


@pytest.mark.parametrize(("row", "column"), [(0, 0), (3, 7), (4, 15), (7, 8)])
def test_pixel_centres_are_the_samples(row, column):
    np.testing.assert_allclose(
        look(painted(), pixel(row, column)), PICTURE[row, column], rtol=1e-12
    )


def test_orientation():
    """The middle column is +x, a quarter of the width to the left +y, and the top row +z."""
    picture = np.zeros((H, W, 1))
    picture[3:5, 7:9] = 1  # around the centre
    np.testing.assert_allclose(look(environment_map(picture), np.eye(3)[0]), 1, rtol=1e-12)
    left = np.roll(picture, -W // 4, axis=1)
    np.testing.assert_allclose(look(environment_map(left), np.eye(3)[1]), 1, rtol=1e-12)
    top = np.zeros((H, W, 1))
    top[0] = 1
    np.testing.assert_allclose(look(environment_map(top), np.eye(3)[2]), 1, rtol=1e-12)


def test_rotation_rotates_the_map():
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])  # the map's x axis is the world's z axis
    turned = environment_map(PICTURE, rotation=turn)
    for d in (toward(0.4, 1.0), toward(2.0, -2.0)):
        np.testing.assert_allclose(look(turned, turn.T @ d), look(painted(), d), rtol=1e-12)
        drawn = direction_sample(turned, POINT, jnp.asarray([0.3, 0.7])).direction
        straight = direction_sample(painted(), POINT, jnp.asarray([0.3, 0.7])).direction
        np.testing.assert_allclose(drawn, turn.T @ straight, rtol=1e-12)


def test_no_discontinuity_at_the_seam_and_the_poles():
    for angle in (0.1, 1.3, 2.9):
        a, b = toward(angle, np.pi - 1e-9), toward(angle, -np.pi + 1e-9)
        np.testing.assert_allclose(look(painted(), a), look(painted(), b), rtol=1e-6)
    for pole in (0.0, np.pi):
        a, b = toward(pole + 1e-9, 0.7), toward(pole - 1e-9, 0.7)
        np.testing.assert_allclose(look(painted(), a), look(painted(), b), rtol=1e-6)


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["rough", "one bright pixel", "black", "odd width"])
def test_samples_follow_their_density(kind):
    """A chi-square test over the pixels. The density integrates to 1, and radiance / density is the
    weight."""
    picture = PICTURE
    if kind == "one bright pixel":
        picture = (
            np.where(np.arange(W)[:, None] == 3, 1.0, 0.0) * (np.arange(H) == 0)[:, None, None]
        )
    elif kind == "black":
        picture = np.zeros_like(PICTURE)
    elif kind == "odd width":
        picture = PICTURE[:, :15]
    sky = environment_map(picture)
    h, w = picture.shape[:2]
    u = jax.random.uniform(jax.random.key(2), (20_000, 2))

    def weigh(u):
        drawn = direction_sample(sky, POINT, u)
        wi = drawn.direction
        return drawn, direction_pdf(sky, POINT, wi), radiance_from(sky, POINT, wi)

    drawn, density, arriving = jax.jit(jax.vmap(weigh))(u)
    np.testing.assert_allclose(arriving / density[:, None], drawn.irradiance, rtol=1e-7)
    np.testing.assert_array_equal(drawn.density, density)
    cells = np.cos(np.pi * np.arange(h) / h) - np.cos(np.pi * np.arange(1, h + 1) / h)
    expected = np.asarray(sky.density) * cells[:, None] * 2 * np.pi / w
    np.testing.assert_allclose(expected.sum(), 1, rtol=1e-12)
    x, y, z = np.asarray(drawn.direction).T
    rows = np.clip((np.arccos(np.clip(z, -1, 1)) / np.pi * h).astype(int), 0, h - 1)
    columns = ((np.pi - np.arctan2(y, x)) / (2 * np.pi) * w).astype(int) % w
    counts = np.bincount(rows * w + columns, minlength=h * w)
    likely = expected.reshape(-1) * len(u) > 5
    rest = counts[~likely].sum(), expected.reshape(-1)[~likely].sum() * len(u)
    seen, wanted = counts[likely], expected.reshape(-1)[likely] * len(u)
    if rest[1] > 0:
        seen, wanted = np.append(seen, rest[0]), np.append(wanted, rest[1])
    assert stats.chisquare(seen, wanted * seen.sum() / wanted.sum()).pvalue > 1e-3


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("peak", [5e5, 1e7, 1e9])
def test_a_sun_in_float32_is_drawn_by_its_density(peak):
    """All 2^23 uniform float32 numbers, the multiples of 2^-23, are tried."""
    h, w, row, column = 256, 512, 50, 300
    picture = np.ones((h, w, 1), np.float32)
    picture[row, column] = peak
    sky = jax.jit(environment_map)(picture)
    assert sky.density.dtype == np.float32
    u = np.arange(2**23, dtype=np.float32) * np.float32(2**-23)

    def drawn(table):
        """Return the share of all uniform floats in each cell."""
        cell = np.searchsorted(np.asarray(table), u, side="right") - 1
        return np.bincount(cell, minlength=len(table) - 1) / 2**23

    down = np.cos(np.pi * np.arange(h + 1) / h)
    solid_angle = (down[:-1] - down[1:]) * 2 * np.pi / w
    density = np.asarray(sky.density, float)
    said = density * solid_angle[:, None]
    rows = drawn(sky.rows)
    assert rows.min() > 0
    for i in (0, row - 1, row, row + 1, h - 1):
        here = rows[i] * drawn(sky.columns[i])
        assert here.min() > 0
        np.testing.assert_allclose(said[i], here, rtol=1e-6)
    # bilinear interpolation leaves a pixel 3/4 of its own light along each axis
    power = 4 * np.pi + peak * solid_angle[row]
    assert (1 / density).max() < 1.01 * power
    assert (0.75**2 * peak + 1) / density[row, column] < 1.02 * power


@pytest.mark.slow
@pytest.mark.parametrize("order", [8, 16, 64])
def test_a_white_sky_gives_pi_within_the_stated_error(order):
    """The error is at most 1 / order^2, because the sky crosses the receiver's horizon."""
    white = environment_map(np.full((H, W, 1), 2.0))
    for normal in (toward(0.0, 0.0), toward(0.7, 0.3), toward(np.pi / 2, 1.0)):
        got = irradiance(white, POINT, normal, rule=Quadrature(order))
        assert abs(got[0] / (2 * np.pi) - 1) < 1 / order**2


@pytest.mark.slow
def test_rules_agree_under_a_rough_sky():
    normal = toward(0.7, 0.3)
    # a hemisphere rule, independent of the library's nodes, for the rough sky
    nodes, weights = sphere(200, 400)
    radiance = jax.vmap(lambda d: look(painted(), d))(jnp.asarray(nodes))
    cosine = np.maximum(nodes @ np.asarray(normal), 0)
    truth = (np.asarray(radiance) * (weights * cosine)[:, None]).sum(0)
    got = irradiance(painted(), POINT, normal, rule=Quadrature(64))
    np.testing.assert_allclose(got, truth, rtol=2e-3)
    drawn = irradiance(painted(), POINT, normal, rule=MonteCarlo(jax.random.key(1), 8192))
    np.testing.assert_allclose(drawn, truth, rtol=5e-3)


def test_harmonics_are_orthonormal():
    nodes, weights = sphere(8, 16)
    basis = np.asarray(jax.vmap(harmonics)(jnp.asarray(nodes)))
    np.testing.assert_allclose(basis.T @ (weights[:, None] * basis), np.eye(9), atol=1e-13)


def test_irradiance_by_harmonics_is_exact_for_a_smooth_sky():
    """For L = 2 + x - 0.5 (3 z^2 - 1), the coefficients of cos+ are pi, 2 pi / 3 and pi / 4
    (Ramamoorthi and Hanrahan, eq. 8), so E = 2 pi + 2 pi / 3 x - pi / 8 (3 z^2 - 1)."""
    h, w = 128, 256
    theta, phi = np.pi * (np.arange(h) + 0.5) / h, np.pi - 2 * np.pi * (np.arange(w) + 0.5) / w
    x = np.sin(theta)[:, None] * np.cos(phi)
    z = np.cos(theta)[:, None] * np.ones(w)
    sky = environment_map((2 + x - 0.5 * (3 * z * z - 1))[..., None])
    coefficients = jax.jit(irradiance_coefficients)(sky)
    for n in (toward(0.3, 0.5), toward(2.0, -1.0)):
        expected = 2 * np.pi + 2 * np.pi / 3 * n[0] - np.pi / 8 * (3 * n[2] ** 2 - 1)
        np.testing.assert_allclose(smooth(sky, coefficients, n), expected, rtol=2e-4)


@pytest.mark.slow
def test_error_of_harmonics_is_within_the_stated_bound():
    """The worst case is one bright pixel. Over all angles the error is at most 3/32 of its power,
    at its horizon."""
    picture = np.zeros((64, 128, 1))
    picture[32, 64] = 1e4
    sky = environment_map(picture)
    solid_angle = 2 * np.sin(np.pi * 32.5 / 64) * np.sin(np.pi / 128) * 2 * np.pi / 128
    power = 1e4 * solid_angle
    sun = toward(np.pi * 32.5 / 64, np.pi - 2 * np.pi * 64.5 / 128)
    side = jnp.cross(sun, jnp.asarray([0.0, 0, 1]))
    coefficients = irradiance_coefficients(sky)
    angles = np.linspace(0, np.pi, 61)
    normals = jnp.asarray(
        [np.cos(a) * sun + np.sin(a) * side / np.linalg.norm(side) for a in angles]
    )
    got = jax.vmap(lambda n: harmonic_irradiance(sky, coefficients, n))(normals)[:, 0]
    error = np.abs(got - power * np.maximum(np.cos(angles), 0)) / power
    assert error.max() <= 3 / 32 + 1e-6
    assert error.max() > 3 / 32 - 1e-3
    np.testing.assert_allclose(error[0], 1 / 16, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_environment_files_are_read_back(tmp_path, suffix):
    picture = np.asarray(RNG.uniform(0.1, 5, size=(4, 8, 3)), np.float32)
    write_image(tmp_path / f"sky{suffix}", picture)
    read = read_environment(tmp_path / f"sky{suffix}")
    assert read.dtype == np.float32
    step = 0 if suffix == ".exr" else 2.0**-7  # of a pixel's brightest channel
    assert (np.abs(read - picture) <= step * picture.max(axis=-1, keepdims=True)).all()
    sky = environment_map(read)
    assert sky.density.dtype == jnp.float32


@pytest.mark.parametrize(
    ("picture", "name", "message"),
    [
        (np.ones((4, 8, 3), np.uint8), "a.png", "holds? no radiance"),
        (np.ones((4, 6, 3), np.float32), "a.exr", "4 rows of 6 .* twice as wide as high"),
        (np.full((4, 8, 3), -1.0, np.float32), "a.exr", "96 of its values are negative"),
        (np.full((4, 8), np.nan, np.float32), "a.exr", "32 of its values .* not finite"),
    ],
)
def test_files_that_are_not_environments_are_refused(tmp_path, picture, name, message):
    write_image(tmp_path / name, picture)
    with pytest.raises(InputError, match=message):
        read_environment(tmp_path / name)


def test_wrong_shapes_are_named():
    with pytest.raises(ValueError, match=r"must have shape \(h, w, bands\), got \(4, 8\)"):
        environment_map(np.ones((4, 8)))
    with pytest.raises(ValueError, match=r"EnvironmentMap.rotation .* got \(2, 3\)"):
        environment_map(PICTURE, rotation=np.ones((2, 3)))
    with pytest.raises(ValueError, match=r"must have pixels and bands, got \(0, 8, 3\)"):
        environment_map(np.ones((0, 8, 3)))
    with pytest.raises(ValueError, match="uint8 codes, which are no radiance"):
        environment_map(np.full((4, 8, 3), 200, np.uint8))


@pytest.mark.sweep
@pytest.mark.parametrize("shape", [(16, 16, 1), (24, 18, 1), (18, 24, 1)])
def test_pictures_in_another_projection_are_named(shape):
    """A light probe is square, and a cube cross 3 by 4 or 4 by 3."""
    with pytest.warns(UserWarning, match="as a light probe or a cross of a cube has"):
        environment_map(np.ones(shape))
    environment_map(np.ones((16, 30, 1)))


@pytest.mark.parametrize("wrong", [-1e-3, np.nan, np.inf])
def test_values_that_are_not_radiance_are_named(wrong):
    picture = PICTURE.copy()
    picture[2, 3, 1] = wrong
    with pytest.raises(ValueError, match=f"finite, at least 0, got {wrong}"):
        environment_map(picture)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [2.0**124, 2.0**-90])
def test_probabilities_do_not_depend_on_the_unit(scale):
    """In float32, sums of the larger values overflow and those of the smaller ones underflow."""
    picture = (PICTURE / PICTURE.max()).astype(np.float32)
    expected, sky = environment_map(picture), environment_map(picture * np.float32(scale))
    for name in ("rows", "columns", "density"):
        np.testing.assert_array_equal(getattr(sky, name), getattr(expected, name))


def test_a_sky_near_the_limit_of_float32_is_drawn_like_others():
    """XLA may divide by an inverse, which is subnormal here."""
    picture = jnp.asarray(PICTURE, jnp.float32)
    bright = environment_map(picture * (3e38 / picture.max()))
    np.testing.assert_allclose(bright.density, environment_map(picture).density, rtol=1e-5)
