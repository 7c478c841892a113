"""Tests defocus by a depth map against sampling the lens by rays: equal on a plane, and measurably
different where one surface hides another."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import optics
from jaxvision import scene as s

EYE = np.eye(3)
R = 9
INNER = (slice(R + 1, -R - 1), slice(R + 1, -R - 1))
SHAPE = (40, 48)


def lens(aperture=None, focus=2.0):
    return s.ThinLens(
        [0, 0, 0], EYE, 0.05, 3e-5, resolution=SHAPE, f_number=2.0, focus_distance=focus,
        aperture=aperture or s.CircularAperture(),
    )  # fmt: skip


ROUND, TRIANGLE = lens(), lens(s.PolygonalAperture(3, angle=0.4))


def texture(x, y, pitch):
    """Return the pattern of a plane at a slope, (2,): waves about ten pixels long."""
    return jnp.stack(
        [
            0.5 + 0.3 * jnp.sin(400 * pitch * x + 1) * jnp.cos(300 * pitch * y),
            0.5 + 0.4 * jnp.cos(500 * pitch * (x + y)),
        ]
    )


def along(ray, planes):
    """Return (colour, depth) where a ray first hits a plane of (depth, covers x < , pitch)."""
    colour, depth = jnp.zeros(2), jnp.asarray(jnp.inf)
    for distance, end, pitch in reversed(planes):
        x = ray.origin.x + ray.direction.x / ray.direction.z * distance
        y = ray.origin.y + ray.direction.y / ray.direction.z * distance
        hit = x < end
        colour = jnp.where(hit, texture(x / distance, y / distance, pitch), colour)
        depth = jnp.where(hit, distance, depth)
    return colour, depth


@jax.jit
def pictures(view, planes):
    """Return (picture through the lens, sharp picture, depth), the first with 33 x 33 rays per
    pixel."""
    grid = (jnp.arange(33.0) + 0.5) / 33
    u = jnp.stack(jnp.meshgrid(grid, grid, indexing="ij"), -1).reshape(-1, 2)

    def blurred(row, column):
        def one(v):
            return along(optics.view_ray(view, row, column, u=v), planes)[0]

        return jax.vmap(one)(u).mean(0)

    def sharp(row, column):
        return along(optics.view_ray(view, row, column), planes)

    def over(pixel):
        lines = jax.vmap(jax.vmap(pixel, in_axes=(None, 0)), in_axes=(0, None))
        return lines(*optics.pixel_grid(view))

    return over(blurred), *over(sharp)


def rms(got, expected):
    return float(jnp.sqrt(((got - expected)[INNER] ** 2).mean()))


FORMS = {
    "gather": jax.jit(partial(optics.gather_defocus, radius=R, members=3)),
    "scatter": jax.jit(partial(optics.scatter_defocus, radius=R, members=3)),
    "layers": jax.jit(partial(optics.layered_defocus, radius=R, layers=2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("view", [ROUND, TRIANGLE], ids=["round", "triangle"])
@pytest.mark.parametrize("blur", [-R, 0, R])
def test_on_a_plane_all_methods_equal_the_sampled_lens(view, blur):
    """The blur is the largest for which the bank of three has a kernel."""
    image = 1 / (1 / 0.05 - 1 / 2.0)
    blur = blur * 8 / 9 if view is ROUND else blur
    distance = 1 / (1 / 2.0 + blur * 3e-5 / (0.0125 * image))
    through, sharp, depth = pictures(view, [(distance, jnp.inf, 1.0)])
    for name, form in FORMS.items():
        error = rms(form(view, sharp, depth), through)
        assert error < 2e-3, (name, error)
    if blur:
        assert rms(sharp, through) > 0.05
        if view is TRIANGLE:
            turned = lens(s.PolygonalAperture(3, angle=0.4 + np.pi))
            assert rms(FORMS["gather"](turned, sharp, depth), through) > 6e-3


@pytest.mark.slow
def test_at_occlusions_only_layers_are_accurate():
    """A blurred foreground is in front of a sharp background, or the opposite."""
    near = pictures(ROUND, [(1.3, 0.0, 1.0), (2.0, jnp.inf, 1.5)])
    errors = {name: rms(form(ROUND, *near[1:]), near[0]) for name, form in FORMS.items()}
    # measured: .039, .076 and .020
    assert errors["layers"] < 0.03 < errors["gather"] < errors["scatter"]
    far = pictures(ROUND, [(2.0, 0.0, 1.0), (4.0, jnp.inf, 1.5)])
    errors = {name: rms(form(ROUND, *far[1:]), far[0]) for name, form in FORMS.items()}
    assert errors["layers"] < 0.02
    assert errors["scatter"] > 0.05


@pytest.mark.sweep
@pytest.mark.parametrize("layers", [2, 8])
def test_a_post_thinner_than_its_blur_is_partly_transparent(layers):
    """Behind the centre of a black post in front of a white wall in focus, the post blocks a strip
    of the lens: 2 / pi (asin q + q sqrt(1 - q^2)) of a disc, with q the post's width over the
    blur."""
    half = 2.0  # half of the post, pixels
    columns = np.arange(SHAPE[1]) - (SHAPE[1] - 1) / 2
    post = np.broadcast_to(np.abs(columns) < half, SHAPE)
    focus, near = lens(), 1.4
    depth = jnp.where(post, near, 2.0)
    blur = float(optics.defocus_radius(focus, jnp.asarray(near)))
    picture = jnp.where(post, 0.0, 1.0)[..., None]
    form = partial(optics.layered_defocus, radius=12, layers=layers)
    found = jax.jit(form)(focus, picture, depth)[20, 23:25, 0]
    q = half / blur
    hidden = 2 / np.pi * (np.arcsin(q) + q * np.sqrt(1 - q * q))
    np.testing.assert_allclose(found, 1 - hidden, atol=0.03)


def random_scene():
    rng = np.random.default_rng(8)
    picture = jnp.asarray(rng.uniform(0, 1, size=(*SHAPE, 2)))
    return picture, jnp.asarray(rng.uniform(1.2, 6.0, size=SHAPE))


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("view", [ROUND, TRIANGLE], ids=["round", "triangle"])
def test_scattering_preserves_the_light_and_others_a_uniform_picture(view):
    picture, depth = random_scene()
    got = FORMS["scatter"](view, picture, depth)
    np.testing.assert_allclose(got.sum((0, 1)), picture.sum((0, 1)), rtol=1e-12)
    assert jnp.abs(got - picture).max() > 0.2
    flat = jnp.full((*SHAPE, 2), 0.7)
    for name in ("gather", "layers"):
        np.testing.assert_allclose(FORMS[name](view, flat, depth), 0.7, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("view", [ROUND, TRIANGLE], ids=["round", "triangle"])
def test_a_pixel_without_depth_counts_as_in_focus(view):
    picture = jnp.asarray(np.random.default_rng(3).uniform(size=(6, 7, 1)))
    depth = jnp.full((6, 7), 1.3).at[2, 3].set(jnp.nan)
    filled = depth.at[2, 3].set(view.focus_distance)
    for form in (optics.gather_defocus, optics.scatter_defocus):
        found = form(view, picture, depth, radius=2)
        np.testing.assert_allclose(found, form(view, picture, filled, radius=2), rtol=1e-9)
    found = optics.layered_defocus(view, picture, depth, radius=2, layers=3)
    wanted = optics.layered_defocus(view, picture, filled, radius=2, layers=3)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


@pytest.mark.slow
def test_each_band_of_a_chromatic_lens_has_its_own_focus():
    """A band of focal length f_b is in focus at the distance that it images onto the sensor."""
    picture, depth = random_scene()
    sensor = 1 / (1 / 0.05 - 1 / 2.0)
    focal = 0.0502
    focus = 1 / (1 / focal - 1 / sensor)
    other = s.ThinLens(
        [0, 0, 0], EYE, focal, 3e-5, resolution=SHAPE, f_number=2 * focal / 0.05,
        focus_distance=focus,
    )  # fmt: skip
    chromatic = jax.jit(partial(optics.chromatic_defocus, radius=R))
    got = chromatic(ROUND, picture, depth, jnp.asarray([0.05, focal]))
    plain, moved = (FORMS["gather"](view, picture, depth) for view in (ROUND, other))
    np.testing.assert_allclose(got[..., 0], plain[..., 0], rtol=1e-12)
    np.testing.assert_allclose(got[..., 1], moved[..., 1], rtol=1e-9)
    assert jnp.abs(plain - moved).max() > 0.05


@pytest.mark.slow
def test_invalid_defocus_is_refused():
    picture, depth = random_scene()
    with pytest.raises(ValueError, match="radius must be a whole number of at least 1, got 0"):
        optics.gather_defocus(ROUND, picture, depth, radius=0)
    with pytest.raises(ValueError, match="layers must be a whole number of at least 1, got 0"):
        optics.layered_defocus(ROUND, picture, depth, radius=3, layers=0)
    with pytest.raises(ValueError, match="members must be a whole number of at least 2, got 1"):
        optics.gather_defocus(TRIANGLE, picture, depth, radius=3, members=1)
    with pytest.raises(ValueError, match=r"focal_lengths must be \(2,\), one per band, got \(3,\)"):
        optics.chromatic_defocus(ROUND, picture, depth, jnp.full(3, 0.05), radius=3)
