"""Tests aberrations against the Airy pattern, geometrical optics, Marechal's formula and the
pupil's autocorrelation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting import Gaussian, Parameter, Problem, fit
from jaxvision import (
    AnnularAperture,
    CircularAperture,
    Diffraction,
    PolygonalAperture,
    RectangularAperture,
    ThinLens,
    Wavefront,
    optics,
)

WAVE = 550e-9  # m
SHARP = np.zeros(1)


def term(j, metres):
    return np.eye(j)[j - 1] * metres


def test_terms_are_orthonormal_and_numbered_as_by_noll():
    nodes, weights = np.polynomial.legendre.leggauss(12)
    square, angle = (nodes + 1) / 2, 2 * np.pi * np.arange(40) / 40
    radius = np.sqrt(square)[:, None]
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    z = np.asarray(optics.zernike(x, y, count=66))
    products = np.einsum("rai,raj,r->ij", z, z, weights / 2) / 40
    np.testing.assert_allclose(products, np.eye(66), atol=1e-11)
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    for j, wanted in {
        3: 2 * rho * np.sin(theta),
        5: np.sqrt(6) * rho**2 * np.sin(2 * theta),
        8: np.sqrt(8) * (3 * rho**3 - 2 * rho) * np.cos(theta),
        9: np.sqrt(8) * rho**3 * np.sin(3 * theta),
        11: np.sqrt(5) * (6 * rho**4 - 6 * rho**2 + 1),
        14: np.sqrt(10) * rho**4 * np.cos(4 * theta),
    }.items():
        np.testing.assert_allclose(z[..., j - 1], wanted, atol=1e-12)


@pytest.mark.slow
def test_without_aberrations_it_is_the_airy_pattern():
    for pitch, size in ((2e-6, 17), (1.1e-5, 7)):
        airy = optics.airy_kernel(WAVE, 8.0, pitch, size=size)
        ours = optics.wavefront_kernel(SHARP, WAVE, 8.0, pitch, size=size)
        np.testing.assert_allclose(ours, airy, atol=1e-9)


@pytest.mark.slow
def test_with_a_central_stop_it_is_the_difference_of_two_patterns():
    """U = 2 J1(x) / x - s^2 2 J1(s x) / (s x)."""
    from scipy.special import j1

    at = (np.arange(9)[:, None] + (np.arange(40) + 0.5) / 40 - 4.5).ravel() * 2e-6
    x = np.pi * np.hypot(at[:, None], at) / (WAVE * 8)
    light = (2 * j1(x) / x - 0.4 * 2 * j1(0.4 * x) / x) ** 2
    pixels = light.reshape(9, 40, 9, 40).sum((1, 3))
    ours = optics.wavefront_kernel(SHARP, WAVE, 8.0, 2e-6, size=9, aperture=AnnularAperture(0.4))
    np.testing.assert_allclose(ours, pixels / pixels.sum(), atol=2e-5)


@pytest.mark.sweep
@pytest.mark.parametrize("angle", [0.3, 0.0])
def test_a_rectangle_and_a_square_of_blades_have_the_pattern_of_slits(angle):
    """U = sinc(w x / (lambda N)) sinc(h y / (lambda N)). The square has a half-diagonal of 1."""
    fine = (np.arange(11)[:, None] + (np.arange(40) + 0.5) / 40 - 5.5).ravel() * 2e-6 / (WAVE * 8)
    x, y = np.meshgrid(fine, fine)

    def pixels(field):
        light = (field**2).reshape(11, 40, 11, 40).sum((1, 3))
        return light / light.sum()

    def kernel(aperture):
        at = {"size": 11, "samples": 48, "aperture": aperture}
        return optics.wavefront_kernel(SHARP, WAVE, 8.0, 2e-6, **at)

    slits = pixels(np.sinc(0.5 * x) * np.sinc(0.8 * y))
    np.testing.assert_allclose(kernel(RectangularAperture(0.5, 0.8)), slits, atol=2e-5)
    turn = angle + np.pi / 4  # angle of a side's normal
    across, along = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    square = pixels(np.sinc(across / np.sqrt(2)) * np.sinc(along / np.sqrt(2)))
    found = kernel(PolygonalAperture(4, angle=angle))
    np.testing.assert_allclose(found, square, atol=2e-5)


@pytest.mark.sweep
@pytest.mark.parametrize("blades", [5, 3, 6])
def test_with_aberrations_a_polygon_is_the_sum_over_its_points(blades):
    """The reference sums over a grid of 700 x 700 points in NumPy."""
    error = term(8, 0.2 * WAVE) + np.append(term(5, 0.1 * WAVE), [0, 0, 0])
    side = (np.arange(700) + 0.5) / 350 - 1
    u, v = np.meshgrid(side, side)
    turn = 0.2 + (2 * np.arange(blades) + 1) * np.pi / blades
    inside = np.all([np.cos(a) * u + np.sin(a) * v < np.cos(np.pi / blades) for a in turn], axis=0)
    pupil = inside * np.exp(2j * np.pi * (np.asarray(optics.zernike(u, v, count=8)) @ error) / WAVE)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    places = (np.arange(7)[:, None] - 3 + nodes / 2).ravel() * 2e-6
    wave = np.exp(-1j * np.pi * np.outer(side, places) / (WAVE * 8))
    light = np.abs(wave.T @ pupil @ wave) ** 2 * np.outer(np.tile(weights, 7), np.tile(weights, 7))
    light = light.reshape(7, 4, 7, 4).sum((1, 3))
    at = {"size": 7, "order": 4, "samples": 48, "aperture": PolygonalAperture(blades, angle=0.2)}
    ours = optics.wavefront_kernel(error, WAVE, 8.0, 2e-6, **at)
    np.testing.assert_allclose(ours, light / light.sum(), atol=3e-4)


@pytest.mark.sweep
@pytest.mark.parametrize("j", [4, 6, 7, 11])
def test_small_aberrations_lower_the_peak_by_marechals_formula(j):
    def peak(metres):
        at = {"size": 241, "samples": 96, "order": 1}
        return optics.wavefront_kernel(term(j, metres), WAVE, 8.0, 4e-7, **at)[120, 120]

    rms = WAVE / 30
    ratio = float(peak(rms) / peak(0.0))
    assert ratio == pytest.approx(np.exp(-((2 * np.pi * rms / WAVE) ** 2)), rel=0.01)


@pytest.mark.slow
def test_a_large_defocus_is_the_disc_of_geometrical_optics():
    """The radius is 2 N dW/drho = 8 sqrt(3) N a at the edge, where the wave has a bright fringe."""
    waves = 4 * WAVE
    radius = 8 * np.sqrt(3) * 8 * waves / 1e-5  # pixels
    lines = [[0.98 * WAVE, WAVE, 1.02 * WAVE]]
    sampling = {"order": 7, "samples": 270}  # the fewest possible
    kernel = optics.wavefront_kernel(term(4, waves), lines, 8.0, 1e-5, size=65, **sampling)[..., 0]
    rows, columns = np.mgrid[:65, :65] - 32
    apart = np.hypot(rows, columns)
    disc = np.asarray(optics.aperture_kernel(CircularAperture(), radius, size=65))
    for part, most in ((0.3, 0.02), (0.6, 0.02), (0.9, 0.06), (1.1, 0.02)):
        inside = apart < part * radius
        assert float(kernel[inside].sum()) == pytest.approx(float(disc[inside].sum()), abs=most)


@pytest.mark.slow
def test_the_transfer_is_the_autocorrelation_of_the_pupil():
    """Compared at a fifth of the cut-off in two directions, divided by the pixel's MTF."""
    error = term(8, 0.1 * WAVE) + np.append(term(5, 0.15 * WAVE), [0, 0, 0])
    pitch, size = 2.2e-6, 61
    kernel = np.asarray(optics.wavefront_kernel(error, WAVE, 8.0, pitch, size=size))
    side = (np.arange(1200) + 0.5) / 600 - 1
    at = np.meshgrid(1.2 * side, 1.2 * side)

    def pupil(x, y):
        w = np.asarray(optics.zernike(x, y, count=8)) @ error
        return np.where(x * x + y * y < 1, np.exp(2j * np.pi * w / WAVE), 0)

    for way in ((1.0, 0.0), (0.6, 0.8)):
        shift = 0.2 * np.array(way)  # of both pupils from the centre
        overlap = pupil(at[0] + shift[0], at[1] + shift[1]) * np.conj(
            pupil(at[0] - shift[0], at[1] - shift[1])
        )
        wanted = overlap.sum() * (2.4 / 1200) ** 2 / np.pi
        frequency = 0.2 * np.array(way) / (WAVE * 8)  # m^-1
        places = (np.arange(size) - size // 2) * pitch
        phase = np.exp(
            2j * np.pi * (frequency[0] * places[None, :] + frequency[1] * places[:, None])
        )
        found = (kernel * phase).sum() / np.prod(np.sinc(frequency * pitch))
        assert abs(found - wanted) < 0.01  # 1 % of the light is beyond the kernel


def test_without_aberrations_the_transfer_is_that_of_the_disc():
    frequency = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.4], [0.6, -0.79], [1.0, 0.2]]) / (
        WAVE * 8
    )
    otf = jax.jit(optics.wavefront_otf, static_argnames="samples")
    found = np.asarray(otf(frequency, SHARP, WAVE, 8.0))
    wanted = optics.diffraction_mtf(np.linalg.norm(frequency, axis=1), WAVE, 8.0)
    np.testing.assert_allclose(found[:, 0], wanted, atol=1e-7)
    np.testing.assert_allclose(found[:, 1], 0, atol=1e-7)
    slit = RectangularAperture(0.5, 0.8)  # (1 - |s| / width) for each side
    found = otf(frequency[1:3], SHARP, WAVE, 8.0, aperture=slit, samples=4)[:, 0]
    np.testing.assert_allclose(found, [0.4, 0.4 * 0.5], atol=1e-7)
    with pytest.raises(ValueError, match="takes a convex aperture, got AnnularAperture"):
        optics.wavefront_otf(frequency, SHARP, WAVE, 8.0, aperture=AnnularAperture(0.4))


