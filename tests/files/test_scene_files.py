"""Tests scene files: valid ones become records, and each mistake is one sentence."""

from dataclasses import replace
from functools import partial

import colour
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import cornell_box
from scipy.constants import c, h, k

import jaxvision as jv
from jaxvision import scene
from jaxvision.brdf import blinn, eon, fresnel, gaussian_lobe, lambert, mirror, oren_nayar, phong
from jaxvision.brdf.glass import Glass
from jaxvision.brdf.half_difference import HalfDifferenceTable
from jaxvision.brdf.torrance_sparrow import TorranceSparrow
from jaxvision.errors import InputError
from jaxvision.files.cameras import read_camera
from jaxvision.files.images import write_image
from jaxvision.files.measured import write_merl
from jaxvision.files.scenes import read_scene, shipped_scenes
from jaxvision.lights import (
    DirectionalLight,
    PointLight,
    RectangleLight,
    SmallLight,
    radiance_from,
)
from jaxvision.optics import camera_ray, pixel_offset
from jaxvision.render_command import light_findings
from jaxvision.rendering import scene_checks

CAMERA = """
[camera]
kind = "pinhole"
position = [0, -4, 0]
target = [0, 0, 0]
resolution = [30, 40]
field_of_view = 60
"""
LIGHT = """
[[light]]
name = "lamp"
kind = "point"
position = [1, -2, 3]
intensity = [10, 20, 30]
"""
GREY = """
[material.grey]
family = "lambert"
albedo = 0.5
"""
BALL = """
[[surface]]
name = "ball"
shape = "sphere"
centre = [0, 0, 0]
radius = 1
material = "grey"
"""
SCENE = CAMERA + LIGHT + GREY + BALL


def read(folder, text, name="a.toml"):
    (folder / name).write_text(text)
    return read_scene(folder / name)


