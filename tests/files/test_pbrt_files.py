"""Tests pbrt scenes: they equal the same scenes in Mitsuba's format and in TOML, and unsupported
content is refused by name."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import coat_walk, measured, mitsuba_pictures
from scene_texts import PBRT

import jaxvision as jv
from jaxvision import brdf
from jaxvision.errors import InputError
from jaxvision.files import read_scene
from jaxvision.files.images import write_image

SAME_AXES = "Scale -1 1 1 LookAt 0 -4 1.5  0 0 .5  0 0 1"  # right-handed, as in Mitsuba
FILM = 'Film "rgb" "integer xresolution" 16 "integer yresolution" 12 PixelFilter "box"'
HEAD = f'{SAME_AXES} Camera "perspective" "float fov" 40 {FILM}'
BALL = 'Shape "sphere"'


def read(folder, world, head=HEAD, name="a.pbrt"):
    (folder / name).write_text(f"{head}\nWorldBegin\n{world}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return read_scene(folder / name)


def same(one, other):
    """Check that two scenes have the same records, with numbers equal up to rounding."""
    for record, twin in ((one.scene, other.scene), (one.view, other.view)):
        assert jax.tree.structure(record) == jax.tree.structure(twin)
        for a, b in zip(jax.tree.leaves(record), jax.tree.leaves(twin), strict=True):
            np.testing.assert_allclose(a, b, rtol=2e-6, atol=2e-6)
    assert (one.render.integrator, one.render.samples, one.render.depth) == (
        *(other.render.integrator, other.render.samples, other.render.depth),
    )


def test_a_scene_equals_mitsubas(tmp_path):
    """The same camera, shapes, materials and lights in both formats make the same records."""
    (tmp_path / "corner.ply").write_text(mitsuba_pictures.CORNER)
    turned = '<scale value="2"/><rotate x="1" y="0" z="0" angle="50"/><translate x="1" y=".3"/>'
    (tmp_path / "a.xml").write_text(
        f"""<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="4"/>
        </integrator>{
            mitsuba_pictures.camera(
                "thinlens",
                '''<float name="fov" value="40"/><string name="fov_axis" value="y"/>
            <float name="aperture_radius" value=".1"/><float name="focus_distance" value="3"/>''',
            )
        }
        <emitter type="point"><point name="position" x="1" y="-2" z="3"/>
        <rgb name="intensity" value="10 11 12"/></emitter>
        <emitter type="directional"><vector name="direction" x=".3" y=".4" z="-1"/>
        <rgb name="irradiance" value=".5 .4 .1"/></emitter>
        <emitter type="constant"><rgb name="radiance" value=".3 .4 .5"/></emitter>
        <shape type="sphere"><point name="center" x="0" y="0" z="0"/>
        <float name="radius" value=".5"/><transform name="to_world">{turned}</transform>
        <bsdf type="twosided"><bsdf type="roughconductor"><string name="distribution" value="ggx"/>
        <float name="alpha" value=".3"/><rgb name="eta" value="1.5"/><rgb name="k" value="3"/>
        </bsdf></bsdf></shape>
        <shape type="disk"><transform name="to_world"><scale value=".7"/><translate z=".2"/>{turned}
        </transform><bsdf type="twosided"><bsdf type="diffuse">
        <spectrum name="reflectance" value="400:.2, 700:.6"/></bsdf></bsdf></shape>
        <shape type="ply"><string name="filename" value="corner.ply"/><boolean value="true"
        name="face_normals"/><transform name="to_world"><matrix
        value="1 .3 0 -1.2  0 .8 .2 0  0 0 1.3 .1  0 0 0 1"/></transform><bsdf type="dielectric">
        <float name="int_ior" value="1.4"/><float name="ext_ior" value="1"/></bsdf></shape>
        <shape type="sphere"><float name="radius" value=".2"/><emitter type="area">
        <rgb name="radiance" value="5 6 7"/></emitter><bsdf type="diffuse"/></shape></scene>"""
    )
    head, world = PBRT.split("WorldBegin")
    found = read(tmp_path, world, head)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        same(found, read_scene(tmp_path / "a.xml"))


TOML = """
[camera]
kind = "orthographic"
position = [0, -4, 1.5]
target = [0, 0, 0.5]
resolution = [12, 16]
width = 4.0
[[surface]]
shape = "quad"
corner = [-3, -3, 0]
edge_u = [6, 0, 0]
edge_v = [0, 6, 0]
material = "floor"
two_sided = true
[[surface]]
shape = "sphere"
centre = [0.5, 0, 0.5]
radius = 0.5
material = "plastic"
two_sided = true
[material.floor]
family = "lambert"
albedo = [0.3, 0.2, 0.1]
[material.plastic]
family = "coated"
albedo = [0.7, 0.3, 0.2]
eta = 1.4
roughness = 0.2
optical_depth = 0.02
[[light]]
kind = "spot"
falloff = "smoothstep"
position = [1, -1, 3]
direction = [-0.2, 0.3, -1]
inner = 30
outer = 50
intensity = [20, 10, 30]
"""


@pytest.mark.slow
@pytest.mark.parametrize("floor", ["bilinearmesh", "trianglemesh"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_scene_renders_as_a_toml_file(floor, mirrored, tmp_path):
    """The world's axes are unchanged, or x is reversed by a left-handed camera."""
    x = -1 if mirrored else 1
    camera = "LookAt 0 -4 1.5  0 0 .5  0 0 1" if mirrored else SAME_AXES
    (tmp_path / "a.toml").write_text(TOML)
    indices = "0 1 2 3" if floor == "bilinearmesh" else "0 1 2 2 1 3"
    text = f"""
        LightSource "spot" "point3 from" [{x} -1 3] "point3 to" [{0.8 * x} -.7 2] "rgb I" [2 1 3]
            "float scale" 10 "float coneangle" 50 "float conedeltaangle" 20
        Texture "grey" "spectrum" "constant" "rgb value" [.6 .4 .2]
        Texture "dark" "spectrum" "scale" "texture tex" "grey" "float scale" .5
        Material "diffuse" "texture reflectance" "dark"
        ObjectBegin "floor" Translate -1 -1 0
            Shape "{floor}" "point3 P" [0 0 0  2 0 0  0 2 0  2 2 0] "integer indices" [{indices}]
        ObjectEnd
        AttributeBegin Scale 3 3 3 ObjectInstance "floor" AttributeEnd
        Include "ball.pbrt"
        """
    (tmp_path / "ball.pbrt").write_text(
        f"""AttributeBegin Translate {0.5 * x} 0 .5 Material "coateddiffuse"
        "rgb reflectance" [.7 .3 .2] "float roughness" .04 "float thickness" .02 "float eta" 1.4
        Shape "sphere" "float radius" .5 AttributeEnd"""
    )
    window = "[-2 2 -1.5 1.5]"
    found = read(
        tmp_path, text, f'{camera} Camera "orthographic" "float screenwindow" {window} {FILM}'
    )
    wanted = read_scene(tmp_path / "a.toml")
    picture = jv.render(wanted.scene, wanted.view)
    assert picture.max() > 0.1
    np.testing.assert_allclose(jv.render(found.scene, found.view), picture, rtol=2e-4, atol=2e-4)


