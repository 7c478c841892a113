"""Tests bounds on the parts of a lens against pictures in plain NumPy (`oracles.lenses`)."""

import math
from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import lenses
from scipy import integrate, ndimage, special

from jaxvision import scene as s
from jaxvision.effects.optics import BOUNDS, defocus, middle_pixel_share, optics_stage
from jaxvision.effects.stages import Arriving, Draft, Ends
from jaxvision.optics import sensor_irradiance
from jaxvision.rendering import PixelSamples

SHAPE, PITCH, FOCAL = (12, 16), 2e-3, 0.05
SAMPLES = PixelSamples(jax.random.key(0), 4)


def lens(**parts):
    parts = {"f_number": 4.0, "focus_distance": 2.0, **parts}
    return s.ThinLens(np.zeros(3), np.eye(3), FOCAL, PITCH, resolution=SHAPE, **parts)


def rows_of(view, radiance=(1.0,), near=1.0, far=math.inf, samples=None, oversampling=1):
    arriving = Arriving(np.asarray(radiance, float), near, far, np.zeros(1))
    rows, on_sensor = optics_stage(
        Ends(view, view), arriving, samples=samples, oversampling=oversampling
    )
    return {row.effect.name: row for row in rows}, on_sensor


def distance_to_sensor(focus=2.0):
    return 1 / (1 / FOCAL - 1 / focus)


def brightness(u, f_number=4.0, focus=2.0):
    """Return pi / 4 (d / z_i)^2 cos^4 for each pixel."""
    open_ = math.pi / 4 * (FOCAL / f_number / distance_to_sensor(focus)) ** 2
    return open_ * (1 + (u**2).sum(0)) ** -2


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_the_light_blocked_by_a_rim_is_within_its_bound(seed):
    rng = np.random.default_rng(seed)
    ahead, radius = rng.uniform(0.005, 0.04), rng.uniform(0.006, 0.012)
    rows, on_sensor = rows_of(lens(rim=s.Rim(ahead, 2 * radius)), [3.0])
    u = lenses.slopes(SHAPE, PITCH, distance_to_sensor())
    kept = lenses.clear(u, FOCAL / 8, 0.5, ahead, radius)
    lost = 3 * (brightness(u) * (1 - kept)).max()
    assert lost <= rows["view.rim"].amount[0] * (1 + 1e-9)
    assert rows["view.rim"].amount[0] <= lost * 1.05
    assert on_sensor.irradiance[0] >= 3 * brightness(u).max()