def same(got, wanted):
    """Check that two records are equal, with numbers equal in float32."""
    assert jax.tree.structure(got) == jax.tree.structure(wanted)
    for a, b in zip(jax.tree.leaves(got), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(a, b, rtol=3e-7, atol=1e-9)


def material_of(folder, text, *, head=""):
    made = f"[material.grey]\n{text}"
    return read(folder, head + CAMERA + LIGHT + made + BALL).scene.surfaces[0].material


# ------------------------------------------------ valid files


def test_dtype_names_and_settings(tmp_path):
    found = read(tmp_path, SCENE + '[render]\nintegrator = "path"\nsamples = 7\n')
    assert found.surfaces == ('surface "ball"',)
    assert found.lights == ('light "lamp"',)
    assert (found.render.integrator, found.render.samples, found.bands) == ("path", 7, 3)
    assert {x.dtype for x in jax.tree.leaves((found.scene, found.view))} == {np.dtype(np.float32)}
    double = read(tmp_path, SCENE + '[render]\ndtype = "float64"\n')
    assert double.scene.surfaces[0].shape.radius.dtype == np.float64


SHAPES = {
    'shape = "plane"\npoint = [1, 2, 3]\nnormal = [0, 0, 2]': scene.Plane([1, 2, 3], [0, 0, 2]),
    'shape = "disc"\ncentre = [1, 2, 3]\nnormal = [0, 1, 0]\nradius = 0.5': scene.Disc(
        [1, 2, 3], [0, 1, 0], 0.5
    ),
    'shape = "quad"\ncorner = [1, 2, 3]\nedge_u = [1, 0, 0]\nedge_v = [0, 1, 1]': scene.Quad(
        [1, 2, 3], [1, 0, 0], [0, 1, 1]
    ),
    'shape = "box"\ncentre = [1, 2, 3]\nhalf_extents = [1, 2, 0.5]': scene.Box(
        [1, 2, 3], [1, 2, 0.5]
    ),
    'shape = "box"\ncentre = [1, 2, 3]\nhalf_extents = [1, 2, 3]\n'
    "rotation = [[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]]": scene.Box(
        [1, 2, 3], [1, 2, 3], rotation=[[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]]
    ),
}


@pytest.mark.parametrize("text", SHAPES, ids=lambda text: text.split('"')[1])
def test_shapes(tmp_path, text):
    surface = f'[[surface]]\n{text}\nmaterial = "grey"\nemission = [1, 2, 3]\ntwo_sided = true\n'
    (found,) = read(tmp_path, CAMERA + GREY + surface).scene.surfaces
    same(found.shape, SHAPES[text])
    same(found.emission, np.float32([1, 2, 3]))
    assert found.two_sided


K_D = np.full(3, 0.5) / np.pi
MATERIALS = {
    'family = "lambert"\nalbedo = 0.5': lambert.Lambert(K_D),
    'family = "lambert"\ndiffuse = [0.1, 0.2, 0.3]\nambient = 0.4': lambert.Lambert(
        [0.1, 0.2, 0.3], ambient=[0.4, 0.4, 0.4]
    ),
    'family = "oren_nayar"\nalbedo = 0.5\nsigma = 30\nform = "full"': oren_nayar.OrenNayar(
        K_D, np.pi / 6, form="full"
    ),
    'family = "eon"\nalbedo = 0.5\nroughness = 0.4': eon.EON(K_D, 0.4),
    'family = "phong"\nalbedo = 0.5\nspecular = 0.2\nexponent = 40': phong.Phong(
        K_D, [0.2] * 3, 40.0
    ),
    'family = "normalised_phong"\nalbedo = 0.5\nspecular = 0.2\nexponent = 4': (
        phong.NormalisedPhong(K_D, [0.2] * 3, 4.0)
    ),
    'family = "blinn_brdf"\nalbedo = 0.5\nspecular = 0.2\nexponent = 4': blinn.BlinnBRDF(
        K_D, [0.2] * 3, 4.0
    ),
    'family = "gaussian_lobe"\nalbedo = 0.5\nspecular = 0.2\nconcentration = 4': (
        gaussian_lobe.GaussianLobe(K_D, [0.2] * 3, 4.0)
    ),
    'family = "torrance_sparrow"\nalbedo = 0.5\nroughness = 0.1\neta = 1.5\nk = [1, 2, 3]': (
        TorranceSparrow(
            K_D, [1.0] * 3, 0.1, interface=fresnel.Conductor([1.5] * 3, [1.0, 2.0, 3.0])
        )
    ),
    'family = "torrance_sparrow"\nalbedo = 0.5\nroughness = [0.1, 0.2]\nf0 = 0.04\n'
    'distribution = "beckmann"': TorranceSparrow(
        K_D,
        [1.0] * 3,
        [0.1, 0.2],
        interface=fresnel.Schlick([0.04] * 3),
        distribution="beckmann",
    ),
    'family = "mirror"\nreflectance = 0.9': mirror.Mirror([0.9] * 3),
    'family = "glass"\nindex = 1.33\nabsorption = [1, 2, 3]': Glass(
        1.33, absorption=[1.0, 2.0, 3.0]
    ),
}


@pytest.mark.parametrize("text", MATERIALS, ids=lambda text: text.split('"')[1])
def test_materials(tmp_path, text):
    same(material_of(tmp_path, text), MATERIALS[text])


def test_lights_and_ambient(tmp_path):
    lights = LIGHT + (
        '[[light]]\nkind = "directional"\ndirection = [0, 0, 2]\nirradiance = 3\n'
        '[[light]]\nkind = "rectangle"\ncorner = [0, 0, 3]\nedge_u = [0, 1, 0]\n'
        "edge_v = [1, 0, 0]\nradiance = [1, 2, 3]\n"
        '[[light]]\nkind = "small"\nposition = [1, 2, 3]\nnormal = [0, 0, -1]\nintensity = 4\n'
        "[ambient]\nradiance = 0.1\n"
    )
    found = read(tmp_path, CAMERA + GREY + BALL + lights)
    point, directional, rectangle, small = found.scene.lights
    same(point, PointLight([1, -2, 3], [10, 20, 30]))
    same(directional, DirectionalLight([0, 0, 2], [3, 3, 3]))
    same(rectangle, RectangleLight([0, 0, 3], [0, 1, 0], [1, 0, 0], [1, 2, 3]))
    same(small, SmallLight([1, 2, 3], [0, 0, -1], [4, 4, 4]))
    same(found.scene.ambient, scene.AmbientLight([0.1] * 3))
    assert found.lights == ('light "lamp"', "light[2]", "light[3]", "light[4]")


@pytest.mark.slow
def test_an_environment_is_oriented_by_its_centre_and_top(tmp_path):
    """The picture's centre column is in the direction `toward`, and its left quarter to the
    left."""
    picture = np.zeros((32, 64, 3), np.float32)
    picture[3:, 30:34, 0] = 1  # the middle
    picture[3:, 14:18, 1] = 1  # a quarter to the left
    picture[:3, :, 2] = 1  # the top
    write_image(tmp_path / "sky.exr", picture)
    light = (
        '[[light]]\nkind = "environment"\nfile = "sky.exr"\nscale = 2\n'
        "up = [0, 2, 0]\ntoward = [0, 0, 1]\n"
    )
    (sky,) = read(tmp_path, CAMERA + GREY + BALL + light).scene.lights
    at = jnp.zeros(3, jnp.float32)
    for direction, colour_seen in (([0, 0, 1], 0), ([1, 0, 0], 1), ([0, 1, 0], 2)):
        seen = radiance_from(sky, at, jnp.asarray(direction, jnp.float32))
        np.testing.assert_allclose(seen, 2 * np.eye(3)[colour_seen], atol=1e-5)


def chief(view, row, column):
    return camera_ray(view, jnp.float32(row), jnp.float32(column)).direction


def test_field_of_view_spans_the_width(tmp_path):
    """The outer edges of the centre row are 60 degrees apart."""
    view = read(tmp_path, SCENE).view
    sides = [np.asarray(chief(view, 14.5, column).x) for column in (-0.5, 39.5)]
    np.testing.assert_allclose(np.degrees(np.arcsin(sides)), [-30, 30], rtol=1e-6)
    ahead = chief(view, 14.5, 19.5)
    np.testing.assert_allclose([ahead.x, ahead.y, ahead.z], [0, 1, 0], atol=1e-7)
    assert chief(view, 0.0, 19.5).z > 0  # row 0 is the top


def test_other_cameras(tmp_path):
    lens = CAMERA.replace("pinhole", "thin_lens").replace(
        "field_of_view = 60",
        "focal_length = 0.05\npixel_pitch = 1e-5\nf_number = 2\nfocus_distance = 4\nblades = 6",
    )
    view = read(tmp_path, lens + LIGHT + GREY + BALL).view
    assert isinstance(view, scene.ThinLens)
    assert (view.resolution, view.aperture.blades) == ((30, 40), 6)
    np.testing.assert_allclose(
        [view.focal_length, view.pixel_pitch, view.f_number, view.focus_distance],
        [0.05, 1e-5, 2, 4],
        rtol=1e-6,
    )
    flat = CAMERA.replace("pinhole", "orthographic").replace("field_of_view = 60", "width = 8")
    view = read(tmp_path, flat + LIGHT + GREY + BALL).view
    assert isinstance(view, scene.Orthographic)
    at = jnp.float32(0), jnp.float32(39.5)
    np.testing.assert_allclose(pixel_offset(view, *at)[0], 4, rtol=1e-6)


LENS = "focal_length = 0.05\npixel_pitch = 1e-5\nf_number = 2\n"
EFFECTS = """
[camera.aperture]
kind = "AnnularAperture"
obstruction = 0.4
[camera.rim]
distance = 0.02
diameter = 0.03
[camera.distortion]
radial = [-0.1, 0.02]
tangential = [0.001, 0.0]
[camera.diffraction]
kind = "Wavefront"
coefficients = [0.0, 0.0, 0.0, 0.1]
wavelength = [4.5e-7, 5.5e-7, 6.5e-7]
"""


def lens_scene(tmp_path, effects, lens=LENS):
    text = CAMERA.replace("pinhole", "thin_lens").replace("field_of_view = 60", lens)
    return read(tmp_path, text + effects + LIGHT + GREY + BALL)


def test_effects_of_a_lens(tmp_path):
    """The file and Python give the same records, and a picture of radiance says which effects it
    lacks."""
    file = lens_scene(tmp_path, EFFECTS)
    wanted = {
        "aperture": scene.AnnularAperture(0.4),
        "rim": scene.Rim(0.02, 0.03),
        "distortion": scene.Distortion([-0.1, 0.02], [0.001, 0.0]),
        "diffraction": scene.Wavefront([0.0, 0.0, 0.0, 0.1], [4.5e-7, 5.5e-7, 6.5e-7]),
    }
    for name, record in wanted.items():
        found = getattr(file.view, name)
        assert jax.tree.structure(found) == jax.tree.structure(record)
        jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-6), found, record)
    (sentence,) = [s for s in light_findings(file, file.render) if "lens" in s]
    assert "rim and diffraction" in sentence
    bare = lens_scene(tmp_path, "")
    assert not any("lens" in s for s in light_findings(bare, bare.render))


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ("[camera.rim]\ndistance = 0.02\n", "camera.rim.diameter is missing"),
        ("[camera.rim]\ndistance = 0.02\ndiameter = -1\n", "camera.rim"),
        ("[camera.diffraction]\nwavelength = 5e-7\n", "camera.diffraction.kind is missing"),
        ('[camera.aperture]\nkind = "Round"\n', "camera.aperture.kind"),
    ],
)
def test_wrong_effects_of_a_lens_are_named(tmp_path, effects, message):
    with pytest.raises(InputError, match=message):
        lens_scene(tmp_path, effects)


