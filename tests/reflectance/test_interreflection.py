"""Tests normals of hollows with interreflection: a bowl, where it has a closed form, and a groove,
where it is an integral over the other plate."""

import numpy as np
import pytest

from fitting.reflectance import photometric_stereo
from fitting.reflectance.stereo.interreflection import _integrated, exchange_of
from jaxvision.errors import InputError

CAP = np.radians(60)


def hemisphere(count, lowest):
    """Return unit directions, uniform over the upper hemisphere down to z = lowest."""
    i = np.arange(count) + 0.5
    z, turn = lowest + (1 - lowest) * i / count, np.pi * (1 + np.sqrt(5)) * i
    return np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)


def bowl(lights, albedo, size=30):
    """Return readings relative to white, and normals, of the inside of a sphere to 60 degrees.

    A form factor in a sphere is a share of its area, so all points receive albedo F / (1 - albedo
    F) of the mean direct irradiance, with F = 1/4, the cap's share."""

    def direct(normals):
        cosine = lights @ normals.T
        leaves = 2 * cosine * lights[:, 2:] - normals[:, 2]  # z where the ray leaves the sphere
        return np.where((cosine > 0) & (leaves > -np.cos(CAP)), cosine, 0)

    v, u = (np.mgrid[:size, :size] - (size - 1) / 2) * 2 * np.sin(CAP) / size
    inside = np.hypot(u, v) < np.sin(CAP)
    normals = np.stack([-u, v, np.sqrt(np.maximum(1 - u**2 - v**2, 0))], axis=-1)
    normals = np.where(inside[..., None], normals, np.nan)
    wall = hemisphere(20_000, np.cos(CAP))
    mean = np.array([direct_one.mean() for direct_one in direct(wall)])
    read = direct(normals.reshape(-1, 3)) + (albedo / 4 / (1 - albedo / 4) * mean)[:, None]
    return albedo * np.where(inside, read.reshape(-1, size, size), np.nan), normals


def seen_plate(along, y, length):
    """Return form factors from points of a plate to cells of a perpendicular plate, which touch at
    along = 0, and the centres of the cells.

    The integral along the edge has a closed form. Across the edge it is by Gauss-Legendre
    quadrature in panels that halve towards it."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    ends = np.r_[0, 2.0 ** np.arange(-5, 1)]
    place = ((ends[1:] + ends[:-1])[:, None] / 2 + np.diff(ends)[:, None] / 2 * nodes).ravel()
    weight = (np.diff(ends)[:, None] / 2 * weights).ravel()
    sides = np.linspace(-length / 2, length / 2, 25)
    square = along[:, None] ** 2 + place**2
    root = np.sqrt(square)[..., None]
    apart = sides - y[:, None, None]
    whole = apart / (2 * root**2 * (root**2 + apart**2)) + np.arctan(apart / root) / (2 * root**3)
    factors = (along[:, None] * place * weight / np.pi)[..., None] * np.diff(whole, axis=-1)
    cells = np.meshgrid(place, (sides[1:] + sides[:-1]) / 2, indexing="ij")
    return factors.reshape(len(along), -1), [one.ravel() for one in cells]


def groove(lights, albedo, size=30):
    """Return readings relative to white, and normals, of two perpendicular plates of width 1 and
    length sqrt(2), lit by all lights."""
    x = (np.arange(size) + 0.5) / size * 2 - 1
    normal = np.sqrt(0.5) * np.array([[1.0, 0, 1], [-1, 0, 1]])  # of the left and right plates
    direct = lights @ normal.T
    assert (direct > 0).all()
    where = np.abs(np.tile(x, size)), np.repeat(-x, size) / np.sqrt(2)
    _, cells = seen_plate(*(one[:1] for one in where), np.sqrt(2))
    between = albedo * seen_plate(*cells, np.sqrt(2))[0]
    n = len(between)
    system = np.block([[np.eye(n), -between], [-between, np.eye(n)]])
    sent = np.linalg.solve(system, albedo * np.repeat(direct.T, n, axis=0)).reshape(2, n, -1)
    side = np.tile(x > 0, size).astype(int)
    factors = seen_plate(*where, np.sqrt(2))[0]
    received = np.where(side[:, None] == 0, factors @ sent[1], factors @ sent[0])
    read = albedo * (direct[:, side].T + received)
    return read.T.reshape(-1, size, size), normal[side].reshape(size, size, 3)


def covered(scene, albedo, count, lowest, white=None, seed=3, size=30, **options):
    """Return the share of normals in their cones, the median error in degrees, and the result."""
    lights = hemisphere(count, lowest)
    read, normals = scene(lights, albedo, size)
    images = 1000 * read / albedo + np.random.default_rng(seed).normal(0, 2, read.shape)
    found = photometric_stereo(images, lights, white=white, **options)
    off = np.linalg.norm(found.normals - normals, axis=-1)
    known = np.isfinite(off) & np.isfinite(found.normal_sd)
    inside = np.mean((off < 2.448 * found.normal_sd)[known])
    return inside, float(np.degrees(np.median(off[known]))), found


def test_slopes_are_integrated_to_heights_of_a_sphere():
    v, u = (np.mgrid[:24, :24] - 11.5) / 20
    normals = np.stack([-u, v, np.sqrt(1 - u**2 - v**2)], axis=-1)
    height = _integrated(normals, np.ones((24, 24), bool), 1)[0]
    off = height + 20 * normals[..., 2]
    assert np.ptp(off) < 0.02  # for 12 pixels of depth
    assert exchange_of(normals * [-1, -1, 1]) is None  # it is convex


@pytest.mark.slow
def test_form_factors_in_a_sphere_are_its_area_shares():
    normals = bowl(hemisphere(3, 0.5), 0.5, 40)[1]
    received = exchange_of(normals).irradiance(np.ones((1, 40, 40)))[0]
    np.testing.assert_allclose(received[np.isfinite(normals[..., 0])], 0.25, atol=0.012)


def test_the_simulated_plates_have_the_form_factor_of_perpendicular_squares():
    """Each receives .20004 of the other's light, by the closed form of perpendicular unit
    squares."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    at = [one.ravel() for one in np.meshgrid((nodes + 1) / 2, nodes / 2)]
    mean = np.outer(weights, weights).ravel() / 4 @ seen_plate(*at, 1.0)[0].sum(axis=1)
    assert mean == pytest.approx(0.20004, abs=2e-4)