@pytest.mark.parametrize("axes", ["", "Scale -1 1 1", "Rotate 30 1 2 3 Scale -2 2 2"])
@pytest.mark.parametrize(
    ("camera", "film", "size", "window"),
    [
        ('"float fov" 40', "", (160, 120), None),
        ('"float fov" 40', "", (120, 160), None),
        ('"float fov" 40 "float screenwindow" [-1 .5 -.6 1]', "", (160, 120), (-1, 0.5, -0.6, 1)),
        ('"float fov" 40', '"float cropwindow" [.25 .9 .1 .5]', (160, 120), None),
        ('"float fov" 40', '"integer pixelbounds" [40 144 12 60]', (160, 120), None),
    ],
)
def test_points_are_projected_as_by_pbrts_camera(axes, camera, film, size, window, tmp_path):
    """pbrt's camera has x right, y up and z forward, left-handed, and the fov is that of the
    shorter side."""
    head = f"""{axes} LookAt 1 -4 1.5  .2 .3 .5  .1 0 1 Camera "perspective" {camera}
    Film "rgb" "integer xresolution" {size[0]} "integer yresolution" {size[1]} {film}"""
    point = np.array([0.3, 0.1, 0.7])
    place = " ".join(map(str, point))
    found = read(tmp_path, f'LightSource "infinite" Translate {place} {BALL}', head)
    z = np.array([0.2, 0.3, 0.5]) - [1, -4, 1.5]
    z /= np.linalg.norm(z)
    x = np.cross([0.1, 0, 1], z)
    x /= np.linalg.norm(x)
    seen = np.stack([x, np.cross(z, x), z]) @ (point - [1, -4, 1.5])
    if axes == "Scale -1 1 1":
        seen = seen * [-1, 1, 1]
    elif axes:
        a = np.array([1, 2, 3]) / np.sqrt(14)
        seen = seen * [-2, 2, 2]
        turn = np.radians(30)  # Rodrigues' formula
        seen = (
            seen * np.cos(turn)
            + np.cross(a, seen) * np.sin(turn)
            + a * (a @ seen) * (1 - np.cos(turn))
        )
    aspect = size[0] / size[1]
    left, right, low, high = window or (
        *(-max(aspect, 1), max(aspect, 1), -max(1 / aspect, 1), max(1 / aspect, 1)),
    )
    across, up = seen[:2] / seen[2] / np.tan(np.radians(20))
    column = (across - left) / (right - left) * size[0] - 0.5
    row = (high - up) / (high - low) * size[1] - 0.5
    first = (40, 12) if film else (0, 0)
    seen_at = jv.project(found.view, jnp.asarray(found.scene.surfaces[0].shape.centre))
    np.testing.assert_allclose(
        [seen_at.column, seen_at.row], [column - first[0], row - first[1]], atol=2e-3
    )
    assert found.view.resolution == ((48, 104) if film else size[::-1])