def test_blades_and_an_aperture_exclude_each_other(tmp_path):
    with pytest.raises(InputError, match="give either blades or aperture"):
        lens_scene(tmp_path, EFFECTS, lens=LENS + "blades = 5")


# ------------------------------------------------ spectra


def spectral_file(folder):
    """Write a smooth reflectance at 380, 390, ... 780 nm, and return its values."""
    nm = np.arange(380, 781, 10.0)
    values = 0.5 + 0.4 * np.sin(nm / 90)
    lines = ["wavelength,other,wanted"] + [f"{w},1,{v}" for w, v in zip(nm, values, strict=True)]
    (folder / "paint.csv").write_text("\n".join(lines) + "\n")
    return nm, values


def test_a_spectrum_is_averaged_over_the_bands(tmp_path):
    nm, values = spectral_file(tmp_path)
    paint = 'family = "mirror"\nreflectance = {file = "paint.csv", column = "wanted", scale = 0.5}'
    head = "wavelengths = {first = 350, last = 800, step = 25}\n"
    lit = (CAMERA + LIGHT).replace("[10, 20, 30]", '{file = "paint.csv", column = "wanted"}')
    found = read(tmp_path, head + lit + f"[material.grey]\n{paint}\n" + BALL)
    grid = np.arange(350, 801, 25)
    np.testing.assert_allclose(found.wavelengths, grid * 1e-9)
    seen = found.scene.surfaces[0].material.reflectance
    np.testing.assert_allclose(seen, 0.5 * np.interp(grid, nm, values), rtol=1e-6)
    fine = np.arange(-12.5, 12.5, 0.005) + 0.0025  # values are means over the band
    inside = grid[2:-2, None] + fine  # bands inside the table
    expected = np.interp(inside, nm, values).mean(axis=1)
    intensity = np.asarray(found.scene.lights[0].intensity)
    np.testing.assert_allclose(intensity[2:-2], expected, rtol=1e-6)
    half = np.linspace(380, 387.5, 10_001)  # the part of the band at 375 nm in the table
    np.testing.assert_allclose(intensity[1], np.interp(half, nm, values).mean() * 0.3, rtol=1e-6)
    np.testing.assert_array_equal(intensity[[0, -1]], 0)  # there is no light outside the table


