"""Tests tables and measured materials against SciPy and naive loops, with physical laws, and their
samplers."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import measured as oracle
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import chi2

from jaxvision import Vec, brdf
from jaxvision.brdf.half_difference import (
    HalfDifferenceTable,
    bin_angles,
)
from jaxvision.brdf.measured import (
    AnisotropicTable,
    BRDFSamples,
    IsotropicTable,
    sample_directions,
    samples_of,
    tabulate_sampler,
)
from jaxvision.geometry.hemisphere import product_nodes

evaluate = jax.jit(jax.vmap(brdf.evaluate, (None, 0, 0)))
pdf = jax.jit(jax.vmap(brdf.pdf, (None, 0, None)))
shading = jax.jit(jax.vmap(brdf.shading, (None, 0, None)))
sample = jax.jit(jax.vmap(brdf.sample, (None, None, 0)))
albedo = jax.jit(brdf.albedo)
taken = jax.jit(samples_of)

THETA_I, THETA_O = np.array([0.1, 0.3, 0.7, 1.2]), np.array([0.05, 0.5, 1.1, 1.4])
HALF_TURN, TURN = np.array([0.0, 0.8, 2.0, np.pi]), np.array([-3.0, -1.0, 0.4, 2.2])
PHI_I = np.array([-2.0, 0.0, 1.5])


def random_table(*axes, bands=2, seed=0):
    values = np.random.default_rng(seed).uniform(0.1, 1, (*map(len, axes), bands))
    return jnp.asarray(values)


ISOTROPIC = IsotropicTable(THETA_I, THETA_O, HALF_TURN, random_table(THETA_I, THETA_O, HALF_TURN))
FULL = IsotropicTable(THETA_I, THETA_O, TURN, random_table(THETA_I, THETA_O, TURN), azimuths="full")
ANISOTROPIC = AnisotropicTable(
    THETA_I, PHI_I, THETA_O, TURN, random_table(THETA_I, PHI_I, THETA_O, TURN)
)
MERL = HalfDifferenceTable(random_table(range(6), range(5), range(4)))
TABLES = {"isotropic": ISOTROPIC, "full": FULL, "anisotropic": ANISOTROPIC, "merl": MERL}
every_table = pytest.mark.parametrize("name", TABLES)


def pairs(count=200, seed=1, **options):
    rng = np.random.default_rng(seed)
    return oracle.directions(rng, count, **options), oracle.directions(rng, count, **options)


def angles(w):
    return np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2]), np.arctan2(w[:, 1], w[:, 0])


def around(nodes, phi):
    """Return the angles shifted by whole turns into the one that starts at nodes[0]."""
    return nodes[0] + (phi - nodes[0]) % (2 * np.pi)


def closed(nodes, values, axis):
    """Return the axis with its first node repeated one turn later."""
    return np.append(nodes, nodes[0] + 2 * np.pi), np.concatenate(
        [values, values.take([0], axis)], axis
    )


# ------------------------------------------------ interpolation


def test_isotropic_table_is_linear_in_each_angle():
    wi, wo = pairs()
    (theta_i, phi_i), (theta_o, phi_o) = angles(wi), angles(wo)
    between = np.abs((phi_o - phi_i + np.pi) % (2 * np.pi) - np.pi)
    clamped = np.stack([np.clip(theta_i, 0.1, 1.2), np.clip(theta_o, 0.05, 1.4), between], axis=-1)
    grid = RegularGridInterpolator((THETA_I, THETA_O, HALF_TURN), np.asarray(ISOTROPIC.values))
    np.testing.assert_allclose(evaluate(ISOTROPIC, wi, wo), grid(clamped), rtol=1e-12)


def test_full_turn_joins_its_ends():
    wi, wo = pairs()
    (theta_i, phi_i), (theta_o, phi_o) = angles(wi), angles(wo)
    nodes, values = closed(TURN, np.asarray(FULL.values), 2)
    grid = RegularGridInterpolator((THETA_I, THETA_O, nodes), values)
    at = np.stack(
        [np.clip(theta_i, 0.1, 1.2), np.clip(theta_o, 0.05, 1.4), around(TURN, phi_o - phi_i)],
        axis=-1,
    )
    np.testing.assert_allclose(evaluate(FULL, wi, wo), grid(at), rtol=1e-12)


def test_anisotropic_table_is_linear_in_each_angle():
    wi, wo = pairs()
    (theta_i, phi_i), (theta_o, phi_o) = angles(wi), angles(wo)
    first, values = closed(PHI_I, np.asarray(ANISOTROPIC.values), 1)
    second, values = closed(TURN, values, 3)
    grid = RegularGridInterpolator((THETA_I, first, THETA_O, second), values)
    at = np.stack(
        [
            np.clip(theta_i, 0.1, 1.2),
            around(PHI_I, phi_i),
            np.clip(theta_o, 0.05, 1.4),
            around(TURN, phi_o),
        ],
        axis=-1,
    )
    np.testing.assert_allclose(evaluate(ANISOTROPIC, wi, wo), grid(at), rtol=1e-12)


@pytest.mark.slow
def test_beyond_the_measured_range():
    """Values are clamped, extrapolated (never below 0) or zero. One direction is beyond both
    outermost nodes."""
    wi, wo = pairs()
    (theta_i, phi_i), (theta_o, phi_o) = angles(wi), angles(wo)
    between = np.abs((phi_o - phi_i + np.pi) % (2 * np.pi) - np.pi)
    at = np.stack([theta_i, theta_o, between], axis=-1)
    grid = RegularGridInterpolator(
        (THETA_I, THETA_O, HALF_TURN),
        np.asarray(ISOTROPIC.values),
        bounds_error=False,
        fill_value=None,
    )
    build = partial(IsotropicTable, THETA_I, THETA_O, HALF_TURN, ISOTROPIC.values)
    extrapolated = np.maximum(grid(at), 0)
    assert (grid(at) < 0).any()
    np.testing.assert_allclose(
        evaluate(build(outside="extrapolate"), wi, wo), extrapolated, rtol=1e-11, atol=1e-13
    )
    outside = (theta_i < 0.1) | (theta_i > 1.2) | (theta_o < 0.05) | (theta_o > 1.4)
    zeroed = np.asarray(evaluate(build(outside="zero"), wi, wo))
    assert outside.any()
    assert (zeroed[outside] == 0).all()
    np.testing.assert_allclose(zeroed[~outside], evaluate(ISOTROPIC, wi, wo)[~outside], rtol=1e-14)


def test_axes_of_one_node_are_constant():
    values = jnp.asarray([[[[0.3]], [[0.6]]]])
    table = IsotropicTable([0.2], [0.0, 1.0], [0.0], values)
    wi, wo = pairs(20)
    expected = 0.3 + 0.3 * np.clip(angles(wo)[0], 0, 1)
    np.testing.assert_allclose(evaluate(table, wi, wo)[:, 0], expected, rtol=1e-12)


def test_nearest_bin_is_that_of_the_published_reader():
    wi, wo = pairs(500)
    nearest = HalfDifferenceTable(MERL.values, interpolation="nearest")
    bins = [
        oracle.merl_bin(oracle.half_difference(i, o), (6, 5, 4))
        for i, o in zip(wi, wo, strict=True)
    ]
    expected = np.array([np.asarray(MERL.values)[b] for b in bins])
    np.testing.assert_array_equal(evaluate(nearest, wi, wo), expected)
    assert len(set(bins)) > 60  # of 120


@pytest.mark.slow
def test_between_bins_is_linear():
    wi, wo = pairs()
    h, d, p = (np.asarray(x) for x in bin_angles(MERL))
    values = np.asarray(MERL.values)
    period = np.concatenate([values[:, :, -1:], values, values[:, :, :1]], axis=2)
    phi = np.concatenate([p[-1:] - np.pi, p, p[:1] + np.pi])
    root = np.sqrt(h)
    grid = RegularGridInterpolator((root, d, phi), period)
    at = np.array([oracle.half_difference(i, o) for i, o in zip(wi, wo, strict=True)])
    places = [
        np.clip(np.sqrt(at[:, 0]), root[0], root[-1]),
        np.clip(at[:, 2], d[0], d[-1]),
        at[:, 3] % np.pi,
    ]
    np.testing.assert_allclose(
        evaluate(MERL, wi, wo), grid(np.stack(places, axis=-1)), rtol=1e-6
    )  # the oracle's arccos


@pytest.mark.slow
def test_rgl_against_the_published_construction():
    """The reference computes naive integrals of the interpolated densities for one pair of
    directions at a time."""

    @jax.jit
    @partial(jax.vmap, in_axes=(None, 0, 0))
    def both(material, wi, wo):
        return brdf.shading(material, wi, wo), brdf.pdf(material, wi, wo)

    for phi in ([0.0], [-np.pi, -1.0, 0.5, np.pi]):
        fields = oracle.rgl_fields(np.random.default_rng(3), phi=phi)
        material = rgl_of(fields)
        wi, wo = pairs(25)
        found, density = both(material, wi, wo)
        expected = [oracle.rgl_shading(fields, i, o) for i, o in zip(wi, wo, strict=True)]
        np.testing.assert_allclose(found, [value for value, _ in expected], rtol=1e-6)
        np.testing.assert_allclose(density, [p for _, p in expected], rtol=1e-6)
        cosine = wi[:, 2:]
        np.testing.assert_allclose(evaluate(material, wi, wo), found / cosine, rtol=1e-12)


def rgl_of(fields, **options):
    table = {name: jnp.asarray(x, jnp.float64) for name, x in fields.items()}
    return brdf.rgl.rgl_material(
        table["theta_i"],
        table["phi_i"],
        jnp.moveaxis(table["rgb"], 2, -1),
        table["ndf"],
        table["sigma"],
        table["vndf"],
        table["luminance"],
        **options,
    )


@pytest.mark.slow
@pytest.mark.parametrize("symmetry", [pytest.param(2, marks=pytest.mark.slow), 4])
def test_rgl_sectors_repeat(symmetry):
    """A table of one sector gives equal values for rotated (2) or mirrored (4) pairs. If `wo` is in
    the sector, it equals the table of a whole turn."""
    phi = np.linspace(-np.pi, -np.pi + 2 * np.pi / symmetry, 4)
    fields = oracle.rgl_fields(np.random.default_rng(4), phi=phi)
    material, whole = rgl_of(fields, symmetry=symmetry), rgl_of(fields)
    wi, wo = pairs(100)
    flips = {2: [[-1, -1, 1]], 4: [[-1, 1, 1], [1, -1, 1], [-1, -1, 1]]}[symmetry]
    value = evaluate(material, wi, wo)
    for flip in flips:
        np.testing.assert_allclose(evaluate(material, wi * flip, wo * flip), value, rtol=1e-9)
    inside = (wo[:, 1] < 0) & ((symmetry == 2) | (wo[:, 0] < 0))
    assert inside.sum() > 10
    np.testing.assert_array_equal(value[inside], evaluate(whole, wi, wo)[inside])


# ------------------------------------------------ physics


@pytest.mark.sweep
@every_table
def test_nothing_below_the_surface_and_nothing_negative(name):
    wi, wo = pairs(100)
    down = np.array([1, 1, -1])
    table = TABLES[name]
    assert (np.asarray(evaluate(table, wi, wo)) > 0).all()
    for a, b in ((wi * down, wo), (wi, wo * down), (wi * down, wo * down)):
        assert (np.asarray(evaluate(table, a, b)) == 0).all()


@pytest.mark.slow
def test_reciprocity_of_half_difference_tables_and_where_it_is_asked_for():
    wi, wo = pairs()
    np.testing.assert_allclose(evaluate(MERL, wi, wo), evaluate(MERL, wo, wi), rtol=1e-10)
    assert not np.allclose(evaluate(ISOTROPIC, wi, wo), evaluate(ISOTROPIC, wo, wi), rtol=0.1)
    both = IsotropicTable(THETA_I, THETA_O, HALF_TURN, ISOTROPIC.values, reciprocal=True)
    mean = (evaluate(ISOTROPIC, wi, wo) + evaluate(ISOTROPIC, wo, wi)) / 2
    np.testing.assert_allclose(evaluate(both, wi, wo), mean, rtol=1e-14)
    np.testing.assert_allclose(evaluate(both, wo, wi), mean, rtol=1e-14)


@pytest.mark.parametrize("name", ["isotropic", "full", "merl"])
def test_turning_both_directions_changes_nothing(name):
    wi, wo = pairs()
    c, s = np.cos(1.3), np.sin(1.3)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(
        evaluate(TABLES[name], wi @ turn.T, wo @ turn.T), evaluate(TABLES[name], wi, wo), rtol=1e-9
    )
    mirrored = evaluate(TABLES[name], wi * [1, -1, 1], wo * [1, -1, 1])
    assert np.allclose(mirrored, evaluate(TABLES[name], wi, wo), rtol=1e-9) == (name == "isotropic")


# ------------------------------------------------ sampling


def shiny():
    """Return a half-difference table of a lobe a few degrees wide on a dim base, with a tabulated
    sampler."""
    theta_h, theta_d, _ = bin_angles(HalfDifferenceTable(jnp.zeros((45, 12, 8, 1))))
    lobe = 8 * jnp.exp(-jnp.square(jnp.tan(theta_h) / 0.08))
    values = 0.05 + lobe[:, None] * (1 + jnp.square(theta_d))[None, :]
    return tabulate_sampler(
        HalfDifferenceTable(jnp.broadcast_to(values[:, :, None, None], (45, 12, 8, 1)))
    )


def streaked():
    """Return an anisotropic table whose lobe is longer across x than along it."""
    theta, phi = np.linspace(0, 1.55, 10), np.linspace(-np.pi, np.pi, 16, endpoint=False)
    axes = np.meshgrid(theta, phi, theta, phi, indexing="ij")
    wi, wo = (
        np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
        for t, p in (axes[:2], axes[2:])
    )
    h = (wi + wo) / np.linalg.norm(wi + wo, axis=0)
    values = 0.1 + 3 * np.exp(-((h[0] / h[2] / 0.2) ** 2) - (h[1] / h[2] / 0.6) ** 2)
    table = AnisotropicTable(theta, phi, theta, phi, jnp.asarray(values[..., None]))
    return tabulate_sampler(table, thetas=8, phis=13, rows=25, columns=33)


SAMPLED = {
    "half-difference": shiny,
    "anisotropic": streaked,
    "rgl": lambda: rgl_of(oracle.rgl_fields(np.random.default_rng(3))),
    "rgl of one sector": lambda: rgl_of(
        oracle.rgl_fields(np.random.default_rng(3), phi=np.linspace(-np.pi, -np.pi / 2, 3)),
        symmetry=4,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "half-difference",
        "rgl of one sector",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("anisotropic", "rgl")),
    ],
)
def test_draws_follow_the_density_and_their_albedo_equals_the_quadrature(name):
    """A chi-square test over 16 x 16 cells of the whole sphere, at the 1e-4 level."""
    material, count = SAMPLED[name](), 192**2  # draws, cells and quadrature share one shape
    rng = np.random.default_rng(8)
    wo = jnp.asarray([np.sin(0.8) * np.cos(0.7), np.sin(0.8) * np.sin(0.7), np.cos(0.8)])
    wi = np.asarray(sample(material, wo, jnp.asarray(rng.random((count, 3)))))
    np.testing.assert_allclose(np.linalg.norm(wi, axis=1), 1, atol=1e-12)

    side, fine = 16, 12  # cells a side, midpoints per cell and axis
    z = -1 + (np.arange(side * fine) + 0.5) * 2 / (side * fine)
    phi = -np.pi + (np.arange(side * fine) + 0.5) * 2 * np.pi / (side * fine)
    zz, pp = np.meshgrid(z, phi, indexing="ij")
    s = np.sqrt(1 - zz**2)
    nodes = np.stack([s * np.cos(pp), s * np.sin(pp), zz], axis=-1).reshape(-1, 3)
    density = np.asarray(pdf(material, nodes, wo)).reshape(side, fine, side, fine)
    expected = density.mean(axis=(1, 3)) * (4 * np.pi / side**2) * count
    assert abs(expected.sum() / count - 1) < 3e-3
    observed = np.histogram2d(
        wi[:, 2], np.arctan2(wi[:, 1], wi[:, 0]), side, [[-1, 1], [-np.pi, np.pi]]
    )[0]
    full = expected > 10
    assert full.sum() > 15
    scaled = expected[full] * observed[full].sum() / expected[full].sum()
    statistic = ((observed[full] - scaled) ** 2 / scaled).sum()
    assert statistic < chi2.isf(1e-4, full.sum() - 1)
    assert abs(observed[~full].sum() - expected[~full].sum()) < 5 * np.sqrt(10 * (~full).sum())

    reflected, chance = np.asarray(shading(material, wi, wo)), np.asarray(pdf(material, wi, wo))
    assert (reflected[chance == 0] == 0).all()
    weights = reflected / np.where(chance > 0, chance, 1)[:, None]
    directions, solid = product_nodes(96, 384)
    integral = solid @ np.asarray(shading(material, directions, wo))
    error = weights.std(axis=0) / np.sqrt(count)
    assert (np.abs(weights.mean(axis=0) - integral) < 4 * error + 1e-3 * integral).all()
    np.testing.assert_allclose(albedo(material, wo), integral, rtol=5e-3)


# ------------------------------------------------ samples, records


@pytest.mark.slow
def test_samples_of_a_material_rebuild_its_table():
    """The samples are taken at the table's nodes, and through a vmap over the records' own order of
    angles."""
    samples = taken(ISOTROPIC, ISOTROPIC.theta_i, ISOTROPIC.theta_o, ISOTROPIC.phi)
    np.testing.assert_allclose(
        samples.values.reshape(4, 4, 4, 2), ISOTROPIC.values, rtol=1e-12, atol=1e-12
    )
    wi, _ = sample_directions(samples)
    assert isinstance(wi, Vec)
    np.testing.assert_allclose(jnp.arccos(jnp.clip(wi.z, -1, 1)), samples.theta_i, atol=1e-7)
    turned = taken(
        ANISOTROPIC, *map(jnp.asarray, (THETA_I, THETA_O, TURN)), phi_i=jnp.asarray(PHI_I)
    )
    np.testing.assert_allclose(
        turned.values.reshape(4, 3, 4, 4, 2), ANISOTROPIC.values, rtol=1e-12, atol=1e-12
    )


@pytest.mark.slow
def test_samples_of_an_rgl_material_contain_no_cosine():
    material = rgl_of(oracle.rgl_fields(np.random.default_rng(3)))
    theta_i, theta_o, phi = jnp.asarray([0.5, 1.1]), jnp.asarray([0.3]), jnp.asarray([2.0])
    samples = taken(material, theta_i, theta_o, phi)
    wi, wo = sample_directions(samples)
    stored = jax.jit(jax.vmap(brdf.shading, (None, 0, 0)))(material, wi, wo)
    np.testing.assert_allclose(samples.values * jnp.cos(theta_i)[:, None], stored, rtol=1e-12)


def test_wavelengths_travel_with_the_samples():
    table = IsotropicTable(
        [0.0, 1.0], [0.0, 1.0], [0.0], jnp.ones((2, 2, 1, 2)), wavelengths=[5e-7, 6e-7]
    )
    samples = taken(table, table.theta_i, table.theta_o, table.phi)
    np.testing.assert_array_equal(samples.wavelengths, [5e-7, 6e-7])


def test_wrong_shapes_and_options_are_named(as_for_users):
    with pytest.raises(ValueError, match=r"IsotropicTable.values must have shape \(2, 2, 1, bands"):
        IsotropicTable([0.0, 1.0], [0.0, 1.0], [0.0], jnp.ones((2, 3, 1, 2)))
    with pytest.raises(ValueError, match=r"azimuths must be one of mirrored, full, got 'half'"):
        IsotropicTable([0.0], [0.0], [0.0], jnp.ones((1, 1, 1, 2)), azimuths="half")  # pyright: ignore
    with pytest.raises(ValueError, match=r"outside must be one of"):
        AnisotropicTable([0.0], [0.0], [0.0], [0.0], jnp.ones((1, 1, 1, 1, 2)), outside="wrap")  # pyright: ignore
    with pytest.raises(ValueError, match=r"interpolation must be one of linear, nearest"):
        HalfDifferenceTable(jnp.ones((2, 2, 2, 1)), interpolation="cubic")  # pyright: ignore
    with pytest.raises(ValueError, match=r"BRDFSamples.phi_o must have shape \(3,\), got \(2,\)"):
        BRDFSamples(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(2), np.zeros((3, 1)))
    with pytest.raises(ValueError, match=r"symmetry must be 1, 2 or 4, got 3"):
        rgl_of(oracle.rgl_fields(np.random.default_rng(3)), symmetry=3)