@pytest.mark.slow
def test_the_light_of_a_coat_equals_pbrts_walk(tmp_path):
    """The reference is a random walk through the coat. pbrt ends walks after 5 reflections by the
    body (10 events), which loses the 5th power of (albedo times internal reflectance) of the body's
    light. The warning gives this loss."""
    for rho, cosine in ((0.5, 1.0), (0.9, 0.4)):
        text = f"""LightSource "infinite" Material "coateddiffuse" "float thickness" 0
        "rgb reflectance" [{rho} {rho} {rho}] {BALL}"""
        (tmp_path / "a.pbrt").write_text(f"{HEAD}\nWorldBegin {text}")
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            coat = read_scene(tmp_path / "a.pbrt").scene.surfaces[0].material
        wo = jnp.array([np.sqrt(1 - cosine**2), 0, cosine], coat.roughness.dtype)
        albedo = float(brdf.albedo(coat, wo)[0])
        assert albedo == pytest.approx(coat_walk.albedo(cosine, 1e-4, rho), abs=4e-3)
        walk = coat_walk.albedo(cosine, 1e-4, rho, most=5, stops=True)
        lost = (rho * 0.59635) ** 5
        outside = float(coat_walk.fresnel(cosine, 1.5))
        assert walk - outside == pytest.approx((albedo - outside) * (1 - lost), abs=4e-3)
        named = [f"loses up to {lost:.1%} of the light" in str(w.message) for w in said]
        assert any(named) == (rho == 0.9)


@pytest.mark.slow
def test_a_rough_coat_exceeds_pbrts_by_the_stated_loss():
    """At albedo 0.5, averaged over two views, the difference is 3, 9 and 15 %: the light that
    facets block."""
    for alpha, loss in ((0.1, 0.03), (0.2, 0.09), (0.3, 0.15)):
        coat = jv.Coated(jv.Lambert([0.5 / np.pi]), jv.Dielectric([1.5]), alpha)
        share = []
        for c in (1.0, 0.4):
            whole = float(brdf.albedo(coat, jnp.array([np.sqrt(1 - c * c), 0, c]))[0])
            share.append(1 - coat_walk.albedo(c, alpha, 0.5, most=5, stops=True) / whole)
        assert np.mean(share) == pytest.approx(loss, abs=0.01)


