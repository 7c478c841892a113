"""Tests that every type of light, material and shape is bounded, and every field of a scene has a
row or is a quantity that a row bounds. A new type or field fails here until it has one."""

from dataclasses import fields

import numpy as np
import pytest

import jaxvision as jv
from jaxvision import effects
from jaxvision.brdf import _registry as materials
from jaxvision.core._types import members_of
from jaxvision.effects import bodies
from jaxvision.lights import _registry as lights
from jaxvision.scene import shapes


def of_the_library(kinds):
    return {kind for kind in kinds if kind.__module__.startswith("jaxvision.")}


SHAPES = set(members_of(shapes.Shape))
KINDS = {
    kind.__name__: kind
    for kind in (
        jv.Scene,
        jv.Surface,
        jv.AmbientLight,
        *SHAPES,
        *of_the_library(materials.families()),
        *of_the_library(lights.kinds()),
    )
}

# Fields that are effects with rows. All others are positions, sizes and strengths that these rows
# bound.
ROWS = {
    "Scene": {"surfaces", "lights", "ambient", "occluders"},
    "Surface": {"material", "emission", "normals"},
    "TriangleMesh": {"normals"},
    "Glass": {"absorption"},
    "TorranceSparrow": {"specular", "interface"},
    "OrenNayar": {"sigma"},
    "EON": {"roughness"},
    "Mirror": {"reflectance"},
    "RectangleLight": {"edge_u", "edge_v"},
    **{
        f"{name}{kind}": {"specular"}
        for name in ("Phong", "Blinn", "GaussianLobe")
        for kind in ("", "BRDF")
    },
    "NormalisedPhong": {"specular"},
    "NormalisedBlinn": {"specular"},
    "Dichromatic": {"interface"},
}
LOBE = {"diffuse", "ambient", "exponent"}
GONIOMETRIC = {"intensity", "distribution", "vertical", "horizontal", "system"}
TABLE = {"values", "wavelengths", "sampler"}
QUANTITIES = {
    "Scene": {"rules"},
    "Surface": {"shape", "two_sided"},
    "AmbientLight": {"radiance"},
    "TriangleMesh": {"vertices", "faces", "uv"},
    "Sphere": {"centre", "radius"},
    "Plane": {"point", "normal"},
    "Disc": {"centre", "normal", "radius"},
    "Quad": {"corner", "edge_u", "edge_v"},
    "Box": {"centre", "half_extents", "rotation"},
    "Glass": {"index"},
    "Mirror": set(),
    "Lambert": {"diffuse", "ambient"},
    "TorranceSparrow": {"diffuse", "roughness", "ambient", "distribution", "shadowing"}
    | {"multiple_scattering"},
    "OrenNayar": {"diffuse", "ambient", "form"},
    "EON": {"diffuse", "ambient", "facet_albedo"},
    "Phong": LOBE,
    "PhongBRDF": LOBE,
    "NormalisedPhong": LOBE,
    "Blinn": LOBE,
    "BlinnBRDF": LOBE,
    "NormalisedBlinn": LOBE,
    "GaussianLobe": {"diffuse", "ambient", "concentration"},
    "GaussianLobeBRDF": {"diffuse", "ambient", "concentration"},
    "Coated": {"body", "interface", "roughness", "optical_depth", "distribution"},
    "Dichromatic": {"body", "body_spectrum", "interface_spectrum"},
    "HalfDifferenceTable": TABLE | {"interpolation"},
    "IsotropicTable": TABLE | {"theta_i", "theta_o", "phi", "azimuths", "outside", "reciprocal"},
    "AnisotropicTable": TABLE | {"theta_i", "phi_i", "theta_o", "phi_o", "outside", "reciprocal"},
    "RGL": {"values", "wavelengths", "scaled", "symmetry", "vndf", "ndf", "sigma", "theta", "phi"}
    | {"luminance"},
    "PointLight": {"position", "intensity"},
    "SmallLight": {"position", "normal", "intensity"},
    "DirectionalLight": {"direction", "irradiance"},
    "SunDisc": {"direction", "irradiance", "radius"},
    "SpotLight": {"position", "direction", "intensity", "inner", "outer", "falloff"},
    "GoniometricLight": {"position", "rotation"} | GONIOMETRIC,
    "GoniometricAreaLight": {"corner", "edge_u", "edge_v"} | GONIOMETRIC,
    "RectangleLight": {"corner", "radiance"},
    "LightFieldLight": {"aperture", "focal", "radiance"},
    "EnvironmentMap": {"radiance", "rotation", "rows", "columns", "density"},
}


