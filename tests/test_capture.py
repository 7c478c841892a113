"""The whole path against a naive loop, and proof that what is absent leaves nothing behind."""

import re
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import loops

from jaxvision import (
    DirectionalLight,
    GaussianLobe,
    IsotropicTable,
    Lambert,
    Phong,
    PointLight,
    as_dtype,
)
from jaxvision import scene as s
from jaxvision.capture import capture, render
from jaxvision.optics import look_at

BANDS = 3
ROTATION = look_at(
    jnp.asarray([0.0, -4, 1.5]), jnp.asarray([0.0, 0, 1.2]), jnp.asarray([0.0, 0, 1])
)
PINHOLE = s.Pinhole([0, -4, 1.5], ROTATION, 0.05, 0.004, resolution=(10, 12))
PARALLEL = s.Orthographic([0, -4, 1.5], ROTATION, 0.25, resolution=(10, 12))
KD, KS, KA = [0.2, 0.15, 0.1], [0.1, 0.2, 0.3], [0.5, 0.6, 0.7]
SURFACES = [
    s.Surface(s.Plane([0, 0, 0], [0, 0, 1]), Lambert(KD, ambient=KA)),
    s.Surface(s.Sphere([-0.9, 0, 0.6], 0.6), Phong(KD, KS, 15.0)),
    s.Surface(s.Sphere([0.9, 0, 0.5], 0.5), Phong(KS, KD, 40.0)),
    s.Surface(s.Sphere([0, 1, 0.8], 0.8), GaussianLobe(KA, KS, 4.0, ambient=KD)),
]
LIGHTS = [PointLight([2, -2, 4], [9.0, 8.0, 7.0]), DirectionalLight([-1, -1, 1], [0.5] * 3)]
SCENE = s.Scene(SURFACES, LIGHTS, s.AmbientLight([0.1, 0.2, 0.3]))
LAMBERT_ONLY = s.Scene([s.Surface(surface.shape, Lambert(KD)) for surface in SURFACES], LIGHTS[:1])


def plain_scene():
    """The same scene for the loop."""
    surfaces = []
    for surface in SURFACES:
        shape, m = surface.shape, surface.material
        material = {"kind": type(m).__name__.lower().removesuffix("lobe")}
        for name in ("diffuse", "specular", "exponent", "concentration", "ambient"):
            if getattr(m, name, None) is not None:
                material[name] = np.asarray(getattr(m, name))
        if isinstance(shape, s.Sphere):
            fields, meet = (np.asarray(shape.centre), float(shape.radius)), loops.sphere
        else:
            fields, meet = (np.asarray(shape.point), np.asarray(shape.normal)), loops.plane
        surfaces.append((lambda o, d, meet=meet, fields=fields: meet(o, d, *fields), material))
    lights = [
        {"kind": "point", "position": np.array([2.0, -2, 4]), "intensity": [9.0, 8, 7]},
        {"kind": "directional", "direction": [-1.0, -1, 1], "irradiance": [0.5] * 3},
    ]
    return surfaces, lights, np.array([0.1, 0.2, 0.3])


def plain_rays(view):
    right, down, forward = np.asarray(view.rotation)
    pitch, rays = float(view.pixel_pitch), []
    for i in range(10):
        rays.append([])
        for j in range(12):
            offset = (j - 5.5) * pitch * right + (i - 4.5) * pitch * down
            if isinstance(view, s.Pinhole):
                rays[-1].append(
                    (
                        np.asarray(view.position),
                        loops.unit(offset + float(view.focal_length) * forward),
                    )
                )
            else:
                rays[-1].append((np.asarray(view.position) + offset, forward))
    return rays


# Correctness needs no optimised code: this compiles three times faster.
quick_jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
draw = quick_jit(render)


@pytest.mark.parametrize("view", [PINHOLE, PARALLEL], ids=["pinhole", "orthographic"])
def test_picture_against_the_naive_loop(view):
    expected = loops.render(*plain_scene(), plain_rays(view), BANDS)
    assert (expected == 0).all(axis=-1).any()  # shadowed, or in the pinhole view the sky
    assert (expected > 0).all(axis=-1).mean() > 0.5
    np.testing.assert_allclose(draw(SCENE, view), expected, rtol=1e-9, atol=1e-12)


def test_float32_picture_is_close_and_stays_float32():
    small = draw(as_dtype(SCENE, jnp.float32), as_dtype(PINHOLE, jnp.float32))
    assert small.dtype == jnp.float32
    np.testing.assert_allclose(small, draw(SCENE, PINHOLE), rtol=2e-4, atol=1e-5)


def test_stages_fit_together():
    """1 W m^-2 sr^-1 through f/2 is pi / 16 W m^-2 on the axis; then by hand to DN and to sRGB."""
    wall = s.Surface(s.Plane([0, 0, 2], [0, 0, -1]), Lambert([0.0], ambient=[1.0]))
    scene = s.Scene([wall], [], s.AmbientLight([1.0]))
    view = s.Pinhole([0, 0, 0], np.eye(3), 1, 1e-9, resolution=(1, 1), f_number=2)
    sensor = s.Sensor(exposure_time=10.0, gain=800.0, offset=64.0, bits=12)
    development = s.Development(black_level=64, white_level=64 + 4 * 785, tone=s.SRGB())
    shot = quick_jit(capture)(None, scene, s.Camera(view, sensor, development))
    np.testing.assert_allclose(shot.radiance, [[[1.0]]], rtol=1e-15)
    np.testing.assert_allclose(shot.irradiance, [[[np.pi / 16]]], rtol=1e-15)
    assert float(shot.raw[0, 0, 0]) == round(np.pi / 16 * 8000 + 64)  # 1635
    grey = (1635 - 64) / (4 * 785)
    np.testing.assert_allclose(shot.picture, [[[loops.srgb_encode(grey)]]], rtol=1e-14)
    undeveloped = jax.eval_shape(capture, None, scene, s.Camera(view, sensor))
    assert undeveloped.picture is None