def test_amounts_of_light(tmp_path):
    """Power (lm) and illuminance (lux) have closed forms. They set the luminance of the colour,
    except for rgb, whose own level counts."""
    world = f"""
    LightSource "point" "blackbody I" 3000 "float power" 20
    LightSource "spot" "spectrum I" [400 7 700 7] "float power" 20 "float conedeltaangle" 30
    LightSource "distant" "spectrum L" "stdillum-A" "float illuminance" 300
    LightSource "infinite" "rgb L" [3 3 3] "float illuminance" 10
    LightSource "point" "rgb I" [1 2 3] "float scale" 2 "point3 from" [0 0 1]
    AttributeBegin AreaLightSource "diffuse" "spectrum L" "lamp.spd" "float power" 9
    Translate 0 0 -9 {BALL}
    AreaLightSource "diffuse" "bool twosided" true "float power" 9
    Shape "disk" "float radius" 2 "float height" -3 AttributeEnd
    """
    (tmp_path / "lamp.spd").write_text("# a lamp\n400 1\n500 2 # green\n700 1\n")
    found = read(tmp_path, world).scene
    luminance = np.array([0.2126, 0.7152, 0.0722])
    point, spot, distant, sky, rgb = found.lights
    assert luminance @ np.asarray(point.intensity) == pytest.approx(20 / (4 * np.pi), rel=1e-2)
    assert point.intensity[0] > point.intensity[2]
    # the mean of t^2 (3 - 2 t) between the cones is one half
    assert luminance @ np.asarray(spot.intensity) == pytest.approx(
        20 / (np.pi * (1 - np.cos(np.pi / 6))), rel=1e-2
    )
    assert luminance @ np.asarray(distant.irradiance) == pytest.approx(300, rel=1e-2)
    np.testing.assert_allclose(sky.radiance[0, 0], 30 / np.pi, rtol=1e-5)
    np.testing.assert_allclose(rgb.intensity, [2, 4, 6])
    ball, disc = found.surfaces
    assert luminance @ np.asarray(ball.emission) == pytest.approx(9 / (4 * np.pi**2), rel=1e-2)
    np.testing.assert_allclose(disc.emission, 9 / (2 * np.pi * 4 * np.pi), rtol=1e-5)
    assert (disc.two_sided, ball.two_sided) == (True, False)


def on_the_square(n):
    """Return the directions, (n, n, 3), of the pixels of a square picture of the sphere in pbrt's
    equal-area map."""
    u, v = np.meshgrid((np.arange(n) + 0.5) / n * 2 - 1, (np.arange(n) + 0.5) / n * 2 - 1)
    d = 1 - (np.abs(u) + np.abs(v))
    r = 1 - np.abs(d)
    phi = np.where(r > 0, (np.abs(v) - np.abs(u)) / np.where(r > 0, r, 1) + 1, 1) * np.pi / 4
    side = r * np.sqrt(2 - r * r)
    w = [np.copysign(np.cos(phi), u) * side, np.copysign(np.sin(phi), v) * side]
    return np.stack([*w, np.copysign(1 - r * r, d)], axis=-1)


@pytest.mark.parametrize("axes", [SAME_AXES, "LookAt 0 -4 1.5  0 0 .5  0 0 1"])
def test_a_goniometric_picture_gives_the_lamps_intensity(axes, tmp_path):
    """The intensity is 2 + w . b for directions w. The picture has the lamp's y axis as its z axis,
    and the flux is its power."""
    b = np.array([0.3, -0.5, 0.9])
    picture = 2 + on_the_square(64) @ b
    write_image(tmp_path / "lamp.exr", np.repeat(picture[..., None], 3, axis=2).astype(np.float32))
    text = 'LightSource "goniometric" "string filename" "lamp.exr" "rgb I" [1 2 4]'
    world = f'Translate 1 2 3 Rotate 90 0 0 1 {text} "float scale" 3 {text} "float power" 50 {BALL}'
    found = read(tmp_path, world, f'{axes} Camera "perspective" {FILM}').scene
    lamp, of_power = found.lights
    x = 1 if axes == SAME_AXES else -1
    np.testing.assert_allclose(lamp.position, [x, 2, 3], atol=1e-6)
    for w in np.array([[0.6, 0.64, 0.48], [-0.8, 0, 0.6], [0, -0.6, -0.8]]):
        seen = jv.incident(lamp, jnp.asarray(lamp.position) + 2 * jnp.asarray(w, jnp.float32))
        own = np.array([w[1], -x * w[0], w[2]])  # rotated back by 90 degrees
        intensity = 3 * (2 + own[[0, 2, 1]] @ b)
        np.testing.assert_allclose(seen.irradiance, intensity / 4 * np.array([1, 2, 4]), rtol=0.02)
    np.testing.assert_allclose(jv.lights.flux(of_power), [50, 100, 200], rtol=5e-3)