def test_a_rim_that_cuts_nothing_is_proved_to():
    row = rows_of(lens(rim=s.Rim(0.01, 0.2)), [math.inf])[0]["view.rim"]
    assert (row.effect.rank, row.effect.bound) == ("exact", 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_distortion_moves_light_by_at_most_its_bound(seed):
    """The reference traces rays with another iteration, and gets the brightness from a numerical
    derivative."""
    rng = np.random.default_rng(seed)
    radial = rng.uniform(-0.2, 0.3, 2) * [1, 0.5]
    tangential = rng.uniform(-0.01, 0.01, 2)
    view = lens(distortion=s.Distortion(radial, tangential))
    rows, on_sensor = rows_of(view, [2.0])
    x = lenses.slopes(SHAPE, PITCH, distance_to_sensor())
    u = lenses.undistorted(x, radial, tangential)
    moved = np.hypot(*(u - x)).max() * distance_to_sensor() / PITCH
    row = rows["view.distortion"]
    assert moved <= row.effect.place * (1 + 1e-6)
    assert row.effect.place <= 1.5 * moved  # the bound reaches the picture's edge
    lit = brightness(u) / lenses.spread(u, radial, tangential)
    change = 2 * np.abs(lit - brightness(x)).max()
    assert change <= row.amount[0] * (1 + 1e-6) + 1e-12
    assert row.amount[0] <= 1.05 * change
    assert on_sensor.irradiance[0] >= 2 * max(lit.max(), brightness(x).max()) * (1 - 1e-9)


@pytest.mark.slow
def test_distortion_of_zeros_is_exact():
    row = rows_of(lens(distortion=s.Distortion([0.0])), [math.inf])[0]["view.distortion"]
    assert row.effect.rank == "exact"


@pytest.mark.slow
@pytest.mark.parametrize("n", [5.0, 11.0])
def test_diffraction_changes_no_pixel_by_more_than_its_bound(n):
    """The pictures are random ones and the worst case, one lit pixel in the dark."""
    view = s.ThinLens(np.zeros(3), np.eye(3), 0.05, 4e-6, resolution=SHAPE, f_number=n)
    view = replace(view, diffraction=s.Diffraction([6e-7, 4.5e-7], size=9))
    rows, on_sensor = rows_of(view, [5.0, 1.0])
    rng = np.random.default_rng(2)
    spot = np.zeros(SHAPE)
    spot[6, 8] = 1.0
    for band, wavelength in enumerate([6e-7, 4.5e-7]):
        kernel = lenses.airy(wavelength, n, 4e-6, 9)
        worst = 0.0
        for picture in (rng.uniform(0, 1, SHAPE), spot, 1 - spot):
            blurred = ndimage.convolve(picture, kernel, mode="nearest")
            worst = max(worst, np.abs(blurred - picture).max() * on_sensor.irradiance[band])
        assert worst <= rows["view.diffraction"].amount[band] * (1 + 1e-3)  # quadratures
        assert rows["view.diffraction"].amount[band] <= 1.01 * worst


@pytest.mark.sweep
@pytest.mark.parametrize("terms", [{4: 80e-9}, {4: 60e-9, 8: 90e-9}, {2: 150e-9, 11: 120e-9}])
def test_aberrations_change_no_pixel_by_more_than_their_bound(terms):
    """The reference sums over the pupil at 5 x 5 positions in each pixel. The worst case is one lit
    pixel."""
    wave, n, pitch, size = 6e-7, 8.0, 4e-6, 9
    coefficients = np.array([terms.get(j, 0.0) for j in range(1, 12)])
    view = s.ThinLens(np.zeros(3), np.eye(3), 0.05, pitch, resolution=SHAPE, f_number=n)
    view = replace(view, diffraction=s.Wavefront(coefficients, wave, size=size))
    rows, on_sensor = rows_of(view, [5.0])
    x = (np.arange(120) + 0.5) / 60 - 1
    rho, theta = np.hypot(x[:, None], x), np.arctan2(x[:, None], x)
    shapes = {
        2: 2 * rho * np.cos(theta),
        4: np.sqrt(3) * (2 * rho**2 - 1),
        8: np.sqrt(8) * (3 * rho**3 - 2 * rho) * np.cos(theta),
        11: np.sqrt(5) * (6 * rho**4 - 6 * rho**2 + 1),
    }
    error = sum(metres * shapes[j] for j, metres in terms.items())
    pupil = np.where(rho < 1, np.exp(2j * np.pi * error / wave), 0)
    at = ((np.arange(5 * size) + 0.5) / 5 - size / 2) * pitch
    waves = np.exp(-1j * np.pi * np.outer(at, x) / (wave * n))
    light = np.abs(waves @ pupil @ waves.T) ** 2
    kernel = light.reshape(size, 5, size, 5).sum((1, 3))
    kernel /= kernel.sum()
    spot = np.zeros(SHAPE)
    spot[6, 8] = 1.0
    blurred = [(ndimage.convolve(p, kernel, mode="nearest"), p) for p in (spot, 1 - spot)]
    worst = max(np.abs(b - p).max() for b, p in blurred) * on_sensor.irradiance[0]
    assert worst <= rows["view.diffraction"].amount[0] * (1 + 1e-3)  # quadratures
    assert rows["view.diffraction"].amount[0] <= 1.01 * worst


@pytest.mark.sweep
@pytest.mark.parametrize("ends", [(1.8, 5.4), (20.0, 60.0), (0.7, 70.0)])
def test_diffraction_of_a_free_aperture(ends):
    """The pictures are of one lit pixel at 9 f-numbers in the range, for patterns from far below a
    pixel to two pixels."""
    spot = jnp.zeros((*SHAPE, 1)).at[6, 8].set(1.0)
    views = [lens(f_number=n, diffraction=s.Diffraction(5.5e-7, size=9)) for n in ends]
    low, high = (replace(view, pixel_pitch=2e-5, focus_distance=None) for view in views)
    arriving = Arriving(np.ones(1), 1.0, math.inf, np.zeros(1))
    row = {r.effect.name: r for r in optics_stage(Ends(high, low), arriving)[0]}["view.diffraction"]
    worst, picture = 0.0, jax.jit(sensor_irradiance)
    for n in np.linspace(ends[0], ends[1], 9):
        blurred = picture(replace(low, f_number=n), spot)
        sharp = picture(replace(low, f_number=n, diffraction=None), spot)
        worst = max(worst, float(jnp.abs(blurred - sharp).max()))
    assert worst <= row.amount[0] * (1 + 1e-4)
    most = 1 - middle_pixel_share(np.array(5.5e-7 * ends[1] / 2e-5))
    open_widest = math.pi / 4 / ends[0] ** 2
    assert row.amount[0] <= open_widest * most + open_widest * 3e-5
    if ends[1] < 10 * ends[0]:  # the pattern is narrowest at the widest aperture
        assert row.amount[0] <= (ends[1] / ends[0]) ** 2 * 1.1 * worst


@pytest.mark.parametrize("width", [0.02, 0.3, 1.0, 4.0])
def test_share_of_airys_pattern_on_a_pixel(width):
    """The reference integrates the pattern by quadrature over a quarter of the pixel."""

    def in_row(y):
        x = lambda r: math.pi * r / width  # noqa: E731
        return integrate.quad(
            lambda z: (2 * special.j1(x(math.hypot(y, z))) / x(math.hypot(y, z))) ** 2,
            0,
            0.5,
            limit=400,
        )[0]

    steps = 400
    y = (np.arange(steps) + 0.5) / steps / 2
    share = 4 * sum(map(in_row, y)) / steps / 2 * math.pi / (2 * width) ** 2
    np.testing.assert_allclose(
        middle_pixel_share(np.array(width)), share, atol=2e-4 if width < 0.1 else 1e-5
    )


@pytest.mark.parametrize("seeds", [range(6), pytest.param(range(100), marks=pytest.mark.slow)])
def test_a_defocused_pixel_is_between_the_extremes_within_its_bound(seeds):
    """A painted plane and a half plane in front of it are traced through the lens in NumPy. Each
    pixel is between the extremes of the sharp picture within `place` pixels."""
    ratios = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        f_number, focus = rng.uniform(1, 16), rng.uniform(0.5, 10)
        depths = np.sort(rng.uniform(0.5, 20, 2))
        pitch = rng.uniform(2e-5, 2e-4)
        view = replace(lens(f_number=f_number, focus_distance=focus), pixel_pitch=pitch)
        place = rows_of(view, near=depths[0], far=depths[1], samples=SAMPLES)[0]["view.defocus"]
        place = place.effect.place
        image = distance_to_sensor(focus)
        points = lenses.disc(FOCAL / f_number / 2, rings=6)
        edge = rng.uniform(-2, 2) * pitch / image  # of the near half plane, as a slope
        stripes = rng.uniform(2, 8) * pitch / image

        def colour(slope, at, edge=edge, stripes=stripes, depths=depths):
            """Return the radiance seen by a ray, given as slopes at both depths."""
            near = slope[0][..., 0] < edge
            return np.where(near, 5.0, (slope[1][..., 1] / stripes) % 1)

        farthest = 0.0
        for column in (-3, 0, 2):
            t = np.array([column * pitch / image, 0.3 * pitch / image])
            hits = [lenses.through(points, t, z, 1 / focus) / z for z in depths]
            seen = colour(hits, t).mean()
            farthest = max(farthest, *(np.hypot(*(h - t).T).max() * image / pitch for h in hits))
            around = t + lenses.disc((place + 1e-9) * pitch / image, rings=40)
            sharp = colour([around, around], t)
            assert sharp.min() - 1e-9 <= seen <= sharp.max() + 1e-9
        assert farthest <= place * (1 + 1e-6)
        ratios.append(place / farthest)
    assert np.median(ratios) <= 1.2


def test_a_lens_that_hardly_blurs_becomes_a_pinhole_as_bright():
    view = lens(aperture=s.PolygonalAperture(6), f_number=8.0)
    rows, _ = rows_of(view, near=1.99, far=2.01, samples=SAMPLES)
    row = rows["view.defocus"]
    assert row.drop is not None
    draft = Draft((), (), frozenset(), None, s.Camera(view, s.Sensor()), samples=SAMPLES)
    hole = row.drop(draft).camera.view
    assert isinstance(hole, s.Pinhole)
    hexagon = 1.5 * math.sqrt(3) * (FOCAL / 16) ** 2
    open_ = math.pi / 4 / float(hole.f_number) ** 2
    assert open_ == pytest.approx(hexagon / distance_to_sensor() ** 2)
    assert float(hole.focal_length) == pytest.approx(distance_to_sensor())


def test_surfaces_that_touch_the_lens_are_kept():
    row = rows_of(lens(), near=0.0, samples=SAMPLES)[0]["view.defocus"]
    assert row.drop is None
    assert row.effect.place == math.inf


@pytest.mark.slow
def test_a_rim_is_dropped_before_its_lens():
    view = lens(rim=s.Rim(0.01, 0.2), diffraction=s.Diffraction(5e-7, size=3))
    row = rows_of(view, samples=SAMPLES)[0]["view.defocus"]
    assert row.needs == {"view.rim", "view.diffraction"}


def test_defocus_is_bounded_over_the_box_of_free_parameters():
    rng = np.random.default_rng(4)
    low, high = lens(f_number=2.0, focus_distance=1.0), lens(f_number=8.0, focus_distance=4.0)
    most = defocus(Ends(low, high), 0.7, 30.0)
    for _ in range(20):
        n, focus, z = rng.uniform(2, 8), rng.uniform(1, 4), rng.uniform(0.7, 30)
        hit = lenses.through(lenses.disc(FOCAL / n / 2, 8), np.zeros(2), z, 1 / focus) / z
        assert np.hypot(*hit.T).max() * distance_to_sensor(focus) / PITCH <= most


def test_oversampling_and_samples_stay_within_a_pixel():
    view = s.Pinhole(np.zeros(3), np.eye(3), FOCAL, PITCH, resolution=SHAPE, f_number=4.0)
    rows, on_sensor = rows_of(view, samples=SAMPLES, oversampling=4)
    row = rows["sensor.pixel_aperture.oversampling"]
    corner = math.hypot(3 / 8, 3 / 8)
    assert row.effect.place == pytest.approx(corner)
    assert rows["samples"].effect.place == pytest.approx(math.sqrt(0.5))
    fine = lenses.slopes((48, 64), PITCH / 4, FOCAL)
    coarse = lenses.slopes(SHAPE, PITCH, FOCAL)
    fall = (1 + (fine**2).sum(0)) ** -2 - np.kron((1 + (coarse**2).sum(0)) ** -2, np.ones((4, 4)))
    assert np.abs(fall).max() * on_sensor.opening <= row.amount[0]


def test_every_field_of_a_view_has_its_row_or_cannot_be_dropped():
    """Position, direction, field of view, resolution and exposure of a camera cannot be dropped.
    The focus of a lens is dropped with its defocus."""
    place = {"position", "rotation", "pixel_pitch", "resolution", "focal_length"}
    kept = place | {"f_number", "focus_distance", "aperture"}
    for view in (s.Pinhole, s.ThinLens, s.Orthographic):
        for field in fields(view):
            assert (field.name in kept) != (field.name in BOUNDS), field.name
    assert "defocus" in BOUNDS


@pytest.mark.slow
def test_the_rim_is_kept_if_the_light_has_no_bound():
    """Trap 7: infinity times a rounded 0 must not drop anything."""
    row = rows_of(lens(rim=s.Rim(0.03, 0.012)), [math.inf])[0]["view.rim"]
    assert row.effect.bound == math.inf
    assert row.drop is None