def test_keys_draw_what_they_should():
    sensor = s.Sensor(exposure_time=100.0, prnu=0.1, read_noise=1.0)
    camera = s.Camera(PINHOLE, sensor)
    a, b = jax.random.split(jax.random.key(0))
    take = quick_jit(lambda key, die: capture(key, SCENE, camera, die_key=die).raw)
    first, again, other_frame, other_die = take(a, b), take(a, b), take(b, b), take(a, a)
    np.testing.assert_array_equal(first, again)
    assert (first != other_frame).all()
    lit = draw(SCENE, PINHOLE) > 0
    assert (first != other_die)[lit].all()
    np.testing.assert_array_equal(first[~lit], other_die[~lit])


def test_sweep_over_exposure_batches_with_a_leading_axis():
    camera = s.Camera(PINHOLE, s.Sensor(gain=2.0))
    times = jnp.asarray([0.5, 1.0, 2.0])

    def shoot(t):
        sensor = replace(camera.sensor, exposure_time=t)
        return capture(None, SCENE, replace(camera, sensor=sensor)).raw

    raws = quick_jit(jax.vmap(shoot))(times)
    np.testing.assert_allclose(raws, times[:, None, None, None] * raws[1:2], rtol=1e-15)


def test_gradients_of_the_picture_are_finite_and_right():
    gradient = quick_jit(jax.grad(lambda scene: render(scene, PINHOLE).sum()))(SCENE)
    assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    # the picture is linear in the ground's kd: the gradient is the finite difference
    kd = jnp.asarray(KD)
    black = s.Surface(SURFACES[0].shape, Lambert(0 * kd, ambient=KA))
    without = replace(SCENE, surfaces=(black, *SURFACES[1:]))
    difference = draw(SCENE, PINHOLE).sum() - draw(without, PINHOLE).sum()
    slope = gradient.surfaces[0].material.diffuse @ kd
    np.testing.assert_allclose(slope, difference, rtol=1e-10)


# ------------------------------------------------ only what the scene calls for

TRANSCENDENTAL = r"\b(exp|exp2|log|log1p|pow|integer_pow|atan2|sin|cos)\b"
RANDOM = r"random_bits|threefry|random_wrap|random_fold_in"


def program(function, *arguments):
    return str(jax.make_jaxpr(function)(*arguments))


def test_lambert_alone_traces_no_lobe():
    assert not re.search(TRANSCENDENTAL, program(render, LAMBERT_ONLY, PINHOLE))
    assert re.search(r"\bexp\b", program(render, SCENE, PINHOLE))


def test_a_noiseless_sensor_traces_no_random_bits():
    def shoot(camera):
        return capture(jax.random.key(0), LAMBERT_ONLY, camera).raw

    quiet = s.Sensor(gain=1.0, bits=8.0, full_well=1e4, dark_current=1.0)
    text = program(lambda c: capture(None, LAMBERT_ONLY, c).raw, s.Camera(PINHOLE, quiet))
    assert not re.search(RANDOM, text)
    noisy = program(shoot, s.Camera(PINHOLE, replace(quiet, read_noise=1.0)))
    assert re.search(RANDOM, noisy)


def test_an_absent_adc_does_not_round_and_absent_ambient_does_not_select():
    bare = program(lambda c: capture(None, LAMBERT_ONLY, c).raw, s.Camera(PINHOLE, s.Sensor()))
    with_adc = s.Camera(PINHOLE, s.Sensor(bits=8))
    assert "round" not in bare
    assert "round" in program(lambda c: capture(None, LAMBERT_ONLY, c).raw, with_adc)
    unlit = replace(SCENE, ambient=None)
    assert len(program(render, unlit, PINHOLE)) < len(program(render, SCENE, PINHOLE))
    # ambient light that no material reflects leaves the program as it was
    useless = replace(LAMBERT_ONLY, ambient=SCENE.ambient)

    def equations(scene):
        return len(jax.make_jaxpr(render)(scene, PINHOLE).jaxpr.eqns)

    assert equations(useless) == equations(LAMBERT_ONLY)


def test_one_compilation_serves_lights_and_materials():
    traced = []

    @jax.jit
    def shoot(scene):
        traced.append(1)
        return render(scene, PINHOLE)

    for exponent in (5.0, 500.0, np.float64(2)):
        ball = s.Surface(s.Sphere([0, 0, 1], exponent / 500), Phong(KD, KS, exponent))
        shoot(s.Scene([ball], LIGHTS))
    assert len(traced) == 1


def test_a_measured_material_is_not_copied_for_every_pixel():
    """Two tables of 2 MB on 64 x 64 pixels: what is in memory stays near the tables' size."""
    angles = jnp.linspace(0.0, 1.5, 25)
    table = IsotropicTable(
        angles, angles, jnp.linspace(0.0, 3.1, 26), jnp.full((25, 25, 26, 16), 0.2)
    )
    balls = [s.Surface(s.Sphere((x, 0.0, 0.0), 0.5), table) for x in (-0.5, 0.5)]
    scene = s.Scene(balls, [DirectionalLight((0.0, 0.0, 1.0), np.ones(16))])
    view = s.Orthographic((0.0, 0.0, 5.0), np.diag([1.0, -1.0, -1.0]), 0.03, resolution=(64, 64))
    compiled = jax.jit(render).lower(scene, view).compile()
    assert compiled.memory_analysis().temp_size_in_bytes < 100e6