@pytest.mark.parametrize("axes", [SAME_AXES, "LookAt 0 -4 1.5  0 0 .5  0 0 1"])
def test_a_square_picture_of_the_sky_is_resampled(axes, tmp_path):
    """The radiance is 2 + w for directions w, and one pixel is a sun, whose total light is
    preserved."""
    n, scale = 64, 2.0
    w = on_the_square(n)
    picture = (2 + w).astype(np.float32)
    picture[40, 9, 0] += 500
    write_image(tmp_path / "sky.exr", picture)
    world = (
        f'Rotate 90 0 0 1 LightSource "infinite" "string filename" "sky.exr" "float scale" 2 {BALL}'
    )
    head = f'{axes} Camera "perspective" {FILM}'
    sky = read(tmp_path, world, head).scene.lights[0]
    h = sky.radiance.shape[0]
    x = 1 if axes == SAME_AXES else -1
    for row, column in ((20, 5), (3, 70), (50, 100)):
        theta, turn = np.pi * (row + 0.5) / h, np.pi * (1 - (column + 0.5) / h)
        to = np.array(
            [x * np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)]
        )
        own = scale * (2 + np.array([to[1], -to[0], to[2]]))  # rotated back by 90 degrees
        np.testing.assert_allclose(sky.radiance[row, column], own, atol=0.12)
    edges = np.cos(np.pi * np.arange(h + 1) / h)
    solid = (edges[:-1] - edges[1:])[:, None] * np.pi / h
    total = np.einsum(
        "ijk,ij->k", np.asarray(sky.radiance, float), np.broadcast_to(solid, (h, 2 * h))
    )
    sun = np.array([500, 0, 0]) * 4 * np.pi / n**2
    np.testing.assert_allclose(total, scale * (8 * np.pi + sun), rtol=4e-3)


def test_materials_and_textures(tmp_path):
    """The reference numbers are by hand. Maps use pbrt's u and v, where v counts from below."""
    write_image(tmp_path / "a.png", np.full((2, 2, 3), 128, np.uint8))
    world = f"""LightSource "infinite"
    Texture "picture" "spectrum" "imagemap" "string filename" "a.png" "float vscale" 2
        "float udelta" .25 "float scale" .5
    Texture "half" "spectrum" "mix" "rgb tex1" [.2 .2 .2] "rgb tex2" [.4 .6 .8] "float amount" .25
    MakeNamedMaterial "matt" "string type" "diffuse" "texture reflectance" "half"
    MakeNamedMaterial "metal" "string type" "conductor" "rgb reflectance" [.9 .6 .3]
        "float roughness" .2 "bool remaproughness" false
    Material "mix" "string materials" ["matt" "metal"] "float amount" .3 {BALL}
    Material "diffuse" "texture reflectance" "picture" {BALL}
    Material "conductor" "spectrum eta" [400 .2 700 1.2] "spectrum k" [400 3 700 6] {BALL}
    Material "dielectric" "spectrum eta" "glass-BK7" {BALL}
    Material "diffuse" "texture reflectance" "picture" Shape "trianglemesh"
        "point3 P" [0 0 0 1 0 0 0 1 0] "point2 uv" [0 0 1 0 0 1]"""
    for axes, mirrored in ((SAME_AXES, False), ("LookAt 0 -4 1.5  0 0 .5  0 0 1", True)):
        scene = read(tmp_path, world, f'{axes} Camera "perspective" {FILM}').scene
        mix, painted, metal, glass, tile = (surface.material for surface in scene.surfaces)
        np.testing.assert_allclose(
            np.pi * mix.diffuse, 0.7 * np.array([0.25, 0.3, 0.35]), rtol=1e-5
        )
        np.testing.assert_allclose(mix.specular, 0.3, rtol=1e-6)
        assert mix.roughness == pytest.approx(0.2)
        n, k = np.asarray(mix.interface.eta), np.asarray(mix.interface.k)
        np.testing.assert_allclose(
            ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2), [0.9, 0.6, 0.3], rtol=1e-4
        )
        grey = ((128 / 255 + 0.055) / 1.055) ** 2.4
        np.testing.assert_allclose(np.pi * painted.diffuse.values, grey / 2, rtol=1e-5)
        flat = [[1, 0, 0.25], [0, 2, -1]]
        np.testing.assert_allclose(tile.diffuse.uv, flat)
        np.testing.assert_allclose(
            painted.diffuse.uv, [[-1, 0, 0.75], flat[1]] if mirrored else flat
        )
        assert 0.8 < metal.interface.f0.min() < metal.interface.f0.max() < 0.95
        assert glass.index == pytest.approx(1.5168)
        assert not scene.surfaces[3].two_sided
        np.testing.assert_allclose(scene.surfaces[4].shape.uv, [[0, 1], [1, 1], [0, 0]])


