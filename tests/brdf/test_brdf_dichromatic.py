"""Tests the separation of body and interface reflection (Shafer's model) on a rendered sphere, and
that failures of the separation are detectable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import nnls

import jaxvision as jv
from jaxvision.brdf.dichromatic import Dichromatic
from jaxvision.brdf.dichromatic_separation import (
    body_colour,
    illuminant_from_planes,
    plane_normal,
    separate,
    usable_pixels,
)
from jaxvision.brdf.lambert import Lambert
from jaxvision.brdf.mirror import Mirror
from jaxvision.brdf.phong import NormalisedPhong

RNG = np.random.default_rng(4)
separated = jax.jit(separate)
LIGHT = np.array([1.0, 0.9, 0.7])  # the illuminant's colour
RED, GREEN = np.array([0.8, 0.2, 0.15]), np.array([0.2, 0.7, 0.3])
BODY, LOBE = Lambert([1 / np.pi]), NormalisedPhong([0.0], [0.3], 30.0)
FLAT = np.ones(3)
VIEW = jv.Orthographic([0, 0, 0], np.eye(3), 2 / 44, resolution=(48, 48))
RENDER = jax.jit(lambda scene: jv.render(scene, VIEW))


def photograph(spectrum, *, body=BODY, interface=LOBE, light=LIGHT):
    """Return the radiance of a sphere, (48, 48, 3), black outside it."""
    ball = jv.Surface(jv.Sphere([0, 0, 3], 1.0), Dichromatic(body, interface, spectrum, [1.0]))
    return RENDER(jv.Scene([ball], [jv.DirectionalLight([0.5, 0.3, -1], 3 * light)]))


def terms(found):
    """Return both terms as pictures."""
    return (
        np.asarray(found.body)[..., None] * np.asarray(found.body_colour),
        np.asarray(found.interface)[..., None] * np.asarray(found.illuminant),
    )


def unit(v):
    return np.asarray(v) / np.linalg.norm(v)


@pytest.fixture(scope="module")
def red():
    """Return the picture and its two terms, each rendered without the other."""
    none = NormalisedPhong([0.0], [0.0], 30.0)
    return (
        photograph(RED),
        photograph(RED, interface=none),
        photograph(RED, body=Lambert([0.0])),
    )


@pytest.mark.slow
def test_a_rendered_picture_is_separated_into_its_terms(red):
    image, body, interface = red
    found = separate(image, jnp.asarray(LIGHT), body=jnp.asarray(RED * LIGHT))
    np.testing.assert_allclose(terms(found)[0], body, atol=1e-13)
    np.testing.assert_allclose(terms(found)[1], interface, atol=1e-13)
    np.testing.assert_allclose(found.residual, 0, atol=1e-13)
    cos = unit(RED * LIGHT) @ unit(LIGHT)
    np.testing.assert_allclose(found.angle, np.arccos(cos), rtol=1e-12)
    np.testing.assert_allclose(found.noise_gain, 1 / np.sin(np.arccos(cos)), rtol=1e-12)


@pytest.mark.slow
def test_the_body_colour_is_found_where_no_highlight_is(red):
    image, body, _ = red
    valid = usable_pixels(image, dark=0.05, saturated=10.0)
    got = body_colour(image, jnp.asarray(LIGHT), valid=valid)
    np.testing.assert_allclose(got, unit(RED * LIGHT), atol=1e-3)
    found = separate(image, jnp.asarray(LIGHT), valid=valid)
    np.testing.assert_allclose(terms(found)[0], body, atol=2e-3 * float(body.max()))


@pytest.mark.slow
def test_dim_pixels_count_little_for_the_body_colour():
    """Fifty dim pixels have no light of the illuminant, and bright pixels of the body (1, 2, 2) /
    3 mostly have highlights. The dim pixels have two per cent of the light and the smallest ratio
    of illuminant to body."""
    illuminant, across = np.array([1.0, 0, 0]), np.array([0, 1.0, 1.0]) / np.sqrt(2)
    body = np.array([1.0, 2, 2]) / 3
    highlights = np.linspace(0, 3, 150).clip(0.5)[:, None] - 0.5
    pixels = np.concatenate([np.full((50, 1), 1e-3) * across, body + highlights * illuminant])
    found = body_colour(jnp.asarray(pixels), jnp.asarray(illuminant))
    np.testing.assert_allclose(found, body, atol=1e-12)


def test_least_squares_with_non_negative_factors_against_scipy():
    """The noise moves pixels out of the wedge on every side. SciPy's `nnls` is the reference."""
    c = np.stack([unit([0.9, 0.3, 0.2]), unit(LIGHT)], axis=1)
    pixels = RNG.normal(0.1, 0.5, (200, 3))
    found = separated(jnp.asarray(pixels), jnp.asarray(LIGHT), body=jnp.asarray([0.9, 0.3, 0.2]))
    expected = [nnls(c, p) for p in pixels]
    np.testing.assert_allclose(found.body, [x[0] for x, _ in expected], atol=1e-12)
    np.testing.assert_allclose(found.interface, [x[1] for x, _ in expected], atol=1e-12)
    np.testing.assert_allclose(found.residual, [r for _, r in expected], atol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize("spectrum", [RED, [0.5, 0.45, 0.4]])
def test_noise_grows_as_promised(red, spectrum):
    """The standard deviation of both factors is `noise_gain` times the standard deviation of a
    band."""
    image = photograph(np.asarray(spectrum))
    clean = separated(image, jnp.asarray(LIGHT), body=jnp.asarray(spectrum * LIGHT))
    sigma = 1e-4
    noisy = image + sigma * jnp.asarray(RNG.normal(size=image.shape))
    found = separated(noisy, jnp.asarray(LIGHT), body=jnp.asarray(spectrum * LIGHT))
    inside = np.asarray((clean.body > 0.02) & (clean.interface > 0.02))
    assert inside.sum() > 100
    for got, true in ((found.body, clean.body), (found.interface, clean.interface)):
        gain = (got - true)[inside].std() / sigma
        np.testing.assert_allclose(gain, found.noise_gain, rtol=0.2)


@pytest.mark.parametrize("name", ["body", "interface"])
def test_a_mirror_as_body_or_interface_is_refused(name):
    parts = {"body": BODY, "interface": LOBE} | {name: Mirror([1.0])}
    with pytest.raises(ValueError, match=rf"Dichromatic\.{name} .* got Mirror, a delta function"):
        Dichromatic(*parts.values(), RED, [1.0])


def test_a_neutral_body_is_detected_as_inseparable(red):
    """Body and illuminant have the same colour. The angle is then 0, and the noise gain is huge."""
    image = photograph(FLAT * 0.5)
    found = separated(image, jnp.asarray(LIGHT))
    assert found.angle < 1e-6
    assert found.noise_gain > 1e6
    np.testing.assert_allclose(
        found.body + found.interface, np.sqrt((np.asarray(image) ** 2).sum(-1))
    )
    _, sizes = map(np.asarray, jax.jit(plane_normal)(image))
    assert sizes[1] < 1e-6 * sizes[2]


def test_a_wrong_illuminant_leaves_the_plane_or_mixes_the_terms(red):
    image, _, interface = red
    outside = separate(image, jnp.asarray([0.6, 0.9, 1.0]), body=jnp.asarray(RED * LIGHT))
    assert outside.residual.max() > 0.05 * image.max()
    tinted = LIGHT - 0.3 * RED * LIGHT
    inside = separate(image, jnp.asarray(tinted), body=jnp.asarray(RED * LIGHT))
    np.testing.assert_allclose(inside.residual, 0, atol=1e-12)  # the residual does not show it
    highlight = terms(inside)[1]
    assert jnp.abs(highlight - interface).max() > 0.1 * interface.max()


def test_clipped_pixels_leave_the_plane_and_are_masked(red):
    image = red[0]
    white = 0.6 * float(image.max())
    clipped = jnp.minimum(image, white)
    colours = jnp.asarray(LIGHT), jnp.asarray(RED * LIGHT)
    residual = separate(clipped, colours[0], body=colours[1]).residual
    usable = usable_pixels(clipped, dark=1e-6, saturated=white)
    assert residual.max() > 0.05 * white
    assert not usable[0, 0]
    np.testing.assert_allclose(jnp.where(usable, residual, 0), 0, atol=1e-13)


def test_two_materials_give_the_illuminant(red):
    """Lee's method finds the illuminant at the intersection of the dichromatic planes."""
    normals = []
    for image in (red[0], photograph(GREEN)):
        normal, sizes = plane_normal(image)
        np.testing.assert_allclose(normal @ unit(LIGHT), 0, atol=1e-12)
        assert sizes[0] < 1e-6 * sizes[1]
        normals.append(normal)
    colour, firmness = illuminant_from_planes(jnp.stack(normals))
    np.testing.assert_allclose(colour, unit(LIGHT), rtol=1e-9)
    assert firmness > 0.1
    assert illuminant_from_planes(jnp.stack([normals[0]] * 2))[1] < 1e-6


def test_wrong_shapes_are_named(red):
    with pytest.raises(ValueError, match=r"illuminant must have shape \(3,\), got \(2,\)"):
        separate(red[0], jnp.ones(2))
    with pytest.raises(ValueError, match=r"one pixel must have shape \(3,\)"):
        plane_normal(red[0][..., :2])
    with pytest.raises(ValueError, match="body must reflect in one band, got 2"):
        photograph(RED, body=Lambert([0.1, 0.2]))
