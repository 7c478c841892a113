"""Tests scenes, lenses and cameras as others write them: impossible ones are refused, and light
that a picture lacks is named."""

import warnings
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv
from jaxvision.brdf.half_difference import bin_angles
from jaxvision.errors import InputError
from jaxvision.files.toml import read_toml
from jaxvision.rendering.scene_checks import idle_lamps
from jaxvision.transport import Paths, light_traced, missing_light, path_traced, ray_traced

DOWN = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
GREY = jv.Lambert([0.5 / np.pi])
FLOOR = jv.Surface(jv.Quad([-2.0, -2, 0], [4.0, 0, 0], [0.0, 4, 0]), GREY)
PANE = jv.Surface(jv.Box([0.0, 0, 0.6], [2.0, 2, 0.05]), jv.Glass(1.5))
LAMP = jv.PointLight([0.0, 0, 2], [4.0])
PANEL = jv.RectangleLight([-0.25, -0.25, 2], [0.0, 0.5, 0], [0.5, 0.0, 0], [4 / 0.25])
BELOW = jv.Orthographic([0.0, 0, 0.45], DOWN, 0.01, resolution=(9, 9))
BEHIND_GLASS = jv.Scene([FLOOR, PANE], [LAMP])
# At the centre below the pane: one face transmits 0.96, the pane (1 - R) / (1 + R) summed over all
# orders, and the lamp seems nearer by t (1 - 1 / n).
THROUGH = 0.5 / np.pi * 4 / (2 - 0.1 * (1 - 1 / 1.5)) ** 2 * (0.96 / 1.04)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["direct", "rays", "path"])
def test_light_of_a_point_behind_a_window_is_named(integrator):
    said = " ".join(missing_light(BEHIND_GLASS, integrator=integrator, view=BELOW))
    assert "lights[0]" in said
    assert "surfaces[1]" in said
    assert "integrator = 'light'" in said
    assert max(len(sentence.split()) for sentence in said.split(". ")) <= 30


@pytest.mark.slow
def test_integrators_that_find_all_light_report_nothing():
    assert missing_light(BEHIND_GLASS, integrator="light", depth=6, view=BELOW) == []
    area = replace(BEHIND_GLASS, lights=(PANEL,))
    assert missing_light(area, integrator="path", depth=6, view=BELOW) == []
    for integrator in ("direct", "rays", "path", "light", "radiosity"):
        assert missing_light(jv.Scene([FLOOR], [LAMP]), integrator=integrator) == []


@pytest.mark.slow
def test_the_camera_behind_glass_is_black_by_light_tracing():
    above = jv.Orthographic([0.0, 0, 1.5], DOWN, 0.01, resolution=(9, 9))
    (said,) = missing_light(BEHIND_GLASS, integrator="light", depth=6, view=above)
    assert "sees in or through surfaces[1]" in said


@pytest.mark.slow
def test_the_sentences_agree_with_pictures():
    """Pictures said to lack light are black, and the others have the closed form's value."""
    key = jax.random.key(0)
    wide = replace(BELOW, pixel_pitch=jnp.asarray(0.03))
    found = light_traced(key, BEHIND_GLASS, wide, paths=400_000, depth=6).radiance.mean()
    assert abs(found / THROUGH - 1) < 0.1
    for picture in (
        jv.render(BEHIND_GLASS, BELOW),
        ray_traced(BEHIND_GLASS, BELOW, rays=8),
        path_traced(key, BEHIND_GLASS, BELOW, method=Paths(16, 6)).radiance,
    ):
        assert float(picture.mean()) < 0.02 * THROUGH
    area = replace(BEHIND_GLASS, lights=(PANEL,))
    by_path = path_traced(key, area, wide, method=Paths(1024, 6)).radiance.mean()
    assert abs(by_path / THROUGH - 1) < 0.1


@pytest.mark.slow
def test_glass_that_needs_more_segments_than_depth_is_named():
    area = replace(BEHIND_GLASS, lights=(PANEL,))
    assert any(
        "depth = 3" in s and "to 4" in s
        for s in missing_light(area, integrator="path", depth=3, view=BELOW)
    )
    assert missing_light(area, integrator="path", depth=4, view=BELOW) == []
    panes = [
        jv.Surface(jv.Box([0.0, 0, z], [2.0, 2, 0.05]), jv.Glass(1.5)) for z in (0.6, 0.8, 1.0)
    ]
    three = jv.Scene([FLOOR, *panes], [PANEL])
    above = jv.Orthographic([0.0, 0, 1.5], DOWN, 0.01, resolution=(9, 9))
    (said,) = missing_light(three, integrator="path", depth=8, view=above)
    assert "up to 14 pieces" in said  # 6 faces twice, the floor and the lamp


