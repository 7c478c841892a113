"""Tests records: arrays keep the caller's dtype, absent effects are `None`, and errors name
shapes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxvision import DirectionalLight, GaussianLobe, Lambert, Phong, PointLight
from jaxvision import scene as s

RED = [1.0, 0.5, 0.2]
EYE = np.eye(3)


def test_leaves_are_strong_arrays_of_the_callers_dtype():
    phong = Phong(np.float32(RED), np.float32(RED), np.float32(3))
    assert all(leaf.dtype == jnp.float32 for leaf in jax.tree.leaves(phong))
    camera = s.Camera(
        s.Pinhole([0, 0, 0], EYE, 1, 1, resolution=(2, 3)),
        s.Sensor(gain=2, shot_noise=s.PoissonShotNoise()),
        s.Development(tone=s.Gamma(2.2)),
    )
    for leaf in jax.tree.leaves(camera):
        assert leaf.dtype == jnp.result_type(float)
        assert not leaf.weak_type


def test_absent_effects_have_no_leaf():
    assert jax.tree.leaves(s.Sensor()) == []
    assert jax.tree.leaves(s.Sensor(shot_noise=s.GaussianShotNoise())) == []
    assert len(jax.tree.leaves(s.Sensor(gain=1.0, bits=8))) == 2
    assert len(jax.tree.leaves(Lambert(RED))) == 1
    assert len(jax.tree.leaves(Lambert(RED, ambient=RED))) == 2


def test_types_of_shot_noise_differ_in_structure():
    structures = {
        jax.tree.structure(s.Sensor(shot_noise=kind))
        for kind in (None, s.PoissonShotNoise(), s.GaussianShotNoise())
    }
    assert len(structures) == 3


def test_records_are_frozen():
    with pytest.raises(AttributeError):
        s.Sphere([0, 0, 0], 1).radius = 2


def test_records_of_equal_structure_batch():
    spheres = jax.tree.map(lambda *x: jnp.stack(x), *(s.Sphere([0, 0, i], i + 1) for i in range(4)))
    np.testing.assert_array_equal(jax.vmap(lambda b: b.radius + b.centre[2])(spheres), [1, 3, 5, 7])
    assert eqx.tree_at(lambda b: b.radius, spheres, jnp.zeros(4)).radius.shape == (4,)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PointLight([0, 0], RED), r"PointLight.position must have shape \(3,\), got \(2,"),
        (lambda: PointLight([0, 0, 0], 1), r"intensity must have shape \(bands,\), got \(\)"),
        (lambda: DirectionalLight([[0, 0, 1]], RED), r"direction .* got \(1, 3\)"),
        (lambda: s.AmbientLight(0.1), r"AmbientLight.radiance"),
        (lambda: s.Sphere([0, 0, 0], [1]), r"Sphere.radius must have shape \(\), got \(1,\)"),
        (lambda: s.Plane([0, 0, 0], [1]), r"Plane.normal"),
        (lambda: Lambert(RED, ambient=[1]), r"Lambert.ambient must have shape \(3,\), got \(1,\)"),
        (lambda: Phong(RED, [1, 2], 3), r"Phong.specular"),
        (lambda: Phong(RED, RED, [3]), r"Phong.exponent"),
        (lambda: GaussianLobe(RED, RED, RED), r"GaussianLobe.concentration"),
        (lambda: s.Orthographic([0, 0, 0], EYE[:2], 1, resolution=(1, 1)), r"\(3, 3\), got \(2, 3"),
        (lambda: s.Pinhole([0, 0, 0], EYE, [1], 1, resolution=(1, 1)), r"Pinhole.focal_length"),
        (lambda: s.Pinhole([0, 0, 0], EYE, 1, 1, resolution=(0, 4)), r"resolution .* got 0"),
        (lambda: s.Sensor(gain=RED), r"Sensor.gain must have shape \(\), got \(3,\)"),
        (lambda: s.Sensor(quantum_efficiency=EYE), r"\(\) or \(bands,\), got \(3, 3\)"),
        (lambda: s.PhotonConversion(5e-7, RED), r"PhotonConversion.pixel_area"),
        (lambda: s.Development(black_level=RED), r"Development.black_level"),
        (lambda: s.Gamma(RED), r"Gamma.gamma"),
        (lambda: s.Scene([], []), r"at least one surface"),
        (
            lambda: s.Scene(
                [s.Surface(s.Sphere([0, 0, 0], 1), Lambert(RED))], [PointLight([0, 0, 1], [1])]
            ),
            r"Scene.lights\[0\].* must have 3 bands, got 1",
        ),
    ],
)
def test_wrong_shapes_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