def test_every_kind_of_light_material_and_shape_is_bounded():
    for own in (materials.families(), lights.kinds()):
        assert not [kind for kind in of_the_library(own) if own[kind].bound is None]
    x, y, z = np.eye(3)
    bounded = [
        jv.Sphere(x, 1.0),
        jv.Disc(x, z, 1.0),
        jv.Quad(x, y, z),
        jv.Box(x, [1.0, 1.0, 1.0]),
        jv.TriangleMesh(np.eye(3), [[0, 1, 2]]),
    ]
    assert {type(shape) for shape in bounded} | {jv.Plane} == SHAPES
    assert all(bodies.corners(shape) is not None for shape in bounded)


@pytest.mark.parametrize("name", sorted(KINDS))
def test_every_field_of_a_scene_has_its_row_or_is_a_quantity(name):
    own = {field.name for field in fields(KINDS[name])}
    assert own == ROWS.get(name, set()) | QUANTITIES[name]


@pytest.mark.slow
@pytest.mark.parametrize("depth", [None, 3])
def test_reflections_in_a_mirror_are_estimated_without_a_bound(depth):
    """A mirror at 45 degrees reflects half of a lamp of radiance 3 next to the floor."""
    tilted = np.array([0, 1, 1]) / np.sqrt(2)
    mirror = jv.Surface(jv.Disc([0, 0, 0], tilted, 0.5), jv.Mirror([0.5]))
    lamp = jv.RectangleLight([-2, 3, -2], [4, 0, 0], [0, 0, 4], [3.0, 2.0, 1.0])  # faces -y
    floor = jv.Surface(jv.Quad([-9, -9, -1], [18, 0, 0], [0, 18, 0]), jv.Lambert([0.0] * 3))
    down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    view = jv.Orthographic([0, 0, 2], down, 0.1, resolution=(16, 16))
    scene = jv.Scene([floor, mirror], lamp)
    assert float(jv.render(scene, view).max()) == pytest.approx(1.5)
    found = effects.inspect(scene, view, depth=depth, estimates=True)
    (bound, estimate) = (e for e in found if e.name == "surfaces[1].material")
    assert bound.bound == np.inf
    assert estimate.rank == "estimate"
    assert estimate.bound == pytest.approx(1.5)
    proved = effects.inspect(scene, view, depth=depth)
    assert [e for e in found if e.rank != "estimate"] == list(proved)
    pruned = effects.prune(scene, view, "90%", level=1.5, depth=depth, estimates=True)
    assert isinstance(pruned.scene.surfaces[1].material, jv.Mirror)


@pytest.mark.slow
def test_a_ball_of_glass_is_estimated_in_all_bands():
    """A black ball would hide a floor that emits. A clear one shows at least nine tenths of its
    light."""
    glow = np.array([1.0, 2.0, 3.0])
    floor = jv.Surface(jv.Quad([-9, -9, -1], [18, 0, 0], [0, 18, 0]), jv.Lambert([0.0] * 3), glow)
    ball = jv.Surface(jv.Sphere([0, 0, 0], 0.5), jv.Glass(1.5))
    view = jv.Orthographic([0, 0, 2], [[1, 0, 0], [0, -1, 0], [0, 0, -1]], 0.1, resolution=(16, 16))
    found = effects.inspect(jv.Scene([floor, ball], []), view, depth=6, estimates=True)
    (estimate,) = (e for e in found if e.name == "surfaces[1].material" and e.rank == "estimate")
    assert 2.7 < estimate.bound < 3.0001


@pytest.mark.slow
def test_estimates_are_changes_of_the_picture():
    """The bound of a lamp near a ball, as a point, is several times the brightest pixel of the
    picture."""
    ball = jv.Surface(jv.Sphere([0, 0, 0.5], 0.5), jv.Phong([0.2], [0.4], 80.0))
    floor = jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), jv.Lambert([0.2]))
    lamp = jv.RectangleLight([-0.5, -0.5, 1.6], [0, 1, 0], [1, 0, 0], [5.0])
    turned = jv.look_at([0, -4, 3], [0, 0, 0.5], [0, 0, 1])
    view = jv.Pinhole([0, -4, 3], turned, 1.0, 1 / 24, resolution=(24, 32))
    scene = jv.Scene([floor, ball], lamp)
    found = effects.inspect(scene, view, estimates=True)
    estimated = {e.name: e for e in found if e.rank == "estimate"}
    small = jv.SmallLight([0, 0, 1.6], [0, 0, -1], [5.0])
    less = {
        "lights[0].extent": jv.Scene([floor, ball], small),
        "surfaces[1].material.specular": jv.Scene(
            [floor, jv.Surface(ball.shape, jv.Lambert([0.2]))], lamp
        ),
    }
    assert estimated.keys() & less.keys()
    for name in estimated.keys() & less.keys():
        change = np.abs(
            np.asarray(jv.render(scene, view)) - np.asarray(jv.render(less[name], view))
        )
        assert estimated[name].bound == pytest.approx(change.max(), rel=1e-4)
        bound = next(e.bound for e in found if e.name == name)
        assert bound >= estimated[name].bound