def test_metals_by_name_have_their_colours(tmp_path):
    """Several metals may be named in one line. The textbook's reflectances at normal incidence, in
    linear sRGB, are of other measurements and differ by up to 0.06 (Akenine-Moller, Haines and
    Hoffman, "Real-Time Rendering")."""
    known = {
        "Cu": [0.955, 0.638, 0.538],
        "Ag": [0.972, 0.960, 0.915],
        "Au": [1.022, 0.782, 0.344],
        "Al": [0.913, 0.922, 0.924],
    }
    materials = (
        f'Material "conductor" "spectrum eta" "metal-{x}-eta" "spectrum k" "metal-{x}-k" {BALL}'
        for x in known
    )
    world = f'LightSource "infinite" {" ".join(materials)} Material "conductor" {BALL}'
    found = [surface.material.interface.f0 for surface in read(tmp_path, world).scene.surfaces]
    np.testing.assert_allclose(found[:4], np.minimum(list(known.values()), 1), atol=0.065)
    np.testing.assert_array_equal(found[4], found[0])  # the default is copper


def test_the_front_of_a_mesh_is_given_by_its_normals(tmp_path):
    """The normals contradict the triangle's orientation, or the world is mirrored, or the
    orientation is reversed."""
    flat = '"point3 P" [0 0 0 1 0 0 0 1 0]'
    down = '"normal N" [0 0 -1 0 0 -1 0 0 -1]'
    cases = [("", flat, 1), ("ReverseOrientation", flat, -1), ("Scale 1 -1 1", flat, 1)]
    cases += [("", flat + down, -1), ("ReverseOrientation", flat + down, 1)]
    for axes in (SAME_AXES, "LookAt 0 -4 1.5  0 0 .5  0 0 1"):
        for before, points, z in cases:
            world = f'{before} LightSource "infinite" Shape "trianglemesh" {points}'
            mesh = (
                read(tmp_path, world, f'{axes} Camera "perspective" {FILM}').scene.surfaces[0].shape
            )
            a, b, c = np.asarray(mesh.vertices)[np.asarray(mesh.faces)[0]]
            assert np.sign(np.cross(b - a, c - a)[2]) == z
            assert mesh.normals is None or (np.sign(mesh.normals[:, 2]) == z).all()