@pytest.mark.slow
def test_the_interreflection_of_a_bowl_is_stated_and_removed():
    plain = covered(bowl, 0.6, 6, 0.6, size=16, robust=False)
    assert plain[0] < 0.5
    assert "hollow, whose parts light each other" in str(plain[2])
    inside, off, found = covered(bowl, 0.6, 6, 0.6, 1000 / 0.6, size=16, robust=False)
    assert inside > 0.9
    assert off < plain[1] / 10
    assert "Without this light, normals are rotated by" in str(found)


@pytest.mark.slow
@pytest.mark.parametrize("albedo", [0.3, 0.6])
@pytest.mark.parametrize(("scene", "lowest"), [(bowl, 0.5), (bowl, 0.1), (groove, 0.8)])
@pytest.mark.parametrize("count", [8, 24])
def test_the_cone_covers_without_interreflection(scene, lowest, albedo, count):
    plain = covered(scene, albedo, count, lowest)
    inside, off, found = covered(scene, albedo, count, lowest, 1000 / albedo)
    assert "Without this light, normals are rotated by" in str(found)
    assert inside > 0.9
    assert off < 0.2 * plain[1]


@pytest.mark.parametrize(
    "options",
    [{"points": np.ones((8, 8, 3))}, {"viewer": (0.6, 0, 0.8)}],
)
def test_white_needs_the_cameras_axes(options):
    lights = hemisphere(6, 0.5) * (5 if "points" in options else 1)
    with pytest.raises(InputError, match="white needs distant lights, and axes with z toward"):
        photometric_stereo(np.ones((6, 8, 8)), lights, white=2.0, **options)


@pytest.mark.parametrize(
    "numbers", [{"white": 0.0}, {"white": np.nan}, {"white": 1, "white_sd": -1}]
)
def test_white_must_be_positive(numbers):
    with pytest.raises(InputError, match="white must be above 0, and white_sd at least 0"):
        photometric_stereo(np.ones((6, 8, 8)), hemisphere(6, 0.5), **numbers)