@pytest.mark.slow
@pytest.mark.parametrize("aperture", [CircularAperture(), PolygonalAperture(5, angle=0.2)])
def test_the_transfer_is_the_overlap_of_two_pupils(aperture):
    """The reference sums over a grid of 1500 x 1500 points in NumPy."""
    error = WAVE * np.array([0, 0, 0, 0.1, 0.15, 0, 0.05, 0.1, 0, 0, 0.07])
    side = 1.8 * ((np.arange(1500) + 0.5) / 750 - 1)
    u, v = np.meshgrid(side, side)
    turns = 0.2 + (2 * np.arange(5) + 1) * np.pi / 5

    def pupil(x, y):
        inside = x * x + y * y < 1
        if isinstance(aperture, PolygonalAperture):
            sides = [np.cos(a) * x + np.sin(a) * y < np.cos(np.pi / 5) for a in turns]
            inside = np.all(sides, axis=0)
        w = np.asarray(optics.zernike(x, y, count=11)) @ error
        return np.where(inside, np.exp(2j * np.pi * w / WAVE), 0)

    area = np.abs(pupil(u, v)).sum()
    for shift in ((0.2, 0.0), (0.12, -0.16), (-0.6, 0.3)):
        overlap = pupil(u - shift[0], v - shift[1]) * np.conj(pupil(u + shift[0], v + shift[1]))
        wanted = overlap.sum() / area
        frequency = np.array(shift) / (WAVE * 8)
        found = np.asarray(optics.wavefront_otf(frequency, error, WAVE, 8.0, aperture=aperture))
        np.testing.assert_allclose(found, [wanted.real, wanted.imag], atol=3e-4)