@pytest.mark.parametrize(
    ("world", "words"),
    [
        ('Shape "cylinder"', r"type 'cylinder' is not read; types that are: sphere"),
        ('Shape "sphere" "float raduis" 2', "'raduis' is not read; the nearest is 'radius'"),
        ('Shape "sphere" "float zmin" 0', "zmin cuts it"),
        ('Scale 1 2 1 Shape "sphere"', "ellipsoid"),
        ('Scale 0 1 1 Shape "sphere"', "flattens space"),
        ('Shape "sphere" "float alpha" .5', "alpha is not read"),
        ('Shape "plymesh" "string filename" "none.ply"', "none.ply: no such file"),
        ('Shape "trianglemesh" "point3 P" [0 0 0 1 0 0 0 1 0] "integer indices" [0 1 3]', "0 to 2"),
        ('Shape "bilinearmesh" "point3 P" [0 0 0 1 0 0 0 1 0 1 1 1]', "curved patch"),
        ('Shape "sphere" "float radius" [1 2]', "radius is of an unexpected kind"),
        ('Shape "sphere" "float radius"', "has no value"),
        ('Shape "sphere" "radius" 2', "no type and name"),
        ('Shape "sphere" "float radius" 1 "float radius" 2', "stands twice"),
        ('Shape "sphere" "float radius" 1e999', "finite numbers"),
        ('Shape "sphere" "float radius" [1', "is not closed"),
        ('Shape "sphere', "a quote that its line does not close"),
        ("] Shape", "out of place"),
        ('Material "hair"', None),
        (f'Material "hair" {BALL}', "type 'hair' is not read"),
        (f'Material "conductor" "spectrum eta" "metal-MgO-eta" {BALL}', "metal-MgO-eta"),
        (f'Material "dielectric" "float roughness" .2 {BALL}', "rough glass"),
        (f'Material "coatedconductor" {BALL}', "of at least 0.04"),
        (f'Material "coateddiffuse" "rgb albedo" [.1 0 0] {BALL}', "a coat that scatters"),
        (f'Material "diffuse" "texture reflectance" "wood" {BALL}', "names no texture"),
        (
            f'Texture "a" "float" "dots" Material "diffuse" "texture reflectance" "a" {BALL}',
            "'dots' is not read",
        ),
        (f'NamedMaterial "steel" {BALL}', "no material is named 'steel'"),
        (
            'MakeNamedMaterial "m" "string type" "mix" "string materials" ["m" "m"] '
            f'NamedMaterial "m" {BALL}',
            "mixes a mixture",
        ),
        ('LightSource "infinite" "point3 from" [0 0 1]', "'from' is not read"),
        ('LightSource "goniometric"', "has no filename"),
        ('LightSource "projection" "string filename" "a.png"', "'projection' is not read"),
        (
            'LightSource "infinite" "point3 portal" [0 0 0 1 0 0 1 1 0 0 1 0]',
            "'portal' is not read",
        ),
        ('LightSource "point" "spectrum I" "metal-Cu-k"', "is not known"),
        ('MediumInterface "a" "b"', "MediumInterface is not read"),
        ('Camera "perspective"', "belongs before WorldBegin"),
        ("WorldBegin", "stands twice"),
        ('ObjectInstance "tree"', "no object is named 'tree'"),
        ("AttributeBegin", "AttributeBegin is not ended"),
        ("AttributeEnd", "does not end what begins"),
        ('Include "b.pbrt"', "more than 16 files"),
        ('ColorSpace "rec2020"', "srgb alone"),
        (
            'AreaLightSource "diffuse" "float power" 3 Shape "plymesh" "string filename" "c.ply"',
            "power is shared unequally",
        ),
    ],
)
def test_unsupported_content_is_named(world, words, tmp_path):
    (tmp_path / "c.ply").write_text(mitsuba_pictures.CORNER)
    (tmp_path / "b.pbrt").write_text('Include "b.pbrt"')
    whole = f'LightSource "infinite" {BALL} {world}'
    if words is None:  # unused materials are not converted
        assert len(read(tmp_path, whole).surfaces) == 1
        return
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, whole)
    assert "a.pbrt" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ('Camera "realistic"', "'realistic' is not read"),
        ('Camera "perspective" "float fov" 180', "above 0 and below 180"),
        ('Camera "orthographic" "float lensradius" .1', "a lens or pixels"),
        ('Film "spectral"', "'spectral' is not read"),
        ('Film "rgb" "integer xresolution" 0', "at least 1"),
        ('Film "rgb" "float cropwindow" [.5 .5 0 1]', "holds no pixel"),
        ('Integrator "ao"', "'ao' is not read"),
        ('Integrator "path" "bool regularize" true', "regularize"),
        ('Scale 1 2 1 Camera "perspective"', "mirrors or stretches"),
        ("Transform [1 0 0 1  0 1 0 0  0 0 1 0  0 0 0 1]", "is a projection"),
    ],
)
def test_unsupported_options_are_named(head, words, tmp_path):
    with pytest.raises(InputError, match=words):
        read(tmp_path, f'LightSource "infinite" {BALL}', head)


def test_differences_from_pbrt_are_named(tmp_path):
    metal = 'Material "conductor" "float roughness" .1 "float k" 3'
    cases = {
        "gaussian filter blurs": ("", BALL),
        "multiplies it by 2": (FILM.replace("PixelF", '"float iso" 200 PixelF'), BALL),
        "sensor is not used": (FILM.replace("PixelF", '"string sensor" "canon" PixelF'), BALL),
        "facets of roughness 0.001": (FILM, f'{metal[:20]} "rgb reflectance" [.9 .9 .9] {BALL}'),
        "keeps the light that": (FILM, f'Material "coateddiffuse" "float roughness" .1 {BALL}'),
        "normal incidence": (FILM, f'{metal} "spectrum eta" [400 1 700 2] {BALL}'),
        "is mirrored": (FILM, f'Translate 0 0 5 Scale 1 -1 1 AreaLightSource "diffuse" {BALL}'),
        "shines to one side": (FILM, 'AreaLightSource "diffuse" Shape "disk"'),
    }
    for words, (film, world) in cases.items():
        text = f'{film} Camera "perspective" WorldBegin LightSource "infinite" {world}'
        (tmp_path / "a.pbrt").write_text(text)
        with pytest.warns(UserWarning, match=words):
            read_scene(tmp_path / "a.pbrt")


