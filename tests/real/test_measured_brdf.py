"""Tests the published measurements: properties of their tables, and Mitsuba, which also reads
them."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import measured as oracle

from jaxvision import brdf
from jaxvision.brdf.measured import BRDFSamples, sample_directions
from jaxvision.files import measured as files
from jaxvision.geometry.hemisphere import product_nodes

RGL_FILES = ("paper_white", "satin_rosaline", "vch_golden_yellow")
shading = jax.jit(jax.vmap(brdf.shading, (None, 0, None)))
albedo = jax.jit(brdf.albedo)
evaluate = jax.jit(jax.vmap(brdf.evaluate, (None, 0, 0)))


@pytest.fixture(scope="module")
def rgl(data_folder):
    """Return three materials of the database."""
    return {
        name: files.read_rgl(data_folder / "brdf_rgl" / f"{name}_rgb.bsdf") for name in RGL_FILES
    }


@pytest.fixture(scope="module")
def cornell(data_folder):
    """Return the two paints: their samples, and tables made of them."""
    samples = {
        name: files.read_cornell(data_folder / "brdf_cornell" / f"{name}.brdf")
        for name in ("garnet_red", "acryl_blue")
    }
    return {name: (s, files.table_of_samples(s)) for name, s in samples.items()}


def slanted(theta):
    return jnp.asarray([np.sin(theta), 0.0, np.cos(theta)])


@pytest.mark.slow
def test_albedo_of_white_paper(rgl):
    """The published albedo is .82-.86 in red and .83-.87 in green."""
    directions, solid = product_nodes(64, 128)
    for theta in (0.0, 0.5, 1.0):
        integral = solid @ np.asarray(shading(rgl["paper_white"], directions, slanted(theta)))
        assert 0.815 < integral[0] < 0.865
        assert 0.825 < integral[1] < 0.875
        np.testing.assert_allclose(albedo(rgl["paper_white"], slanted(theta)), integral, rtol=3e-3)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("name", "median", "worst"),
    [("paper_white", 0.02, 0.1), ("satin_rosaline", 0.05, 0.3), ("vch_golden_yellow", 0.1, 0.5)],
)
def test_reciprocity_of_the_measurement(rgl, name, median, worst):
    """|f(a, b) - f(b, a)| is compared with their mean, for polar angles below 60 degrees."""
    rng = np.random.default_rng(0)
    wi, wo = (oracle.directions(rng, 2000, highest=np.pi / 3) for _ in range(2))
    one, other = evaluate(rgl[name], wi, wo)[:, 1], evaluate(rgl[name], wo, wi)[:, 1]
    error = np.abs(one - other) / ((one + other) / 2)
    print(name, np.quantile(error, [0.5, 0.95]))
    assert np.median(error) < median
    assert np.quantile(error, 0.95) < worst


@pytest.mark.slow
def test_weights_of_draws_vary_little(rgl):
    """The sampler uses the data, so f_r cos(theta_i) / pdf is within a factor of 2.5 of its mean.
    Cosine-distributed draws vary many times more on the satin film."""
    u = jnp.asarray(np.random.default_rng(1).random((20_000, 3)))
    draw = jax.jit(jax.vmap(brdf.sample, (None, None, 0)))
    density = jax.jit(jax.vmap(brdf.pdf, (None, 0, None)))
    for material in rgl.values():
        wo = slanted(0.6)
        wi = draw(material, wo, u)
        chance = np.asarray(density(material, wi, wo))
        reflected = np.asarray(shading(material, wi, wo))
        weights = (reflected / np.where(chance > 0, chance, 1)[:, None]).mean(axis=1)
        assert (chance > 0).mean() > 0.98
        assert weights.max() < 2.5 * weights.mean()


@pytest.mark.slow
def test_cornell_files_contain_the_goniometers_samples(cornell):
    """There are 1439 samples of 31 bands, at 10 to 80 degrees of incidence."""
    for samples, _ in cornell.values():
        assert samples.values.shape == (1439, 31)
        np.testing.assert_allclose(samples.wavelengths, np.arange(400, 701, 10) * 1e-9)
        theta = np.degrees(np.asarray(samples.theta_i))
        np.testing.assert_allclose(np.unique(np.round(theta, 2)), np.arange(10, 81, 10))
        grazing = np.flatnonzero(np.abs(theta - 80) < 0.1)
        brightest = grazing[np.argmax(np.asarray(samples.values)[grazing, 15])]
        assert abs(np.degrees(float(samples.theta_o[brightest])) - 79.05) < 0.1
        assert abs(float(samples.phi_o[brightest])) == pytest.approx(np.pi, abs=1e-5)


@pytest.mark.slow
def test_tables_of_the_paints_reproduce_their_samples(cornell):
    """The error is the RMS of cube roots, cosine-weighted, at the samples of which the table was
    made."""
    for name, (samples, table) in cornell.items():
        found = np.asarray(evaluate(table, *sample_directions(samples)))
        cosines = np.cos(np.asarray(samples.theta_i)) * np.cos(np.asarray(samples.theta_o))
        weight = np.maximum(cosines, 0)[:, None]
        error = np.cbrt(weight * found) - np.cbrt(weight * np.asarray(samples.values))
        rms = np.sqrt(np.mean(error**2))
        print(name, rms)
        assert rms < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(("name", "part"), [("garnet_red", 0.7), ("acryl_blue", 0.25)])
def test_a_held_out_angle_of_incidence_is_predicted(cornell, name, part):
    """The table predicts the samples at 60 degrees from those at the seven other angles."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    samples, _ = cornell[name]
    angles = (samples.theta_i, samples.phi_i, samples.theta_o, samples.phi_o)
    theta_i, _, theta_o, phi = map(np.asarray, angles)
    green = np.asarray(samples.values)[:, 15:16]
    out = np.abs(np.degrees(theta_i) - 60) < 0.1
    kept = BRDFSamples(*(np.asarray(a)[~out] for a in angles), green[~out])
    wi, wo = sample_directions(BRDFSamples(*(np.asarray(a)[out] for a in angles), green[out]))
    ours = np.asarray(evaluate(files.table_of_samples(kept), wi, wo))
    places = np.stack([theta_i, theta_o, np.abs(phi)], axis=-1)
    linear = LinearNDInterpolator(places[~out], green[~out])(places[out])
    nearest = NearestNDInterpolator(places[~out], green[~out])(places[out])
    naive = np.where(np.isnan(linear), nearest, linear)

    def cube_root_error(found):
        weight = np.maximum(np.cos(theta_i[out]) * np.cos(theta_o[out]), 0)[:, None]
        return np.sqrt(np.mean((np.cbrt(weight * found) - np.cbrt(weight * green[out])) ** 2))

    print(name, cube_root_error(ours), cube_root_error(naive))
    assert cube_root_error(ours) < 0.025
    assert cube_root_error(ours) < part * cube_root_error(naive)