@pytest.mark.slow
def test_a_lens_with_a_wavefront_blurs_its_picture():
    lens = {
        "position": [0, 0, 0],
        "rotation": np.eye(3),
        "focal_length": 0.05,
        "pixel_pitch": 4e-6,
        "resolution": (9, 9),
        "f_number": 8.0,
    }
    star = jnp.zeros((9, 9, 1)).at[4, 4].set(1.0)
    airy, sharp, tilted, stopped, bladed = (
        optics.sensor_irradiance(ThinLens(**lens, **more), star)
        for more in (
            {"diffraction": Diffraction(WAVE, size=9)},
            {"diffraction": Wavefront(SHARP, WAVE, size=9)},
            {"diffraction": Wavefront(term(2, 4e-6 / 4 / 8), WAVE, size=9)},
            {"diffraction": Wavefront(SHARP, WAVE, size=9), "aperture": AnnularAperture(0.5)},
            {"diffraction": Wavefront(SHARP, WAVE, size=9), "aperture": PolygonalAperture(6)},
        )
    )
    np.testing.assert_allclose(sharp, airy, atol=1e-7 * float(airy.max()))
    np.testing.assert_allclose(tilted[4, 5], airy[4, 4], rtol=0.02)  # one pixel to the right
    assert stopped[4, 4] < 0.8 * airy[4, 4]
    spikes = np.asarray(bladed[..., 0])  # corners at the right diffract light upwards
    assert spikes[:2, 4].sum() > 1.2 * spikes[4, :2].sum()
    with pytest.raises(ValueError, match=r"got PolygonalAperture; give ThinLens\.diffraction"):
        ThinLens(**lens, diffraction=Diffraction(WAVE), aperture=PolygonalAperture(6))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"samples": 20}, "samples = 20: a kernel of 33 pixels and this wavefront need at least"),
        ({"order": 2}, r"order = 2: a pixel of 0.909 lambda N needs at least 3 nodes"),
        ({"size": 4}, "size must be an odd number"),
    ],
)
def test_too_few_nodes_are_refused(more, said):
    with pytest.raises(ValueError, match=said):
        optics.wavefront_kernel(SHARP, WAVE, 8.0, 4e-6, **{"size": 33, **more})


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"wavelength": -WAVE}, r"wavelength must be above 0, got -5"),
        ({"wavelength": 0.0}, r"wavelength must be above 0, got 0.0"),
        ({"f_number": 0.0}, r"f_number must be above 0, got 0.0"),
        ({"pixel_pitch": -1e-6}, r"pixel_pitch must be above 0, got -1e-06"),
    ],
)
def test_impossible_lenses_are_refused(more, said):
    lens = {"wavelength": WAVE, "f_number": 8.0, "pixel_pitch": 4e-6, "size": 9}
    with pytest.raises(ValueError, match=said):
        optics.wavefront_kernel(SHARP, **{**lens, **more})
    for stop in (1.0, 2.0):
        with pytest.raises(ValueError, match="obstruction must be finite, at least 0 and below 1"):
            optics.diffraction_mtf(1e4, WAVE, 8.0, obstruction=stop)