def test_lamps_that_paths_through_glass_rarely_hit_are_named():
    chip = jv.RectangleLight([-0.005, -0.005, 2], [0.0, 0.01, 0], [0.01, 0.0, 0], [4e4])
    (said,) = missing_light(jv.Scene([FLOOR, PANE], [chip]), integrator="path")
    assert "one path in 125,664" in said  # pi 2^2 / 1e-4
    sky = np.full((64, 128, 1), 1e-3)
    sky[10, 20] = 1e4  # a sun in one pixel of a night sky
    (said,) = missing_light(jv.Scene([FLOOR, PANE], [jv.environment_map(sky)]), integrator="path")
    assert "lights[0]" in said
    even = jv.environment_map(np.ones((8, 16, 1)))
    assert missing_light(jv.Scene([FLOOR, PANE], [even]), integrator="path") == []


@pytest.mark.slow
def test_the_share_of_pixels_with_rare_light_is_reported():
    """The caustic under a pane is from a small lamp that at most one path in 31,416 hits."""
    chip = jv.RectangleLight([-0.01, -0.01, 2], [0.0, 0.02, 0], [0.02, 0.0, 0], [4e4])
    scene = jv.Scene([FLOOR, PANE], [chip])
    (said,) = missing_light(scene, integrator="path", samples=256)
    given = float(said.split("at most ")[2].split()[0])
    assert given == pytest.approx(256 / 31416, rel=0.02)
    wide = replace(BELOW, pixel_pitch=jnp.asarray(0.005), resolution=(100, 100))
    found = path_traced(jax.random.key(0), scene, wide, method=Paths(samples=256, depth=4))
    met = float((found.radiance[..., 0] > 0).mean())
    assert 0.4 * given < met < 1.1 * given  # the pane transmits 0.92, at an angle less
    assert (np.asarray(found.error[..., 0])[np.asarray(found.radiance[..., 0]) == 0] == 0).all()