# ------------------------------------------------ against Mitsuba 3


def mitsuba_values(path, wi, wo):
    """Return (f_r cos(theta_i), pdf) of Mitsuba's `measured` plugin, pair by pair."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    bsdf = mitsuba.load_dict({"type": "measured", "filename": str(path)})
    context, at = mitsuba.BSDFContext(), mitsuba.SurfaceInteraction3f()
    values, densities = [], []
    for i, o in zip(wi, wo, strict=True):
        at.wi = mitsuba.Vector3f(o.tolist())
        toward = mitsuba.Vector3f(i.tolist())
        values.append(np.array(bsdf.eval(context, at, toward)).ravel())
        densities.append(bsdf.pdf(context, at, toward))
    return np.maximum(values, 0), np.array(densities)


def assert_as_mitsuba(path):
    material = files.read_rgl(path)
    rng = np.random.default_rng(9)
    wi, wo = oracle.directions(rng, 1000), oracle.directions(rng, 1000)
    expected, density = mitsuba_values(path, wi, wo)

    @jax.jit
    @partial(jax.vmap, in_axes=(None, 0, 0))
    def both(material, wi, wo):
        return brdf.shading(material, wi, wo), brdf.pdf(material, wi, wo)

    values, chance = both(material, wi, wo)
    np.testing.assert_allclose(values, expected, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(chance, density, rtol=2e-4, atol=1e-6)


@pytest.mark.parametrize(
    "name", ["paper_white", *(pytest.param(n, marks=pytest.mark.slow) for n in RGL_FILES[1:])]
)
def test_rgl_agrees_with_mitsuba(data_folder, name):
    assert_as_mitsuba(data_folder / "brdf_rgl" / f"{name}_rgb.bsdf")


@pytest.mark.parametrize("sectors", [4, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2))])
def test_anisotropic_tables_agree_with_mitsuba(tmp_path, sectors):
    """The tables are invented, with azimuths that span a turn, half or a quarter of one."""
    phi = np.linspace(-np.pi, -np.pi + 2 * np.pi / sectors, 5)
    path = tmp_path / "m.bsdf"
    path.write_bytes(oracle.tensor_bytes(oracle.rgl_fields(np.random.default_rng(3), phi=phi)))
    assert_as_mitsuba(path)