@pytest.mark.slow
def test_coefficients_are_fitted_from_stars_with_intervals_that_cover():
    """Two focus settings determine the signs of the even terms, which one star does not."""
    truth = np.array([30e-9, -45e-9, 60e-9])  # m: astigmatism, coma, spherical aberration
    offsets = jnp.array([-80e-9, 80e-9])

    def stars(scaled):
        def of(offset):
            error = (
                jnp.zeros(11)
                .at[jnp.array([3, 5, 7, 10])]
                .set(jnp.concatenate([offset[None], 1e-9 * scaled]))
            )
            return optics.wavefront_kernel(error, WAVE, 8.0, 2e-6, size=15, samples=48)

        return 2e4 * jax.vmap(of)(offsets) + 20

    mean = np.asarray(stars(1e9 * truth))
    names = ("astigmatism", "coma", "spherical")
    z = []
    for seed in range(8):
        data = np.random.default_rng(seed).poisson(mean)
        problem = Problem(
            {name: Parameter(lower=-200.0, upper=200.0, unit="nm") for name in names},
            lambda astigmatism, coma, spherical: stars(jnp.stack([astigmatism, coma, spherical])),
            Gaussian(sd=np.sqrt(mean)),
            data,
        )
        found = fit(problem, starts=4)
        z += [
            (one.value - 1e9 * true) / one.standard_error
            for one, true in zip(found.estimates, truth, strict=True)
        ]
    assert 0.4 < np.mean(np.square(z)) < 1.9  # for 24 values