@pytest.mark.slow
def test_a_reflectance_in_rgb_is_its_colour_under_d65(tmp_path):
    """The reference is colour-science's integration of the same spectrum at 1 nm."""
    nm, values = spectral_file(tmp_path)
    paint = 'family = "mirror"\nreflectance = {file = "paint.csv", column = "wanted"}'
    ours = material_of(tmp_path, paint).reflectance
    fine = np.arange(360, 831)
    distribution = colour.SpectralDistribution(np.interp(fine, nm, values), fine)
    shape = colour.SpectralShape(360, 830, 1)
    d65 = colour.SDS_ILLUMINANTS["D65"].copy().align(shape)
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    xyz = colour.sd_to_XYZ(distribution, cmfs, d65, method="Integration", shape=shape)
    theirs = colour.XYZ_to_sRGB(xyz / 100, apply_cctf_encoding=False)
    np.testing.assert_allclose(ours, theirs, atol=2e-3)
    white = 'family = "mirror"\nreflectance = {file = "paint.csv", column = "other"}'  # all 1
    np.testing.assert_allclose(material_of(tmp_path, white).reflectance, 1, atol=1e-3)


@pytest.mark.slow
def test_flat_light_in_rgb_has_luminance_one(tmp_path):
    spectral_file(tmp_path)
    lamp = 'intensity = {illuminant = "E", scale = 0.01}'
    (light,) = read(tmp_path, SCENE.replace("intensity = [10, 20, 30]", lamp)).scene.lights
    luminance = np.array([0.2126, 0.7152, 0.0722]) @ np.asarray(light.intensity)
    np.testing.assert_allclose(luminance, 1, rtol=1e-3)
    assert light.intensity[0] > light.intensity[1] > light.intensity[2]  # E is warmer than D65


def test_a_patch_and_a_black_body(tmp_path):
    head = "wavelengths = [450, 550, 650]\n"
    lamp = SCENE.replace("[10, 20, 30]", "{blackbody = 3000}").replace(
        "albedo = 0.5", 'albedo = {patch = "white 9.5 (.05 D)", chart = "ColorChecker N Ohta"}'
    )
    found = read(tmp_path, head + lamp).scene
    nm = np.array([450, 550, 650])
    chart = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"]["white 9.5 (.05 D)"]
    np.testing.assert_allclose(found.surfaces[0].material.diffuse * np.pi, chart[nm], rtol=1e-5)
    np.testing.assert_allclose(
        found.lights[0].intensity,
        2 * h * c**2 / (nm * 1e-9) ** 5 / np.expm1(h * c / (nm * 1e-9 * k * 3000)),
        rtol=1e-5,
    )


