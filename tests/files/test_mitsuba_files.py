"""Tests scenes of Mitsuba: its own pictures are reproduced, and unsupported content is refused by
name."""

import warnings

import numpy as np
import pytest
from oracles import mitsuba_pictures

from jaxvision.brdf.coated import Coated
from jaxvision.errors import InputError
from jaxvision.files.images import write_image
from jaxvision.files.scenes import read_scene
from jaxvision.render_command.integrators import pixels_of
from jaxvision.scene import Box, Disc, Orthographic, Quad, Sphere

SENSOR = mitsuba_pictures.camera("perspective", '<float name="fov" value="40"/>')
BALL = '<shape type="sphere" id="ball"/><emitter type="constant"/>'


def read(folder, *parts, version="3.0.0"):
    (folder / "a.xml").write_text(f'<scene version="{version}">{"".join(parts)}</scene>')
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # paths without a limit
        return read_scene(folder / "a.xml")


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("name", ["shapes", "lens", "lamps", "metals", "maps"])
@pytest.mark.filterwarnings("ignore:.*facets hide each other")
def test_pictures_equal_mitsubas(name, tmp_path):
    """The mean of all pixels and the RMS difference are within the noise of both."""
    mitsuba_pictures.write_scenes(tmp_path)
    write_image(tmp_path / "sky.exr", mitsuba_pictures.sky())
    for file, codes in mitsuba_pictures.textures().items():
        write_image(tmp_path / file, codes)
    known = np.load(mitsuba_pictures.PICTURES)
    source = read_scene(tmp_path / f"{name}.xml")
    number = np.arange(12 * 16)
    halves = []
    for seed in (0, 1):
        settings = source.render.model_copy(update={"samples": 512, "seed": seed})
        picture, _ = pixels_of(source, settings)(number // 16, number % 16)
        halves.append(picture.reshape(12, 16, 3))
    got, theirs = np.mean(halves, axis=0, dtype=float), known[name].astype(float)
    noise = np.mean((halves[0] - halves[1]) ** 2) / 4 + np.mean(known[f"{name} error"] ** 2)
    level = theirs.mean()
    assert got.mean() == pytest.approx(level, abs=4 * np.sqrt(noise / 192) + 2e-3 * level)
    assert np.sqrt(np.mean((got - theirs) ** 2)) < 2 * np.sqrt(noise) + 4e-3 * level


def test_shapes_stand_where_their_corners_are(tmp_path):
    """A point of each shape is mapped by hand."""
    turned = """<transform name="to_world"><scale x="2" y="3" z="4"/><rotate z="1" angle="90"/>
    <translate x="1" y="2" z="3"/></transform>"""
    ball = """<shape type="sphere"><point name="center" x="1" y="0" z="0"/>
    <float name="radius" value="2"/><transform name="to_world"><scale value="3"/>
    <rotate z="1" angle="90"/><translate z="1"/></transform></shape>"""
    flat = '<transform name="to_world"><scale x="-2" y="2" z="5"/></transform>'
    shapes = [
        surface.shape
        for surface in read(
            tmp_path,
            SENSOR,
            '<emitter type="constant"/>',
            f'<shape type="rectangle">{turned}</shape>',
            f'<shape type="cube">{turned}</shape>',
            ball,
            f'<shape type="disk">{flat}</shape>',
            f'<shape type="rectangle">{flat}</shape>',
        ).scene.surfaces
    ]
    quad, box, sphere, disc, mirrored = shapes
    assert isinstance(quad, Quad)
    np.testing.assert_allclose(quad.corner, [1 + 3, 2 - 2, 3], atol=1e-6)
    np.testing.assert_allclose(quad.edge_u, [0, 4, 0], atol=1e-6)
    np.testing.assert_allclose(quad.edge_v, [-6, 0, 0], atol=1e-6)
    assert isinstance(box, Box)
    np.testing.assert_allclose(box.centre, [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(box.half_extents, [2, 3, 4], rtol=1e-6)
    np.testing.assert_allclose(box.rotation, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-6)
    assert isinstance(sphere, Sphere)
    np.testing.assert_allclose(sphere.centre, [0, 3, 1], atol=1e-6)
    np.testing.assert_allclose(sphere.radius, 6, rtol=1e-6)
    assert isinstance(disc, Disc)  # mirrored left and right, but not front and back
    np.testing.assert_allclose(disc.normal / np.linalg.norm(disc.normal), [0, 0, 1], atol=1e-6)
    front = np.cross(mirrored.edge_u, mirrored.edge_v)
    np.testing.assert_allclose(front / np.linalg.norm(front), [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("settings", "degrees"),
    [
        ('<float name="fov" value="40"/>', 40),
        ('<float name="fov" value="40"/><string name="fov_axis" value="larger"/>', 40),
        ('<float name="fov" value="40"/><string name="fov_axis" value="y"/>', 51.7732),
        ('<float name="fov" value="40"/><string name="fov_axis" value="smaller"/>', 51.7732),
        ('<float name="fov" value="40"/><string name="fov_axis" value="diagonal"/>', 32.4686),
        ('<string name="focal_length" value="50mm"/>', 38.1848),
        ("", 38.1848),  # the default
        ('<string name="fov_axis" value="y"/>', 38.1848),  # of a fov without an axis
        ('<float name="fov" value="40"/><float name="principal_point_offset_y" value="-0.0"/>', 40),
    ],
)
def test_fields_of_view(settings, degrees, tmp_path):
    """The reference uses the tangents of a picture 4 wide and 3 high, and of a film of 36 mm x 24
    mm."""
    sensor = mitsuba_pictures.camera("perspective", settings)
    view = read(tmp_path, sensor, BALL).view
    half = view.pixel_pitch * view.resolution[1] / 2 / view.focal_length
    assert 2 * np.degrees(np.arctan(half)) == pytest.approx(degrees, rel=1e-4)


def test_an_old_file_has_the_defaults_of_its_version(tmp_path):
    """Before version 2, a scene without an integrator has direct light only, and a metal without a
    name is copper."""
    sky = '<emitter type="constant"/>'
    whole = f'<scene version="0.5.0">{SENSOR}{BALL}{sky}</scene>'
    (tmp_path / "old.xml").write_text(whole)
    assert read_scene(tmp_path / "old.xml").render.depth == 2
    (tmp_path / "new.xml").write_text(whole.replace("0.5.0", "2.0.0"))
    with pytest.warns(UserWarning, match="max_depth has no limit"):
        assert read_scene(tmp_path / "new.xml").render.depth > 2
    metal = '<shape type="sphere"><bsdf type="conductor"/></shape>'
    (tmp_path / "new.xml").write_text(f'<scene version="3.0.0">{SENSOR}{metal}{sky}</scene>')
    with pytest.warns(UserWarning, match="max_depth has no limit"):
        read_scene(tmp_path / "new.xml")
    (tmp_path / "old.xml").write_text(f'<scene version="0.5.0">{SENSOR}{metal}{sky}</scene>')
    with pytest.raises(InputError, match="give eta and k of 'Cu'"):
        read_scene(tmp_path / "old.xml")


def test_an_old_file_is_read_with_its_names(tmp_path):
    """Versions before 2 join words by capital letters. Included files may use the defaults."""
    (tmp_path / "b.xml").write_text('<scene version="0.6.0"><shape type="sphere"/></scene>')
    source = read(
        tmp_path,
        '<default name="n" value="64"/><integrator type="direct"/>',
        f"""<sensor type="orthographic"><transform name="toWorld">
        {mitsuba_pictures.LOOK.replace("lookat", "lookAt")}</transform><sampler type="independent">
        <integer name="sampleCount" value="$n"/></sampler></sensor><emitter type="point">
        <transform name="toWorld"><translate x="5"/></transform></emitter>""",
        '<include filename="b.xml"/>',
        version="0.6.0",
    )
    assert (source.render.samples, source.render.depth) == (64, 2)
    assert isinstance(source.view, Orthographic)
    assert source.view.resolution == (576, 768)
    np.testing.assert_allclose(source.scene.lights[0].position, [5, 0, 0])


@pytest.mark.filterwarnings("ignore:.*max_depth has no limit")
def test_plastics_are_bodies_under_coats(tmp_path):
    """Their body's albedo is the one that returns as much light."""
    index = '<float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/>'
    grey = '<rgb name="diffuse_reflectance" value="0.9 0.5 0.1"/>'
    inside = '<shape type="sphere"><bsdf type="{}">{}</bsdf></shape><emitter type="constant"/>'
    plain = inside.format("plastic", index + grey)
    own = read(tmp_path, SENSOR, plain).scene.surfaces[0].material
    assert isinstance(own, Coated)
    r = np.pi * np.asarray(own.body.diffuse)
    kept = np.array([0.9, 0.5, 0.1]) / (1 - 0.59635)
    np.testing.assert_allclose(r / (1 - 0.59635 * r), kept, rtol=1e-4)
    shows = '<boolean name="nonlinear" value="true"/>'
    own = read(tmp_path, SENSOR, inside.format("plastic", index + grey + shows))
    np.testing.assert_allclose(
        np.pi * own.scene.surfaces[0].material.body.diffuse, [0.9, 0.5, 0.1], rtol=1e-5
    )
    own = read(tmp_path, SENSOR, inside.format("roughplastic", grey))
    with pytest.warns(UserWarning, match="a rough coat without absorption loses no light here"):
        read_scene(tmp_path / "a.xml")
    assert own.scene.surfaces[0].material.roughness == pytest.approx(0.1)
    assert own.scene.surfaces[0].material.distribution == "beckmann"


def test_lights_without_a_colour_are_white(tmp_path):
    """White is sRGB's, as in Mitsuba. A `<spectrum>` of one value has equal energy."""
    lamp = '<shape type="sphere"><emitter type="area">{}</emitter></shape>'
    for inside, white in (("", True), ('<spectrum name="radiance" value="1"/>', False)):
        surface = read(tmp_path, SENSOR, lamp.format(inside)).scene.surfaces[0]
        rgb = np.broadcast_to(surface.emission, 3)
        assert (np.ptp(rgb) < 1e-6) == white
        assert (rgb == pytest.approx(1)) == white
    aside = '<point name="position" x="5" y="0" z="0"/>'
    for kind, name, inside in (
        ("point", "intensity", aside),
        ("directional", "irradiance", ""),
        ("constant", "radiance", ""),
    ):
        lamp = f'<shape type="sphere"/><emitter type="{kind}">{inside}</emitter>'
        light = read(tmp_path, SENSOR, lamp).scene.lights[0]
        np.testing.assert_allclose(getattr(light, name), 1, rtol=1e-6)  # a sky: each pixel


def test_an_orthographic_camera_may_be_scaled_only_across(tmp_path):
    """As in Mitsuba's documentation. The width is twice the scale."""
    turned = f'<transform name="to_world"><scale x="10" y="10"/>{mitsuba_pictures.LOOK}</transform>'
    view = read(tmp_path, f'<sensor type="orthographic">{turned}</sensor>', BALL).view
    assert view.pixel_pitch * view.resolution[1] == pytest.approx(20)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (["<shape"], "not an XML file"),
        ([BALL], "has no <sensor>"),
        ([SENSOR, '<medium type="homogeneous"/>', BALL], "<medium"),
        ([SENSOR, '<shape type="cylinder"/>'], "'cylinder' is not read"),
        ([SENSOR, '<shape type="sphere"><float name="raduis" value="2"/></shape>'], "'radius'"),
        ([SENSOR, '<shape type="sphere"><ref id="steel"/></shape>'], "id 'steel'"),
        (
            [SENSOR, '<shape type="sphere"><bsdf type="principled"/></shape>'],
            "'principled' is not read",
        ),
        (
            [
                SENSOR,
                """<shape type="sphere"><bsdf type="diffuse"><texture name="reflectance"
                type="checkerboard"/></bsdf></shape>""",
            ],
            "reflectance is a texture",
        ),
        (
            [
                SENSOR,
                """<shape type="sphere"><transform name="to_world"><scale x="2"/></transform>
                </shape>""",
            ],
            "ellipsoid",
        ),
        (
            [
                SENSOR,
                """<shape type="cube"><transform name="to_world"><rotate x="1" y="1" angle="9"/>
                </transform></shape>""",
            ],
            "length 1",
        ),
        (
            [
                SENSOR,
                """<shape type="rectangle"><transform name="to_world"><scale z="0"/></transform>
                </shape>""",
            ],
            "flattens",
        ),
        ([SENSOR, '<shape type="obj"/>'], "no filename"),
        (
            [SENSOR, '<shape type="obj"><string name="filename" value="none.obj"/></shape>'],
            "none.obj",
        ),
        ([SENSOR, BALL, '<emitter type="projector"/>'], "'projector' is not read"),
        (
            [SENSOR, BALL, '<emitter type="point"><float name="$a" value="1"/></emitter>'],
            r"\$a has no",
        ),
        (
            [
                SENSOR,
                BALL,
                '<emitter type="point"><rgb name="intensity" value="1 nan 2"/></emitter>',
            ],
            "finite numbers",
        ),
        (
            [
                SENSOR,
                """<shape type="sphere"><bsdf type="diffuse"><spectrum name="reflectance"
                value="500:.1, 400:.2"/></bsdf></shape>""",
            ],
            "ascend",
        ),
        (
            [
                SENSOR,
                """<shape type="sphere"><bsdf type="diffuse"><rgb name="reflectance"
                value="1.5"/></bsdf></shape>""",
            ],
            "at most 1",
        ),
        (
            [
                mitsuba_pictures.camera(
                    *("perspective", '<float name="principal_point_offset_x" value=".1"/>')
                ),
                BALL,
            ],
            "principal_point_offset_x is not read, only 0",
        ),
        (
            [
                mitsuba_pictures.camera(
                    "perspective",
                    '<float name="fov" value="4"/><string name="focal_length" value="50mm"/>',
                ),
                BALL,
            ],
            "has a fov and a focal_length",
        ),
        ([SENSOR.replace('value="16"', 'value="0"'), BALL], "at least 1"),
        ([SENSOR.replace('"fov"', '"fov_"'), BALL], "'fov_' is not read"),
        (
            [SENSOR, BALL, '<emitter type="point"><point name="to_world" x="1"/></emitter>'],
            "to_world is of an unexpected kind",
        ),
        (
            [mitsuba_pictures.camera("perspective", '<string name="focal_length" value="0mm"/>')],
            "above 0, as in",
        ),
        (['<integrator type="aov"/>', SENSOR, BALL], "'aov' is not read"),
        (
            [
                SENSOR,
                """<shape type="sphere"><bsdf type="roughconductor"><string name="material"
                value="Au"/></bsdf></shape>""",
            ],
            "metals by name",
        ),
        (['<include filename="a.xml"/>', SENSOR, BALL], "more than 16 files"),
        ([SENSOR, 2 * '<bsdf type="diffuse" id="red"/>', BALL], "two objects have the id 'red'"),
    ],
)
def test_unsupported_content_is_named(parts, words, tmp_path):
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, *parts)
    assert "a.xml" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_warnings_name_the_file(tmp_path):
    mitsuba_pictures.write_scenes(tmp_path)
    with pytest.warns(UserWarning, match=r"metals\.xml: .*facets hide each other"):
        read_scene(tmp_path / "metals.xml")


def test_clipping_planes_that_are_not_used_are_named(tmp_path):
    box = '<film type="hdrfilm"><rfilter type="box"/></film><float name="fov" value="40"/>'
    direct = '<integrator type="direct"/>'
    for clips, count in (
        ('<float name="near_clip" value="2"/><float name="far_clip" value="5"/>', 1),
        ('<float name="near_clip" value="0.01"/><float name="far_clip" value="10000"/>', 0),
        ("", 0),
    ):
        sensor = f'<sensor type="perspective">{box}{clips}</sensor>'
        away = '<shape type="sphere"><point name="center" x="0" y="0" z="5"/></shape>'
        text = f'<scene version="3.0.0">{sensor}{direct}{away}<emitter type="constant"/></scene>'
        (tmp_path / "a.xml").write_text(text)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            read_scene(tmp_path / "a.xml")
        assert ["near_clip and far_clip are not used" in str(w.message) for w in said] == count * [
            True
        ]


def test_a_black_body_emits_by_plancks_law(tmp_path):
    """The reference uses h, c and k of the SI, per nm, like a table of wavelengths in nm."""
    nm = np.arange(360.0, 831.0)
    planck = 2 * 6.62607015e-34 * 299792458.0**2 / (nm * 1e-9) ** 5
    planck /= np.expm1(6.62607015e-34 * 299792458.0 / (nm * 1e-9 * 1.380649e-23 * 5000))
    table = ",".join(f"{a:g}:{1e-9 * b:.9g}" for a, b in zip(nm, planck, strict=True))
    lights = [
        '<emitter type="constant"><spectrum type="blackbody" name="radiance">'
        '<float name="temperature" value="5000"/></spectrum></emitter>',
        f'<emitter type="constant"><spectrum name="radiance" value="{table}"/></emitter>',
    ]
    away = '<shape type="sphere"><point name="center" x="0" y="0" z="50"/></shape>'
    body, by_table = (
        read(tmp_path, SENSOR, away, light).scene.lights[0].radiance.ravel() for light in lights
    )
    np.testing.assert_allclose(body, by_table, rtol=1e-4)
    assert 5e3 < body[0] < 2e4
    with pytest.raises(InputError, match=r"radiance is a spectrum \(type 'd65'\), which is not"):
        read(tmp_path, SENSOR, away, lights[0].replace("blackbody", "d65"))
    with pytest.raises(InputError, match="needs a temperature above 0 K"):
        read(tmp_path, SENSOR, away, lights[0].replace("5000", "0"))


@pytest.mark.parametrize(
    ("part", "said"),
    [
        (
            '<shape type="sphere"><float name="radius" value="1"/>'
            '<float name="radius" value="3"/></shape>',
            "'radius' stands twice",
        ),
        ('<shape type="sphere"><float name="radius" value="1" unit="cm"/></shape>', "unit"),
        ('<shape type="sphere"><float name="radius" value="1">3</float></shape>', "the text '3'"),
        (
            '<shape type="sphere"><transform name="to_world"><translate X="3"/></transform>'
            "</shape>",
            "the attribute X is not read",
        ),
        (
            '<shape type="sphere"><transform name="to_world"><scale value="2" x="3"/></transform>'
            "</shape>",
            "a value beside x, y or z",
        ),
        (
            '<emitter type="point"><point name="position" x="1"/>'
            '<transform name="to_world"><translate x="9"/></transform></emitter>',
            "a position and a to_world",
        ),
    ],
)
def test_unread_mitsuba_content_is_refused(tmp_path, part, said):
    """Earlier versions used one of two values, and ignored an attribute of another name."""
    with pytest.raises(InputError, match=said):
        read(tmp_path, SENSOR, BALL, part)