@pytest.mark.slow
@pytest.mark.parametrize(("alpha", "most"), [(0.045, 0.05), (0.1, 0.035), (0.3, 0.01)])
def test_metal_under_a_coat_equals_a_walk(alpha, most, tmp_path):
    """A random walk passes a smooth coat of optical depth 0.05 to metal of reflectance 0.9 inside
    the coat."""
    n, k = np.array([0.8, 2.4]), np.array([7.6, 7.2])  # relative to the coat's 1.5
    f0 = ((n / 1.5 - 1) ** 2 + (k / 1.5) ** 2) / ((n / 1.5 + 1) ** 2 + (k / 1.5) ** 2)
    world = f"""LightSource "infinite" Material "coatedconductor" "float thickness" .05
    "float conductor.roughness" {alpha**2} "spectrum conductor.eta" [400 {n[0]} 700 {n[0]}]
    "spectrum conductor.k" [400 {k[0]} 700 {k[0]}] {BALL}"""
    coat = read(tmp_path, world).scene.surfaces[0].material
    np.testing.assert_allclose(coat.body.interface.f0, f0[0], rtol=2e-3)
    for cosine in (1.0, 0.5):
        wo = jnp.array([np.sqrt(1 - cosine**2), 0, cosine], coat.roughness.dtype)
        walk = coat_walk.metal_albedo(cosine, alpha, f0[0], depth=0.05)
        assert brdf.albedo(coat, wo)[1] == pytest.approx(walk, rel=most)


def test_a_mesh_of_a_file_has_its_texture_coordinates(tmp_path):
    """The coordinates in a PLY file equal those of the same triangles in the scene."""
    write_image(tmp_path / "a.png", np.full((2, 2, 3), 128, np.uint8))
    points = [[0, 0, 0, 0.1, 0.2], [1, 0, 0, 0.9, 0.2], [1, 1, 0, 0.8, 0.7], [0, 1, 0, 0.1, 0.9]]
    names = "\n".join(f"property float {name}" for name in "xyzuv")
    rows = "\n".join(" ".join(map(str, row)) for row in points)
    (tmp_path / "a.ply").write_text(
        f"ply\nformat ascii 1.0\nelement vertex 4\n{names}\nelement face 2\nproperty list uchar "
        f"int vertex_indices\nend_header\n{rows}\n3 0 1 2\n3 0 2 3\n"
    )
    p, uv = (
        " ".join(str(x) for row in points for x in row[part]) for part in (slice(3), slice(3, 5))
    )
    world = f"""LightSource "infinite" Translate 0 0 2
    Texture "a" "spectrum" "imagemap" "string filename" "a.png"
    Material "diffuse" "texture reflectance" "a" Shape "plymesh" "string filename" "a.ply"
    Shape "trianglemesh" "point3 P" [{p}] "point2 uv" [{uv}] "integer indices" [0 1 2 0 2 3]"""
    for axes in (SAME_AXES, "LookAt 0 -4 1.5  0 0 .5  0 0 1"):
        found = read(tmp_path, world, f'{axes} Camera "perspective" {FILM}').scene.surfaces
        one, other = (surface.shape for surface in found)
        for name in ("vertices", "uv"):
            a, b = (np.asarray(getattr(m, name))[np.asarray(m.faces)] for m in (one, other))
            order = [np.sort(x.reshape(2, -1), axis=1) for x in (a, b)]
            np.testing.assert_allclose(*order, atol=1e-6)


def test_a_measured_material_equals_its_file(tmp_path):
    fields = measured.rgl_fields(np.random.default_rng(2))
    (tmp_path / "a.bsdf").write_bytes(measured.tensor_bytes(fields))
    world = f'LightSource "infinite" Material "measured" "string filename" "a.bsdf" {BALL}'
    found = read(tmp_path, world).scene.surfaces[0].material
    text = TOML.replace('family = "lambert"', 'family = "measured"\nfile = "a.bsdf"')
    (tmp_path / "a.toml").write_text(text.replace("albedo = [0.3, 0.2, 0.1]\n", ""))
    twin = read_scene(tmp_path / "a.toml").scene.surfaces[0].material
    assert jax.tree.structure(found) == jax.tree.structure(twin)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(twin), strict=True):
        np.testing.assert_array_equal(a, b)