@pytest.mark.slow
def test_measured_materials_have_the_bands_of_the_scene(tmp_path):
    """An RGB file is unchanged, and a spectral one is interpolated at the given wavelengths."""
    rng = np.random.default_rng(4)
    table = HalfDifferenceTable(rng.uniform(0.1, 1, (6, 5, 4, 3)))
    write_merl(tmp_path / "paint.binary", table)
    paint = 'family = "measured"\nfile = "paint.binary"\n'
    found = material_of(tmp_path, paint)
    np.testing.assert_allclose(found.values, table.values, rtol=1e-6)
    assert found.sampler is not None
    with pytest.raises(InputError, match=r"material\.grey\.file: .*paint\.binary: holds RGB where"):
        material_of(tmp_path, paint, head="wavelengths = [450, 550, 650]\n")


# ------------------------------------------------ shipped scenes


def test_the_shipped_cornell_box_has_the_published_numbers():
    assert shipped_scenes() == ["cornell_box", "cornell_box_spectral", "glass_and_mirror"]
    found = read_scene("cornell_box")
    same(found.scene, jax.tree.map(np.asarray, cornell_box.scene()))
    same(found.view, cornell_box.view(512))


@pytest.mark.slow
def test_the_spectral_cornell_box_is_the_same_room_for_a_shipped_camera():
    found, room = read_scene("cornell_box_spectral"), read_scene("cornell_box")
    for one, other in zip(found.scene.surfaces, room.scene.surfaces, strict=True):
        same(one.shape, other.shape)
    same(found.view, room.view)
    nanometres = [*range(400, 701, 10)]
    white, green, lamp = (
        dict(zip(nanometres, np.asarray(values), strict=True))
        for values in (
            np.pi * found.scene.surfaces[0].material.diffuse,
            np.pi * found.scene.surfaces[3].material.diffuse,
            found.scene.lights[0].radiance,
        )
    )
    # Published values: 0.747 and 0.285 at 500 nm, 0.745 and 0.755 at 608 and 612 nm, and for the
    # lamp 8 and 15.6 at 500 and 600 nm.
    walls = [white[500], green[500], white[610]]
    np.testing.assert_allclose(walls, [0.747, 0.285, 0.75], rtol=1e-6)
    found_lamp = [lamp[400], lamp[500], lamp[550], lamp[600]]
    # A band of 10 nm is the mean of the lines between these points, with slopes of .08, .076 and
    # .028 per nm.
    means = [2.5 * 0.08, 8 - 1.25 * (0.08 - 0.076), 11.8, 15.6 - 1.25 * (0.076 - 0.028)]
    np.testing.assert_allclose(found_lamp, means, rtol=1e-6)
    camera = replace(read_camera("consumer_bayer"), view=replace(found.view, f_number=4.0))
    key = jax.random.key(0)
    camera = jv.as_dtype(camera, "float32")  # as the scene
    shot = jax.eval_shape(lambda: jv.capture(key, found.scene, camera, die_key=key))
    assert shot.raw.shape[:2] == tuple(found.view.resolution)


def test_the_glass_and_mirror_scene_has_both():
    kinds = {type(surface.material) for surface in read_scene("glass_and_mirror").scene.surfaces}
    assert {Glass, mirror.Mirror, lambert.Lambert, TorranceSparrow} == kinds


# ------------------------------------------------ invalid files