def _sky_with_sun(rows, sun):
    sky = np.full((rows, 2 * rows, 1), 0.01)
    sky[rows // 8, rows // 3] = sun
    return jv.environment_map(sky)


@pytest.mark.parametrize(
    ("rows", "own"), [(128, None), (32, None), (128, jv.Quadrature(16))], ids=str
)
@pytest.mark.sweep("order=16")
def test_a_sun_between_the_directions_of_a_quadrature_is_named(rows, own):
    """The reference is the sum over the map's own pixels. The printed number is the picture's."""
    sun = 4e4
    scene = jv.Scene([FLOOR], [_sky_with_sun(rows, sun)], rules=(own,))
    (said,) = missing_light(scene, integrator="direct")
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)
    middle = np.cos(np.pi * (rows // 8 + 0.5) / rows)
    true = sun * (edges[rows // 8] - edges[rows // 8 + 1]) * np.pi / rows * middle
    given = float(said.split("irradiance is ")[1].split()[0])
    if "(0.00, 0.00, 1.00)" in said:
        assert abs(given / true - 1) < 0.02
    else:  # it faces the sun
        assert abs(given * middle / true - 1) < 0.02
    assert "lights[0]" in said
    assert "'balanced'" in said
    assert "'balanced'" not in missing_light(scene, integrator="rays")[0]
    key = jax.random.key(0)
    assert (
        missing_light(replace(scene, rules=None), integrator="direct", rule=jv.MonteCarlo(key, 8))
        == []
    )
    assert missing_light(scene, integrator="path") == []


def sky_with_a_sun(rows: int) -> tuple[jv.EnvironmentMap, float]:
    """Return a sky that is black except for one pixel, and the radiance of the floor below it in
    closed form: radiance times solid angle times the cosine to the zenith."""
    row, columns = rows // 6, 2 * rows
    radiance = np.zeros((rows, columns, 1))
    radiance[row, 7] = 1e5
    edges = np.cos(np.pi * np.array([row, row + 1]) / rows)
    within = -np.diff(edges**2)[0] / 2 * (2 * np.pi / columns)  # of cos(theta) over the pixel
    return jv.environment_map(radiance), 1e5 * within * 0.5 / np.pi


@pytest.mark.slow
@pytest.mark.parametrize("rows", [64, 200])
@pytest.mark.parametrize("name", ["render", "ray_traced", "outgoing_radiance"])
def test_pictures_warn_of_a_sun_that_their_quadrature_misses(name, rows):
    """With a quadrature the picture is black or far too bright. The advised setting is right."""
    sky, true = sky_with_a_sun(rows)
    scene, up = jv.Scene([FLOOR], [sky]), jnp.array([0.0, 0.0, 1.0])
    calls = {
        "render": lambda: jv.render(scene, BELOW)[4, 4],
        "ray_traced": lambda: ray_traced(scene, BELOW)[4, 4],
        "outgoing_radiance": lambda: jv.outgoing_radiance(GREY, [sky], jnp.zeros(3), up, up),
    }
    with pytest.warns(
        UserWarning, match=r"light of lights\[0\].* such as a sun\. .*SunDisc"
    ) as said:
        found = float(calls[name]()[0])
    assert len(said) == 1
    assert abs(found / true - 1) > 0.5
    rule = jv.Balanced(jax.random.key(0), 256)
    cured = jv.outgoing_radiance(GREY, [sky], jnp.zeros(3), up, up, rule=rule)
    assert float(cured[0]) == pytest.approx(true, rel=0.1)


@pytest.mark.slow
def test_pictures_of_smooth_skies_cause_no_warning():
    clear = jv.lights.daylight(12, [0.3, 0.2, 0.8], irradiance=[1.0])
    for sky in (jv.environment_map(np.ones((4, 8, 1))), clear):
        picture = jv.render(jv.Scene([FLOOR], [sky]), BELOW)
        assert float(picture[4, 4, 0]) > 0


@pytest.mark.slow
def test_skies_that_a_quadrature_integrates_are_not_named():
    height = np.cos(np.pi * (np.arange(64) + 0.5) / 64)[:, None, None]
    cloudy = np.where(height > 0, (1 + 2 * height) / 3, 0.1) * np.ones((1, 128, 1))
    even = np.ones((4, 8, 1))
    for sky in (cloudy, even, 0 * even):
        for integrator in ("direct", "rays", "radiosity"):
            scene = jv.Scene([FLOOR], [jv.environment_map(sky)])
            assert missing_light(scene, integrator=integrator) == []


def _glossy(alpha, **kwargs):
    return replace(FLOOR, material=jv.TorranceSparrow([0.0], [1.0], alpha, **kwargs))


# The comments give the error that `Quadrature` states for a lamp as wide as its distance.
@pytest.mark.parametrize(
    ("material", "order", "said"),
    [
        (jv.TorranceSparrow([0.0], [1.0], 0.01), 8, True),
        (jv.TorranceSparrow([0.0], [1.0], [0.3, 0.01]), 8, True),
        (jv.TorranceSparrow([0.0], [1.0], 0.05), 8, True),  # -16 %
        (jv.TorranceSparrow([0.0], [1.0], 0.02), 16, True),  # -27 %
        (jv.PhongBRDF([0.1], [1.0], 1000.0), 8, True),  # 120 %
        (jv.GaussianLobeBRDF([0.1], [1.0], 22.0), 8, True),  # like the previous one
        (jv.TorranceSparrow([0.0], [1.0], 0.1), 8, False),  # -0.9 %
        (jv.TorranceSparrow([0.0], [1.0], 0.05), 16, False),  # -0.8 %
        (jv.TorranceSparrow([0.0], [1.0], 0.02), 32, False),  # -3 %
        (jv.PhongBRDF([0.1], [1.0], 1000.0), 24, False),  # 0.5 %
        (jv.PhongBRDF([0.1], [1.0], 200.0), 8, False),
        (jv.BlinnBRDF([0.1], [1.0], 200.0), 8, False),
        (jv.TorranceSparrow([0.1], [0.0], 0.01), 8, False),  # no gloss
    ],
)
def test_a_lobe_between_the_samples_of_a_lamp_is_named(material, order, said):
    lamp = jv.RectangleLight([-1.0, -1, 2], [0.0, 2, 0], [2.0, 0, 0], [5.0])
    scene = jv.Scene([replace(FLOOR, material=material)], [lamp])
    found = missing_light(scene, integrator="direct", rule=jv.Quadrature(order))
    assert [s[:7] for s in found] == ["Narrow:"] * said
    key = jax.random.key(0)
    assert missing_light(scene, integrator="direct", rule=jv.Balanced(key, 8)) == []
    assert missing_light(scene, integrator="path") == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("alpha", "height", "said"), [(0.02, 100.0, 1), (0.3, 1.0, 0), (0.02, 0.5, 0), (0.02, 0.0, 0)]
)
def test_the_gloss_of_a_measured_table_between_the_samples_of_a_lamp_is_named(alpha, height, said):
    """The facets have Beckmann's slopes, in bins of half angles, on a body of albedo 0.3."""
    half = np.asarray(bin_angles(jv.HalfDifferenceTable(jnp.zeros((90, 4, 4, 1))))[0])
    values = 0.1 + height * np.exp(-((np.tan(half) / alpha) ** 2))
    table = jv.HalfDifferenceTable(np.broadcast_to(values[:, None, None, None], (90, 4, 4, 1)))
    lamp = jv.RectangleLight([-1.0, -1, 2], [0.0, 2, 0], [2.0, 0, 0], [5.0])
    scene = jv.Scene([replace(FLOOR, material=table)], [lamp])
    found = missing_light(scene, integrator="direct", rule=jv.Quadrature(8))
    assert [s[:7] for s in found] == ["Narrow:"] * said
    view = jv.Orthographic([0.0, 0, 1.5], DOWN, 0.01, resolution=(1, 1))
    coarse = jv.render(scene, view, rule=jv.Quadrature(8))
    fine = jv.render(scene, view, rule=jv.Quadrature(96))
    assert (abs(float((coarse / fine).mean()) - 1) > 0.1) == bool(said)


def test_a_lobe_between_the_directions_of_a_sky_is_named():
    even = jv.environment_map(np.ones((8, 16, 1)))
    for alpha, count in ((0.03, 1), (0.1, 0)):  # -57 %, +4.6 %
        found = missing_light(jv.Scene([_glossy(alpha)], [even]), integrator="direct")
        assert len(found) == count


def test_light_from_a_nearly_smooth_wall_is_rare_for_paths():
    sun = jv.DirectionalLight([1.0, 0, 1], [1.0])
    for alpha, words in ((1e-3, "one path in 250,000"), (0.1, "")):
        wall = replace(_glossy(alpha), shape=jv.Quad([-2.0, -2, 0], [0.0, 4, 0], [0.0, 0, 4]))
        found = missing_light(jv.Scene([FLOOR, wall], [sun]), integrator="path")
        assert len(found) == bool(words)
        assert words in "".join(found)
        assert missing_light(jv.Scene([wall], [sun]), integrator="path") == []


def test_an_open_glass_mesh_is_named():
    corners = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, 2]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    said = []
    for some in (faces, faces[:3]):
        glass = jv.Surface(jv.TriangleMesh(corners, some), jv.Glass(1.5))
        said.append(missing_light(jv.Scene([FLOOR, glass], [PANEL]), integrator="path"))
    assert said[0] == []
    assert "not closed, 3 of its edges" in said[1][0]


def test_lamps_that_light_nothing_are_named():
    away = jv.RectangleLight([-0.25, -0.25, 2], [0.5, 0.0, 0], [0.0, 0.5, 0], [16.0])  # faces up
    under = jv.PointLight([0.0, 0, -1], [4.0])
    below = jv.DirectionalLight([0.0, 0, -1], [4.0])
    dark = jv.PointLight([0.0, 0, 2], [0.0])
    said = idle_lamps(jv.Scene([FLOOR], [LAMP, away, PANEL, under, below, dark]))
    assert [s[:9] for s in said] == [f"lights[{i}]" for i in (1, 3, 4, 5)]
    both = replace(FLOOR, two_sided=True)
    assert [s[:9] for s in idle_lamps(jv.Scene([both], [away, under, below]))] == ["lights[0]"]


@pytest.mark.slow
def test_ambient_light_that_is_left_out_is_named():
    sky = jv.AmbientLight([2.0])
    bare, paint = (replace(FLOOR, material=jv.Lambert([0.1], ambient=k)) for k in (None, [0.5]))
    lit, idle, dark = (
        jv.Scene([floor], [LAMP], ambient=light)
        for floor, light in ((paint, sky), (bare, sky), (paint, jv.AmbientLight([0.0])))
    )
    down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    view = jv.Orthographic([0.1, 0.1, 1], down, 0.1, resolution=(1, 1))
    without = jv.Scene([paint], [LAMP])
    gains = [float((jv.render(s, view) - jv.render(without, view)).sum()) for s in (lit, idle)]
    np.testing.assert_allclose(gains, [0.5 * 2, 0], rtol=1e-5)
    traced = [jv.ray_traced(s, view) for s in (lit, without)]
    np.testing.assert_array_equal(*traced)
    assert missing_light(lit, integrator="direct") == idle_lamps(lit) == []
    for integrator in ("rays", "path", "light", "radiosity"):
        said = missing_light(lit, integrator=integrator)
        assert len(said) == 1
        assert said[0].startswith("Missing: the light of ambient.")
        assert missing_light(idle, integrator=integrator) == []
    assert idle_lamps(idle)[0].startswith("ambient: lights no surface, as no material")
    assert idle_lamps(dark) == ["ambient: has no power."]


REFUSED = {
    "degrees for alpha": (lambda: jv.TorranceSparrow([0.0], [1.0], 30.0), "alpha, at most 3"),
    "per cent for a share": (lambda: jv.Sensor(prnu=1.0), "1 % being 0.01"),
    "two equal points": (lambda: jv.look_at(np.ones(3), np.ones(3), [0, 0, 1.0]), "one point"),
    "up along the sight": (lambda: jv.look_at([0, 0, 1.0], [0, 0, 0], [0, 0, 2.0]), "up must be"),
    "mm for m": (lambda: jv.image_distance(2.0, 50.0), r"in m \(50 mm are 0.05\)"),
    "mm for m in blur": (lambda: jv.circle_of_confusion(3.0, 2.0, 50.0, 2.0), "in m"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_impossible_records_are_refused(case):
    call, words = REFUSED[case]
    with pytest.raises(ValueError, match=words):
        call()


def test_an_undefined_view_direction_is_nan_if_traced():
    look, place, up = jax.jit(jv.look_at), np.ones(3), np.array([0.0, 0, 1])
    for nowhere in (look(place, place, up), look(place, place + up, up), look(place, up, 0 * up)):
        assert np.isnan(nowhere).all()
    found = look(place, 0 * place, 1e-3 * up)
    assert np.allclose(found @ found.T, np.eye(3), atol=1e-6)
    assert np.allclose(found[2], -1 / np.sqrt(3), atol=1e-6)
    slope = jax.grad(lambda x: look(x, 0 * x, up)[2, 0])(place)
    assert np.allclose(slope, np.array([-2.0, 1, 1]) / 3**1.5, atol=1e-6)


def test_unusual_but_possible_records_are_accepted():
    assert jv.TorranceSparrow([0.0], [1.0], 1.5).roughness == 1.5
    assert float(jv.Sensor(prnu=0.3).prnu) == pytest.approx(0.3)
    assert float(jv.image_distance(jnp.inf, 57.6)) == pytest.approx(57.6)  # a telescope
    assert float(jv.image_distance(0.03, 0.05)) == pytest.approx(-0.075)  # a magnifier


def test_a_scene_file_takes_the_matrix_of_a_calibration(tmp_path):
    """A point on the optical axis is seen at (cx, cy)."""
    (tmp_path / "scene.toml").write_text(
        """
[camera]
kind = "pinhole"
position = [0, -4, 0]
target = [0, 0, 0]
resolution = [48, 64]
matrix = [[80, 0, 20.5], [0, 84, 30.25], [0, 0, 1]]
distortion = [-0.1, 0.01, 0, 0, 0]

[material.grey]
family = "lambert"
albedo = [0.5]

[[surface]]
shape = "sphere"
centre = [0, 0, 0]
radius = 1
material = "grey"

[[light]]
kind = "point"
position = [1, -2, 3]
intensity = [10]
"""
    )
    view = jv.files.scenes.read_scene(tmp_path / "scene.toml").view
    folded = (tmp_path / "scene.toml").read_text().replace("[-0.1, 0.01, 0,", "[-1.5, 0, 0,")
    (tmp_path / "folded.toml").write_text(folded)
    with pytest.warns(UserWarning, match="lie beyond the fold of the distortion, where no light"):
        jv.files.scenes.read_scene(tmp_path / "folded.toml")
    seen = jv.project(view, jnp.zeros(3, view.position.dtype))
    assert float(seen.column) == pytest.approx(20.5, abs=1e-4)
    assert float(seen.row) == pytest.approx(30.25, abs=1e-4)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("exposure = 0.5 ms", "has a unit, ms; give the number alone"),
        ("width = 50mm  # across", "has a unit, mm"),
        ("share = 5 %", "has a unit, %"),
        ("name = scene", "not a TOML file"),
    ],
)
def test_a_number_with_a_unit_is_refused_as_such(tmp_path, line, words):
    file = tmp_path / "scene.toml"
    file.write_text(f"[camera]\n{line}\n")
    with pytest.raises(InputError, match=words):
        read_toml(file, "scene")


def test_a_field_of_view_of_180_degrees_is_not_said_to_be_allowed(tmp_path):
    text = '[camera]\nkind = "pinhole"\nposition = [0, 0, 1]\ntarget = [0, 0, 0]\n'
    text += "field_of_view = 180.0\nresolution = [2, 2]\nup = [0, 1, 0]\n"
    text += '[[surface]]\nshape = "sphere"\ncentre = [0, 0, 0]\nradius = 0.5\nemission = [1]\n'
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(InputError, match=r"field_of_view must be .* below 180, got 180\.0"):
        jv.files.scenes.read_scene(tmp_path / "scene.toml")


def test_entries_of_lists_are_numbered_from_one(tmp_path):
    """light[1] is the first light, and its direction has two numbers instead of three."""
    text = '[camera]\nkind = "orthographic"\nposition = [0, 0, 1]\ntarget = [0, 0, 0]\nwidth = 1\n'
    text += 'resolution = [2, 2]\n[[surface]]\nshape = "sphere"\ncentre = [0, 0, 0]\nradius = 1\n'
    text += "emission = [1]\n"
    text += '[[light]]\nkind = "directional"\ndirection = [0, 1]\nirradiance = [1]\n'
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(
        InputError, match=r"light\[1\]\.direction must have shape \(3,\), got \(2,\)"
    ):
        jv.files.scenes.read_scene(tmp_path / "scene.toml")


EAST = np.array([452300.0, 5411827.0, 430.0])  # m, in a surveyor's coordinates


def roof(file, at):
    """Write twelve facets of 4 m by 2.3 m, alternately 0.6 m up and down, as an OBJ."""
    lines = []
    for i in range(12):
        y, z, w = 2.3 * i, 0.6 * (i % 2), 0.6 * ((i + 1) % 2)
        for corner in ((0, y, z), (4, y, z), (4, y + 2.3, w), (0, y + 2.3, w)):
            lines.append("v {:.3f} {:.3f} {:.3f}".format(*(at + corner)))
        lines.append("f {} {} {} {}".format(*range(4 * i + 1, 4 * i + 5)))
    file.write_text("\n".join(lines) + "\n")
    return file


def slopes(mesh):
    a, b, c = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    return np.arctan2(np.hypot(normals[:, 0], normals[:, 1]), np.abs(normals[:, 2]))


def test_rounding_of_a_mesh_in_surveyors_coordinates_is_named(tmp_path):
    file, slope = roof(tmp_path / "utm.obj", EAST), np.arctan2(0.6, 2.3)
    with pytest.warns(UserWarning, match=r"5.41e\+06 m .* float32 moves .* by up to 0.2 m .* near"):
        coarse = jv.files.meshes.read_mesh(file, dtype="float32")
    assert np.abs(slopes(coarse) - slope).max() > 0.01
    assert "numbers of float32 are 0.5 m apart" in jv.geometry.problems(coarse)[0]
    for given in ({"dtype": "float64"}, {"dtype": "float32", "position": -EAST}):
        mesh = jv.files.meshes.read_mesh(file, **given)  # no warning
        np.testing.assert_allclose(slopes(mesh), slope, rtol=1e-3)
        assert jv.geometry.problems(mesh) == []


def test_triangles_flattened_by_rounding_are_distinguished_from_those_of_the_file(tmp_path):
    text = "".join(f"v {EAST[0]} {EAST[1] + y} {x}\n" for x, y in ((0, 0), (1, 0), (0, 0.2)))
    text += f"v {EAST[0]} {EAST[1] + 5} 0\nf 1 2 3\nf 1 2 4\nf 1 1 2\n"
    (tmp_path / "m.obj").write_text(text)
    with (
        pytest.warns(UserWarning, match="areas and slopes"),
        pytest.warns(
            UserWarning, match=r"2 of 3 triangles have no area \(1 of them in float32 alone\)"
        ),
    ):
        jv.files.meshes.read_mesh(tmp_path / "m.obj", dtype="float32")


@pytest.mark.parametrize("at", [0.0, 1e5])
def test_a_scene_far_from_the_origin_is_named(tmp_path, at):
    """At 1e5 m numbers in float32 are 8 mm apart, and the picture of a 1 m ball is wrong."""
    (tmp_path / "s.toml").write_text(f"""
[camera]
kind = "pinhole"
position = [{at}, {at - 4}, {at}]
target = [{at}, {at}, {at}]
resolution = [4, 4]
field_of_view = 50
[material.grey]
family = "lambert"
albedo = 0.5
[[surface]]
name = "ball"
shape = "sphere"
centre = [{at}, {at}, {at}]
radius = 1
material = "grey"
[[light]]
kind = "directional"
direction = [0, -1, 1]
irradiance = 1.0
""")
    read = jv.files.scenes.read_scene
    if not at:
        read(tmp_path / "s.toml")
        return
    with pytest.warns(UserWarning, match=r'"ball": Sphere lies .* 0.0078 m apart'):
        read(tmp_path / "s.toml")


DOWN_ON_FLOOR = jv.Orthographic([0.1, 0.1, 1.0], DOWN, 0.1, resolution=(1, 1))


@pytest.mark.parametrize(
    ("material", "reflected"),
    [
        (jv.Lambert([1.5 / np.pi]), 1.5),
        (jv.Mirror([1.25]), 1.25),
        # pi k_d + 2 pi k_s / (n + 2)
        (jv.PhongBRDF([0.5 / np.pi], [22 / np.pi], 20.0), 2.5),
        (jv.NormalisedPhong([0.5 / np.pi], [1.0], 20.0), 1.5),
        (jv.NormalisedPhong([0.4 / np.pi], [0.5], 20.0), 0.9),
        (jv.Lambert([1 / np.pi]), 1.0),
        (jv.OrenNayar([1 / np.pi], 0.5), 1.0),
        (jv.TorranceSparrow([0.2 / np.pi], [1.0], 1.0), 0.8),
        (jv.TorranceSparrow([0.95 / np.pi], [1.0], 0.2, interface=jv.Dielectric([1.5])), 0.99),
        (jv.Glass(1.5), 0.04),
    ],
    ids=lambda x: type(x).__name__,
)
@pytest.mark.sweep
def test_a_surface_that_reflects_more_than_it_receives_is_named(material, reflected):
    scene = jv.Scene([replace(FLOOR, material=material)], [LAMP])
    method = Paths(1, 2)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        path_traced(jax.random.key(0), scene, DOWN_ON_FLOOR, method=method)
        jax.jit(lambda s: jv.render(s, DOWN_ON_FLOOR))(scene)
    assert [one.filename for one in said] == [__file__] * (reflected > 1)
    for one in said:
        given = str(one.message).split("reflects ")[1].split()[0]
        assert float(given) == pytest.approx(reflected, rel=1e-3)


@pytest.mark.slow
def test_no_radiosity_is_solved_for_albedos_above_1():
    table, sent = jnp.array([[0.0, 1], [1, 0]]), jnp.ones((2, 1))
    for solve in (
        jv.transport.radiosity.solve_radiosity,
        jv.transport.radiosity.shoot,
        partial(jv.transport.radiosity.bounce, count=3),
    ):
        solve(table, jnp.full((2, 1), 0.5), sent)
        with pytest.raises(ValueError, match=r"albedo must be finite, at least 0 and at most 1"):
            solve(table, jnp.full((2, 1), 1.5), sent)
    plan = jv.transport.radiosity.plan_patches(jv.Scene([FLOOR], [LAMP]), size=4.0)
    bright = jv.Scene([replace(FLOOR, material=jv.Lambert([1.0]))], [LAMP])
    with pytest.warns(UserWarning, match=r"surfaces\[0\] reflects 3.142 times the light"):
        jv.transport.radiosity.radiosity(bright, plan)


@pytest.mark.slow
def test_known_scenes_are_checked_inside_a_trace():
    shapes = [
        jv.Box([0, 0, 0], [1, 1, 1]),
        jv.Sphere([3, 0, 0], 1),
        jv.Disc([6, 0, 0], [0, 0, 1], 1),
    ]
    shapes += [jv.Disc([6, 0, 0], [0, 0, 1], 1), jv.Quad([9, 0, 0], [1, 0, 0], [0, 1, 0])]
    for material, warned in ((GREY, 0), (jv.Phong([0.2], [0.9], 20.0), 0), (jv.Lambert([0.5]), 1)):
        scene = jv.Scene([jv.Surface(shape, material) for shape in shapes], [LAMP])

        @jax.jit
        def seen(key, scene=scene):
            ray = jv.Ray([0.0, 0, 4], [0.0, 0, -1])
            return jv.path_radiance(key, scene, ray, method=Paths(1, 2)).radiance

        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            assert np.isfinite(seen(jax.random.key(0))).all()
        assert sum("times the light that it receives" in str(one.message) for one in said) == warned


def test_records_of_known_numbers_are_checked_inside_a_trace():
    coat = jv.Coated(GREY, jv.Dielectric([1.5]), 0.1)
    full, basis, warm = jnp.array([0, np.pi, 2 * np.pi]), jnp.ones((3, 3)), jnp.asarray(5000.0)
    for make in (
        lambda: jv.Coated(coat.body, coat.interface, coat.roughness).roughness,
        lambda: jv.GoniometricLight([0, 0, 2], [8.0], jnp.ones((2, 3)), [0, 1.0], full).position,
        lambda: jv.spectra.daylight(basis, warm),
    ):
        np.testing.assert_array_equal(jax.jit(make)(), make())


@pytest.mark.slow
def test_shapes_far_from_the_origin_are_named_in_python():
    east = np.array([1e5, 1e5, 0])
    view = replace(BELOW, position=jnp.asarray(BELOW.position + east, jnp.float32))
    ball = jv.as_dtype(jv.Sphere(east, 1.0), "float32")
    scene = jv.as_dtype(jv.Scene([jv.Surface(ball, GREY)], [LAMP]), "float32")
    view = jv.as_dtype(view, "float32")
    ray = jv.as_dtype(jv.Ray(east + np.array([0, 0, 5]), [0.0, 0, -1]), "float32")
    words = r"Sphere lies up to 1e\+05 m from the origin, .* float32 are 0.0078 m apart"
    for call in (
        lambda: jv.intersect(ray, ball),
        lambda: jv.render(scene, view),
        lambda: ray_traced(scene, view),
        lambda: path_traced(jax.random.key(0), scene, view, method=Paths(1, 2)),
        lambda: light_traced(jax.random.key(0), scene, view, paths=4, depth=2),
    ):
        with pytest.warns(UserWarning, match=words) as said:
            call()
        assert [one.filename for one in said] == [__file__]


def test_no_sensor_is_in_focus_at_a_virtual_image():
    for call in (
        lambda z, f: jv.depth_of_field(z, f, 8.0, 30e-6),
        lambda z, f: jv.circle_of_confusion(3.0, z, f, 8.0),
        lambda z, f: jv.optics.working_f_number(8.0, z, f),
    ):
        for z, f in ((0.03, 0.05), (0.0, 0.05), ([1.0, 0.03], 0.05)):
            with pytest.raises(ValueError, match=r"virtual image behind a focal length of 0\.05 m"):
                call(z, f)
        call(0.051, 0.05), call(np.inf, 0.05), jax.jit(call)(0.03, 0.05)
    with pytest.raises(ValueError, match=r"virtual image behind a focal length of -0\.05 m"):
        jv.circle_of_confusion(3.0, 1.0, -0.05, 8.0)
    assert float(jv.image_distance(0.03, 0.05)) == pytest.approx(-0.075)


def test_an_impossible_f_number_is_named():
    """By conservation of energy, no sensor gets more than pi times a uniform radiance. Focused at
    infinity, f/0.5 gives that (E = pi L / 4 N^2 on the axis)."""

    def on_axis(f_number):
        lens = jv.ThinLens([0, 0, 0], np.eye(3), 0.05, 1e-5, resolution=(1, 1), f_number=f_number)
        return float(jv.sensor_irradiance(lens, np.ones((1, 1, 1)))[0, 0, 0])

    assert on_axis(0.5) == pytest.approx(np.pi)
    with pytest.warns(UserWarning, match=r"at most f/0\.5, .* at f/0\.3 the sensor may get more"):
        assert on_axis(0.3) > np.pi


def test_a_record_that_is_missing_is_named():
    """A lamp needs a material that reflects nothing, because None is not a material."""
    lamp = jv.Sphere([0, 0, 0], 1.0)
    with pytest.raises(ValueError, match=r"Surface\.material must be .*Material, got None"):
        jv.Surface(lamp, None, emission=[1.0])
    with pytest.raises(ValueError, match=r"Surface\.shape must be .*Sphere.*, got None"):
        jv.Surface(None, GREY)


@pytest.mark.slow
def test_a_diffraction_kernel_that_cuts_its_rings_is_named():
    """At f/64 on pixels of 1 um the first dark ring has a radius of 43 pixels, and the default
    kernel of 16. The centre pixel gets pi / (2 lambda N)^2 of a point's light."""
    lens = jv.ThinLens([0, 0, 0], np.eye(3), 0.05, 1e-6, resolution=(1, 1), f_number=64.0)
    true = np.pi / (2 * 550e-9 * 64) ** 2 * 1e-12
    pitch = jnp.asarray(1e-6)
    with pytest.warns(
        UserWarning, match=r"first dark ring, .* 42\.9 pixels, .* size = 173"
    ) as said:
        small = jv.optics.lens_kernel(lens, jv.Diffraction(550e-9), pitch)
    assert len(said) == 1
    assert float(small[16, 16]) > 1.5 * true
    wide = jv.optics.lens_kernel(lens, jv.Diffraction(550e-9, size=173), pitch)
    assert float(wide[86, 86]) == pytest.approx(true, rel=0.12)


NEAR = jv.RectangleLight([-0.5, -0.5, 0.01], [0, 1, 0], [1, 0, 0], [1 / np.pi])
UNDER_IT = {
    "plane": jv.Plane([0, 0, 0], [0, 0, 1]),
    "quad": jv.Quad([-3, -3, 0], [6, 0, 0], [0, 6, 0]),
    "disc": jv.Disc([0, 0, 0], [0, 0, 1], 0.4),
    "box": jv.Box([0, 0, -1], [1, 1, 1]),
    "ball": jv.Sphere([0, 0, -50], 50.0),
    "mesh": jv.TriangleMesh([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]], [[0, 1, 2]]),
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", UNDER_IT.values(), ids=UNDER_IT)
def test_a_surface_near_a_wide_lamp_is_named(shape):
    """Under an infinite lamp the irradiance is pi L, here 1 W/m^2."""
    scene = jv.Scene([jv.Surface(shape, GREY)], [NEAR])
    (said,) = missing_light(scene, integrator="direct")
    assert "light of lights[0] at 0.01" in said
    assert float(said.split("irradiance is ")[1].split()[0]) == pytest.approx(1, abs=0.1)
    assert missing_light(scene, integrator="direct", rule=jv.Quadrature(32)) == []
    assert missing_light(scene, integrator="path") == []


def test_lamps_near_surfaces_that_they_hardly_light_are_not_named():
    wall = jv.RectangleLight([-0.5, -0.5, 0], [0, 0, 1], [0, 1, 0], [1.0])  # from the floor up
    lamp = jv.RectangleLight([-0.5, -0.5, 1], [0, 1, 0], [1, 0, 0], [1.0])
    panel = jv.Surface(jv.Quad([-0.5, -0.5, 1], [0, 1, 0], [1, 0, 0]), GREY, two_sided=True)
    ceiling = jv.Surface(jv.Quad([-1, -1, 1.001], [0, 2, 0], [2, 0, 0]), GREY)
    scene = jv.Scene([FLOOR, panel, ceiling], [lamp, wall])
    assert missing_light(scene, integrator="direct") == []


@pytest.mark.slow
def test_pictures_warn_of_a_surface_near_a_wide_lamp():
    view = jv.Orthographic([0, 0, 0.005], DOWN, 0.02, resolution=(3, 3))
    scene = jv.Scene([FLOOR], [NEAR])
    with pytest.warns(UserWarning, match=r"0.01 m from it.* Give rule = Balanced") as said:
        found = float(jv.render(scene, view).mean())
    assert len(said) == 1
    true = 0.5 / np.pi
    assert abs(found / true - 1) > 0.1
    cured = jv.render(scene, view, rule=jv.Balanced(jax.random.key(0), 256))
    assert float(cured.mean()) == pytest.approx(true, rel=0.03)


@pytest.mark.parametrize("by_paths", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_pictures_of_a_camera_at_nan_are_nan(by_paths):
    """A black picture would look like a dark scene, for example to a fit whose step failed."""
    scene = jv.Scene([FLOOR], [LAMP, jv.environment_map(np.ones((2, 4, 1)))])

    @jax.jit
    def radiances(position):
        view = jv.Orthographic(position, DOWN, 0.01, resolution=(1, 2))
        ray, key = jv.camera_ray(view, jnp.array(0.0), jnp.array(0.0)), jax.random.key(0)
        if not by_paths:
            return (jv.radiance_along(scene, ray),)
        method = Paths(samples=2, depth=2)
        return (
            jv.render(scene, view),
            ray_traced(scene, view),
            path_traced(key, scene, view, method=method).radiance,
            jv.path_radiance(key, scene, ray, method=method).radiance,
        )

    assert all((np.asarray(x) > 0).all() for x in radiances(np.array([0.0, 0, 0.5])))
    assert all(np.isnan(x).all() for x in radiances(np.array([np.nan, 0, 0.5])))
