"""Tests maps of a material: means over boxes equal a loop over texels, a checker through a pinhole
has a closed form, and normal maps keep reflection above the horizon."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision import effects
from jaxvision.rendering.maps import shading_normal
from jaxvision.transport import radiosity

CARD = jv.Quad([-1, -1, 2], [0, 2, 0], [2, 0, 0])  # faces the origin, with u along y
SUN = jv.DirectionalLight([0, 0, -1], [1.0])
VIEW = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 0.013, resolution=(60, 60))


def hat(t):
    """Return the integral of the hat function up to t."""
    return np.where(
        t <= -1, 0, np.where(t <= 0, (t + 1) ** 2 / 2, np.where(t <= 1, 1 - (1 - t) ** 2 / 2, 1))
    )


def shares(a, b, count, wrap):
    """Return the weight of each texel in the mean from a to b (in map widths) along one side."""
    a, b = a * count - 0.5, b * count - 0.5
    if wrap == "clamp":
        a, b = np.clip([a, b], -0.5, count - 0.5)
    found = np.zeros(count)
    for i in range(int(np.floor(a)) - 1, int(np.ceil(b)) + 2):
        own = i % count if wrap == "repeat" else min(max(i, 0), count - 1)
        found[own] += (hat(b - i) - hat(a - i)) / (b - a)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_means_equal_a_loop_over_texels(wrap):
    """The boxes are from a hundredth of a texel to five map widths, for all borders."""
    rng = np.random.default_rng(0)
    values, n = rng.random((9, 5, 2)), 200
    places = rng.uniform(-0.3, 1.3, (n, 2)) if wrap == "repeat" else rng.uniform(0.05, 0.95, (n, 2))
    widths = 10 ** rng.uniform(-3, 0.7, (n, 2))
    cloth = jv.Lambert(jv.Map(values, wrap=wrap))
    found = jax.vmap(lambda uv, w: jv.material_at(cloth, uv, width=w).diffuse)(
        jnp.asarray(places), jnp.asarray(widths)
    )
    for got, (u, v), (across, down) in zip(found, places, widths, strict=True):
        x = shares(u - across / 2, u + across / 2, 5, wrap)
        y = shares(v - down / 2, v + down / 2, 9, wrap)
        np.testing.assert_allclose(got, np.einsum("r,c,rck->k", y, x, values), atol=4e-6)


def checker():
    """Return 8 x 8 tiles of 16 texels with k_d of 0.05 and 0.25, and the matrix from texels to
    pixels."""
    sign = np.where(np.arange(128) // 16 % 2, -1.0, 1.0)
    values = 0.15 - 0.1 * sign[:, None] * sign
    seen = (np.arange(60) - 29.5) * 0.013
    edges = ((2 * (seen + side) + 1) / 2 for side in (-0.0065, 0.0065))
    matrix = np.array([shares(a, b, 128, "repeat") for a, b in zip(*edges, strict=True)])
    return values, matrix


@pytest.mark.slow
def test_a_checker_through_a_pinhole_equals_its_closed_form():
    """The card is parallel to the image plane, so each pixel sees a rectangle of it."""
    values, matrix = checker()
    card = jv.Surface(CARD, jv.Lambert(jv.Map(values[..., None])))
    seen = jv.render(jv.Scene(card, SUN), VIEW)[..., 0]
    np.testing.assert_allclose(seen, matrix @ values.T @ matrix.T, atol=2e-6)


@pytest.mark.slow
def test_derivatives_by_texels_are_their_weights():
    values, matrix = checker()
    weight = np.random.default_rng(0).random((60, 60))

    def total(texels):
        card = jv.Surface(CARD, jv.Lambert(jv.Map(texels[..., None])))
        return (weight * jv.render(jv.Scene(card, SUN), VIEW)[..., 0]).sum()

    slope = jax.grad(total)(jnp.asarray(values))
    np.testing.assert_allclose(slope, (matrix.T @ weight @ matrix).T, atol=1e-5)


@pytest.mark.slow
def test_large_sums_are_accurate():
    """The box is small and in the far corner of a bright map of 1,500 x 1,500 texels, in
    float32."""
    values = np.random.default_rng(1).random((1500, 1500, 1)) + 50
    values[:750] += 100
    place, width = np.array([0.9913, 0.9937]), np.array([0.004, 0.003])
    wall, uv, box = jv.as_dtype(
        (jv.Lambert(jv.Map(values)), *map(jnp.asarray, (place, width))), "float32"
    )
    got = jv.material_at(wall, uv, width=box).diffuse[0]
    x, y = (
        shares(np.float32(p) - w / 2, np.float32(p) + w / 2, 1500, "repeat")
        for p, w in zip(place, width, strict=True)
    )
    assert float(got) == pytest.approx(y @ values[..., 0] @ x, rel=3e-6)


@pytest.mark.slow
def test_paths_and_many_samples_see_the_same_map():
    values, matrix = checker()
    card = jv.Surface(CARD, jv.Lambert(jv.Map(values[..., None])))
    scene, view = jv.Scene(card, SUN), replace(VIEW, resolution=(20, 20))
    want = (matrix @ values.T @ matrix.T)[20:40, 20:40]
    traced = jv.path_traced(jax.random.key(1), scene, view, method=jv.Paths(256, depth=2))
    off = (np.asarray(traced.radiance)[..., 0] - want) / np.maximum(traced.error[..., 0], 1e-4)
    assert np.sqrt((off**2).mean()) < 1.2  # samples of a pixel are stratified
    several = jv.render(scene, view, samples=jv.PixelSamples(jax.random.key(0), 256))
    np.testing.assert_allclose(several[..., 0], want, atol=4e-3)


def test_interpolated_values_equal_mitsubas():
    """Mitsuba 3.9.1's `bitmap` returns these values for 2 x 3 texels in float32, from 0 to 1 in
    fifths."""
    texels = (np.arange(6) / 5).reshape(2, 3, 1)
    places = [(0.1, 0.2), (0.5, 0.5), (0.93, 0.71), (-0.2, 1.4)]
    known = {"repeat": [0.14, 0.5, 0.836, 0.56], "clamp": [0.0, 0.5, 0.952, 0.6]}
    for wrap, wanted in known.items():
        cloth = jv.Lambert(jv.Map(texels, wrap=wrap))
        got = [float(jv.material_at(cloth, jnp.array(uv)).diffuse[0]) for uv in places]
        np.testing.assert_allclose(got, wanted, atol=1e-6)


def turned(x, y, z):
    """Return the card with a constant normal map."""
    normals = jv.Map(np.broadcast_to([x, y, z], (2, 2, 3)))
    return jv.Surface(CARD, jv.Lambert([1 / np.pi]), normals=normals)


@pytest.mark.slow
def test_a_normal_of_length_0_is_refused():
    some = np.broadcast_to([0.0, 0, 1], (3, 4, 3)).copy()
    some[1, 2:] = 0
    with pytest.raises(ValueError, match="normals has 2 of 12 normals of length 0"):
        jv.Surface(CARD, jv.Lambert([1 / np.pi]), normals=jv.Map(some))


@pytest.mark.slow
def test_a_normal_map_shades_like_a_tilted_surface():
    """x follows growing u, which is y in world coordinates. Here n x x is x in world
    coordinates."""
    middle = replace(VIEW, resolution=(1, 1))
    lamps = [jv.DirectionalLight(way, [1.0]) for way in ([0, 0.6, -0.8], [0.6, 0, -0.8])]
    for normal in ([0.0, 0.0, 2.0], [0.3, 0.0, 1.0], [0.1, -0.4, 1.0]):
        x, y, z = np.array(normal) / np.linalg.norm(normal)
        world = np.array([y, x, -z])
        for lamp in lamps:
            seen = float(jv.render(jv.Scene(turned(*normal), lamp), middle)[0, 0, 0])
            wanted = max(world @ np.asarray(lamp.direction), 0) / np.pi
            assert seen == pytest.approx(wanted, rel=1e-5)


def test_no_mirror_direction_is_below_the_surface():
    """Bent normals mirror the viewer to the horizon or above it. Others are unchanged."""
    rng = np.random.default_rng(0)
    normals, viewers = rng.normal(size=(2, 1000, 3))
    for w in (normals, viewers):
        w[:, 2] = np.abs(w[:, 2]) + 1e-3
        w /= np.linalg.norm(w, axis=1, keepdims=True)
    flat = jv.Vec(*jnp.array([0.0, 0.0, 1.0]))
    bent = jax.vmap(lambda n, w: jv.as_array(shading_normal(jv.as_vec(n), flat, jv.as_vec(w))))(
        jnp.asarray(normals), jnp.asarray(viewers)
    )
    before, after = (
        2 * (n * viewers).sum(1) * n[:, 2] - viewers[:, 2] for n in (normals, np.asarray(bent))
    )
    assert (before < -0.1).any()
    assert (after > -1e-6).all()
    assert np.allclose(np.linalg.norm(bent, axis=1), 1, atol=1e-6)
    kept = before > 1e-6
    np.testing.assert_allclose(np.asarray(bent)[kept], normals[kept], atol=1e-6)
    np.testing.assert_allclose(after[before < -1e-6], 0, atol=2e-6)


@pytest.mark.slow
def test_without_maps_their_code_is_not_compiled():
    """A map pruned to its mean gives the program of a plain material."""
    values = np.full((4, 4, 1), 0.2)
    values[0, 0] += 1e-6
    varied, plain = (
        jv.Scene(jv.Surface(CARD, jv.Lambert(k_d)), jv.PointLight([0, 0, 0], [1.0]))
        for k_d in (jv.Map(values), [0.2])
    )
    left = effects.prune(varied, VIEW, "0.1%").scene
    programs = [str(jax.make_jaxpr(jv.render)(scene, VIEW)) for scene in (left, plain, varied)]
    assert programs[0] == programs[1]
    assert len(programs[2]) > 1.2 * len(programs[1])


@pytest.mark.slow
def test_the_bound_of_a_map_is_near_the_effect_of_its_mean():
    """One texel is bright among dark ones, under a distant lamp. Nearly the whole range is lost
    there."""
    values = np.full((8, 8, 1), 0.02)
    values[4, 4] = 0.3
    scene = jv.Scene(jv.Surface(CARD, jv.Lambert(jv.Map(values))), SUN)
    view = replace(VIEW, pixel_pitch=jnp.array(0.004), resolution=(201, 201))
    row = next(
        e for e in effects.inspect(scene, view) if e.name == "surfaces[0].material.diffuse.map"
    )
    mean = jv.Scene(jv.Surface(CARD, jv.Lambert(values.mean((0, 1)))), SUN)
    change = float(np.abs(jv.render(scene, view) - jv.render(mean, view)).max())
    assert 0.5 * row.bound < change <= row.bound * (1 + 1e-6)


def test_unsupported_uses_of_maps_are_refused():
    grey = jv.Map(np.full((2, 2, 1), 0.2))
    with pytest.raises(ValueError, match=r"Disc has no texture coordinates; give Map\.uv"):
        jv.Surface(jv.Disc([0, 0, 0], [0, 0, 1], 1.0), jv.Lambert(grey))
    with pytest.raises(ValueError, match=r"Lambert\.diffuse is a Map.*material_at"):
        jv.brdf.albedo(jv.Lambert(grey), jnp.array([0.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match=r"Sphere\.radius must be plain numbers, got a Map"):
        jv.Sphere([0, 0, 0], grey)
    with pytest.raises(ValueError, match=r"Lambert\.diffuse must be at least 0"):
        jv.Lambert(jv.Map(np.full((2, 2, 1), -0.2)))
    with pytest.raises(ValueError, match="radiosity's patches"):
        radiosity.patches_of(
            jv.Scene(jv.Surface(CARD, jv.Lambert(grey)), SUN),
            radiosity.plan_patches(jv.Scene(jv.Surface(CARD, jv.Lambert(grey)), SUN), size=1.0),
        )