REFUSED = {
    "colour = 3": (SCENE + "colour = 3", r'surface "ball"\.colour is not a key of a scene file'),
    "misspelt": (SCENE.replace("radius", "radios"), "radios is not a key .* nearest is 'radius'"),
    "nested": (
        SCENE.replace("0.5", '{illuminent = "D65"}'),
        r"material\.grey\.albedo\.illuminent is not a key .* nearest is 'illuminant'",
    ),
    "missing": (SCENE.replace("radius = 1", ""), r'surface "ball"\.radius is missing; add it'),
    "true": (SCENE.replace("radius = 1", "radius = true"), r'surface "ball"\.radius = True'),
    "word": (SCENE.replace("radius = 1", 'radius = "1"'), r'surface "ball"\.radius = \'1\''),
    "no shape": (SCENE.replace('shape = "sphere"', ""), r'surface "ball": shape is missing'),
    "shape": (SCENE.replace('"sphere"', '"spere"'), "shape = 'spere' is unknown.* is 'sphere'"),
    "family": (SCENE.replace('"lambert"', '"lambertian"'), "family = 'lambertian' .*'lambert'"),
    "material": (
        SCENE.replace('material = "grey"', 'material = "gray"'),
        "surface \"ball\": material 'gray' is not in the file; the nearest is 'grey'",
    ),
    "nan": (SCENE.replace("[0, 0, 0]\nradius", "[0, nan, 0]\nradius"), r"centre\[2\] = nan"),
    "negative": (
        SCENE.replace("[10, 20, 30]", "[1, -2, 3]"),
        r'"lamp"\.intensity\[2\] must be .*, got -2',
    ),
    "bands": (
        SCENE.replace("[10, 20, 30]", "[1, 2]"),
        r'light "lamp"\.intensity: a spectrum has 2 numbers',
    ),
    "albedo": (SCENE.replace("0.5", "1.5"), r"material\.grey: an albedo is at most 1"),
    "both": (SCENE.replace("0.5", "0.5\ndiffuse = 0.1"), r"material\.grey: give either diffuse"),
    "no field": (SCENE.replace("field_of_view = 60", ""), "camera: give either field_of_view"),
    "up": (SCENE.replace("target", "up = [0, 1, 0]\ntarget"), "camera: up lies along the line"),
    "eye": (SCENE.replace("target = [0, 0, 0]", "target = [0, -4, 0]"), "camera: .* one point"),
    "countless": (
        SCENE + f"[render]\nsamples = 1{22 * '0'}\n",
        r"render\.samples = 1000.*2147483648",
    ),
    "fine grid": (
        "wavelengths = {first = 400, last = 700, step = 1e-20}\n" + SCENE,
        r"wavelengths: 3e\+22 wavelengths are more than 100,000",
    ),
    "grid": (
        "wavelengths = {first = 400, last = 500, step = 33}\n" + SCENE,
        "wavelengths: last must lie a whole number of steps",
    ),
    "descends": ("wavelengths = [500, 400]\n" + SCENE, "a.toml: wavelengths must ascend"),
    "rotation": (
        SCENE.replace('shape = "sphere"', 'shape = "box"').replace(
            "radius = 1",
            "half_extents = [1, 1, 1]\nrotation = [[2, 0, 0], [0, 1, 0], [0, 0, 1]]",
        ),
        'surface "ball": rotation must hold three',
    ),
    "mesh": (
        SCENE.replace('"sphere"\ncentre = [0, 0, 0]\nradius = 1', '"mesh"\nfile = "cow.obj"'),
        r'surface "ball": .*cow\.obj: no such file',
    ),
    "sky": (
        SCENE + '[[light]]\nname = "sky"\nkind = "environment"\nfile = "sky.exr"\n',
        r'light "sky"\.file: .*sky\.exr: no such file',
    ),
    "dark": (SCENE.replace(LIGHT, ""), "the scene has no light"),
    "light inside": (
        SCENE.replace("[1, -2, 3]", "[0.5, 0, 0]"),
        'light "lamp": lies inside surface "ball", which hides it',
    ),
    "camera inside": (SCENE.replace("[0, -4, 0]", "[0, -0.4, 0]"), 'camera: lies inside .*"ball"'),
    "flat light": (
        SCENE + '[[light]]\nkind = "rectangle"\ncorner = [0, 0, 3]\nedge_u = [1, 1, 0]\n'
        "edge_v = [2, 2, 0]\nradiance = 1\n",
        r"light\[2\]: .*edge_u and edge_v are parallel: these edges span no area",
    ),
    "no direction": (
        SCENE + '[[light]]\nkind = "directional"\ndirection = [0, 0, 0]\nirradiance = 1\n',
        r"light\[2\]: DirectionalLight.direction must have a direction",
    ),
    # without float64 in JAX, the number is lost before it can be checked
    "tiny": (SCENE.replace("radius = 1", "radius = 1e-60"), r'"ball": .*radius (holds 1e-60|must)'),
    "bright": (SCENE.replace("[10, 20, 30]", "[1, 1e40, 1]"), '"lamp": .* which float32 cannot'),
    "thin": (
        SCENE.replace('"sphere"', '"box"').replace("radius = 1", "half_extents = [1, 1, 1e-60]"),
        r'surface "ball": Box\.half_extents must be positive',
    ),
    "no angle": (SCENE.replace("= 60", "= nan"), "field_of_view = nan: must be a finite number"),
    "toml": (SCENE + "[", "not a TOML file"),
    "one table": (SCENE.replace("[[surface]]", "[surface]"), r"head it \[\[surface\]\]"),
    "no table": (SCENE.replace("[material.grey]", "[[material.grey]]"), "grey must be a table"),
    "many": (SCENE.replace("[30, 40]", f"[{'9, ' * 90}]"), "resolution lists 90; give at most 2"),
    "long": (SCENE.replace("[30, 40]", f"'{'9' * 900}'"), r"\.\.\.: "),
}


@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
@pytest.mark.parametrize("case", REFUSED)
def test_mistakes_are_one_sentence_each(tmp_path, case):
    text, sentence = REFUSED[case]
    with pytest.raises(InputError, match=sentence) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "a.toml"))
    assert message.count("\n") == 0
    assert message.endswith(".")


SHAPELESS = {
    "quad": '"quad"\ncorner = [0, 0, 0]\nedge_u = [1, 0, 0]\nedge_v = [2, 0, 0]',
    "plane": '"plane"\npoint = [0, 0, 0]\nnormal = [0, 0, 0]',
    "disc": '"disc"\ncentre = [0, 0, 0]\nnormal = [0, 0, 0]\nradius = 1',
}


@pytest.mark.parametrize("shape", SHAPELESS)
def test_shapes_without_area_or_normal_are_named(tmp_path, shape):
    text = SCENE.replace('"sphere"\ncentre = [0, 0, 0]\nradius = 1', SHAPELESS[shape])
    with pytest.raises(InputError, match=r'a\.toml: surface "ball": '):
        read(tmp_path, text)


def test_missing_scenes_are_named():
    with pytest.raises(InputError, match="nearest is 'cornell_box'"):
        read_scene("cornel_box")
    with pytest.raises(InputError, match=r"none\.toml: no such scene file"):
        read_scene("none.toml")


@pytest.mark.parametrize(
    ("column", "rows", "sentence"),
    [
        ("c", ["400,1", "500,2"], "no column 'c'; use one of b"),
        ("b", ["400,1", "500,x"], "line 3: '500,x' has no number for 'b'"),
        ("b", ["500,1", "400,2"], "wavelengths ascend"),
        ("b", ["400,1", "500,-2"], "negative"),
        ("b", ["400,1"], "at least two rows"),
    ],
)
def test_bad_tables_are_named(tmp_path, column, rows, sentence):
    (tmp_path / "t.csv").write_text("\n".join(["a,b", *rows]))
    paint = f'family = "mirror"\nreflectance = {{file = "t.csv", column = "{column}"}}'
    with pytest.raises(InputError, match=rf"material\.grey\.reflectance: .*t\.csv.*{sentence}"):
        material_of(tmp_path, paint)


def test_warnings_about_a_file_name_its_surface(tmp_path):
    """Slivers far from the origin have no area in float32, and are left out like other triangles
    without area."""
    (tmp_path / "m.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1e-4\nf 1 2 3\nf 1 1 2\nf 1 2 4\n"
    )
    text = SCENE + '[[surface]]\nname = "leaf"\nshape = "mesh"\nfile = "m.obj"\nmaterial = "grey"\n'
    with pytest.warns(UserWarning, match=r'a\.toml: surface "leaf": .*m\.obj: 1 of 3 triangles'):
        read(tmp_path, text)
    with pytest.warns(UserWarning, match=r'surface "leaf": .*m\.obj: 2 of 3 triangles'):
        mesh = read(tmp_path, text + "position = [0, 0, 5000]\n").scene.surfaces[1].shape
    assert mesh.vertices.dtype == np.float32
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2]])


def test_inside_glass_and_two_sided_surfaces_are_allowed(tmp_path):
    """A camera in glass and a lamp in a lantern both see their surroundings."""
    glass = SCENE.replace('family = "lambert"\nalbedo = 0.5', 'family = "glass"')
    read(tmp_path, glass.replace("[0, -4, 0]", "[0, -0.4, 0]"))
    read(tmp_path, SCENE.replace("[1, -2, 3]", "[0.5, 0, 0]") + "two_sided = true\n")


def test_the_digest_depends_on_numbers_and_choices_and_not_on_comments(tmp_path):
    spectral_file(tmp_path)
    text = SCENE.replace("0.5", '{file = "paint.csv", column = "wanted"}')
    first = read(tmp_path, text).digest
    paint = (tmp_path / "paint.csv").read_text()
    (tmp_path / "paint.csv").write_text(paint.replace(",1,", ",0.9,"))  # an unused column
    assert read(tmp_path, text + "# more\n").digest == first
    (tmp_path / "paint.csv").write_text(paint.replace("380.0,1,0.", "380.0,1,0.9"))
    second = read(tmp_path, text).digest
    assert len({first, second, read(tmp_path, text + "two_sided = true\n").digest}) == 3


def test_the_digest_depends_on_files_named_in_files(tmp_path):
    """A glTF keeps its vertices in another file, and the file that the scene names is unchanged."""
    trimesh = pytest.importorskip("trimesh")
    text = CAMERA + LIGHT + GREY
    text += '[[surface]]\nshape = "mesh"\nfile = "model.gltf"\nmaterial = "grey"\n'
    files = trimesh.exchange.gltf.export_gltf(trimesh.creation.box([1, 1, 1]).scene())
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    first = read(tmp_path, text).digest
    (vertices,) = (tmp_path / name for name, data in files.items() if len(data) == 4 * 3 * 8)
    points = np.frombuffer(vertices.read_bytes(), "<f4").reshape(8, 3)
    vertices.write_bytes((points * np.float32(0.99)).tobytes())
    assert read(tmp_path, text).digest != first


# ------------------------------------------------ checks of a scene


def tetrahedron(order):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    outward = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return scene.TriangleMesh(vertices, outward[:, order])


def test_inside_of_meshes_boxes_and_spheres():
    """The reference evaluates the inequalities of a tetrahedron and of a rotated box."""
    rng = np.random.default_rng(2)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    box = scene.Box([0.2, 0.1, 0.3], [0.4, 0.2, 0.3], rotation=turn)
    for point in rng.uniform(-0.5, 1, (300, 3)):
        within = bool((point > 0).all() and point.sum() < 1)
        assert scene_checks.is_inside(tetrahedron([0, 1, 2]), point) == within
        assert scene_checks.is_inside(tetrahedron([0, 2, 1]), point) == within
        local = turn @ (point - [0.2, 0.1, 0.3])
        assert scene_checks.is_inside(box, point) == bool((abs(local) < [0.4, 0.2, 0.3]).all())


def test_a_mesh_turned_inside_out_is_named():
    lamp = PointLight([3, 3, 3], [1.0])
    view = scene.Pinhole([9, 9, 9], np.eye(3), 1.0, 0.1, resolution=(2, 2))

    def found(mesh, **options):
        surface = scene.Surface(mesh, lambert.Lambert([0.1]), **options)
        return scene_checks.scene_problems(scene.Scene([surface], [lamp]), view, ["cow"], ["lamp"])

    assert found(tetrahedron([0, 1, 2])) == []
    (sentence,) = found(tetrahedron([0, 2, 1]))
    assert sentence.startswith("cow: the triangles of this closed mesh face inwards")
    assert found(tetrahedron([0, 2, 1]), two_sided=True) == []
    holed = scene.TriangleMesh(tetrahedron([0, 2, 1]).vertices, tetrahedron([0, 2, 1]).faces[:3])
    assert found(holed) == []


def test_hidden_emitters_bulbs_on_floors_and_normals_behind_are_named():
    view = scene.Pinhole([9, 9, 9], np.eye(3), 1.0, 0.1, resolution=(2, 2))
    white = lambert.Lambert([0.1])

    def found(shapes, bulb, **shining):
        surfaces = [scene.Surface(shape, white) for shape in shapes[:1]]
        surfaces += [scene.Surface(shape, white, **shining) for shape in shapes[1:]]
        lit = scene.Scene(surfaces, [PointLight(bulb, [1.0])])
        return scene_checks.scene_problems(lit, view, ["outer", "inner"][: len(shapes)], ["bulb"])

    ball = scene.Sphere([0, 0, 0], 1.0)
    inner = [
        scene.Sphere([0.2, 0, 0], 0.7),
        scene.Box([0, 0.1, 0], [0.3, 0.3, 0.3]),
        scene.Disc([0, 0, 0.1], [0, 1, 1], 0.8),
        scene.Quad([-0.3, -0.3, 0], [0.6, 0, 0], [0, 0.6, 0]),
    ]
    for shape in inner:
        (sentence,) = found([ball, shape], [3, 3, 3], emission=[1.0])
        assert sentence.startswith("inner: lies inside outer, which hides it")
        assert found([ball, shape], [3, 3, 3]) == []
    for shape in (scene.Sphere([0.5, 0, 0], 0.7), scene.Disc([0, 0, 0.5], [0, 1, 1], 0.9)):
        assert found([ball, shape], [3, 3, 3], emission=[1.0]) == []  # part of it is outside
    floors = [
        scene.Plane([1, 2, 0.5], [0, 0, 2.0]),
        scene.Quad([-1, -1, 0.5], [2, 0, 0], [0, 2, 0]),
        scene.Disc([0, 0, 0.5], [0, 0, 3.0], 1.0),
        scene.Sphere([0.2, 0.3, 0.3], 0.2),
        scene.Box([0.2, 0.2, 0.4], [0.2, 0.3, 0.1]),
    ]
    for shape in floors:
        sentence, *_ = found([shape], [0.2, 0.3, 0.5])
        assert sentence.startswith("bulb: lies on outer, which it cannot light from there")
        assert found([shape], [0.2, 0.3, 0.51]) == []
    assert found(floors[1:2], [1.2, 0.3, 0.5]) == found(floors[2:3], [0.8, 0.7, 0.5]) == []
    for normal, count in (([0, 0, -1.0], 1), ([0, 0, 1.0], 0), ([0, 0, 0.0], 0)):
        corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]
        leaf = scene.TriangleMesh(corners, [[0, 1, 2]], normals=[normal] * 3)
        sentences = found([leaf], [3, 3, 3])
        assert len(sentences) == count
        assert all("normals that all point behind their face: 0 (1 in all)" in s for s in sentences)
