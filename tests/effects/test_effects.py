"""Tests that pruning changes pictures by at most its certified bound: random scenes, each effect
alone, and difficult cases built by hand. The pictures are rendered by an oracle that shares no code
with the library."""

import json
import re
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.direct_light import picture
from oracles.random_scenes import random_scene

import jaxvision as jv
from fitting.inference.records import replaced
from jaxvision import effects
from jaxvision.effects.bounces import Onward, bounce_rows
from jaxvision.effects.cells import eye_of
from jaxvision.effects.radiance import scene_stage
from jaxvision.effects.spectra import band_rows, select_bands
from jaxvision.effects.stages import Draft, Ends
from jaxvision.effects.sums import sums_of

ROUNDING = 1e-12
TOLERANCES = 1e-3, 1e-2, 5e-2

QUICK = (1, 2, 3, 6, 12, 14)  # scenes that the oracle renders quickly
BLOCKS = [range(first, first + 10) for first in range(0, 200, 10)]
MANY = [QUICK, *(pytest.param(seeds, marks=pytest.mark.slow) for seeds in BLOCKS)]

GREY = jv.Lambert([0.25])
FLOOR = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), GREY)
DOWN = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
VIEW = jv.Pinhole([0, 0, 3], DOWN, 0.05, 0.05 / 16, resolution=(16, 16))


def drawn(scene, view, expand=None):
    arrays = jax.tree.map(np.asarray, (scene, view))
    found = picture(*arrays)
    return found if expand is None else found @ expand.T


def promised_and_actual(seed):
    """Return the total of a certificate and the largest error, both relative to the brightest
    pixel."""
    scene, view = random_scene(seed)
    full = drawn(scene, view)
    level = full.max()
    if not level > 0:
        return None
    tolerance = effects.Tolerance(TOLERANCES[seed % 3])
    pruned = effects.prune(scene, view, tolerance, level=level)
    error = np.abs(drawn(pruned.scene, pruned.camera, pruned.expand) - full).max() / level
    return pruned.certificate.total, error


@pytest.mark.parametrize("seeds", MANY)
def test_random_scenes_keep_the_promise(seeds):
    for seed in seeds:
        found = promised_and_actual(seed)
        if found is not None:
            assert found[1] <= found[0] * (1 + 1e-9) + ROUNDING, f"seed {seed}"


@pytest.mark.slow
def test_the_promise_is_within_four_times_the_actual_error():
    found = [promised_and_actual(seed) for seed in range(100)]
    ratios = [p / a for p, a in filter(None, found) if a > ROUNDING]
    assert np.median(ratios) <= 4


@cache
def alone(seed):
    """Return each droppable row of a random scene with its name, its bound and the change of the
    picture."""
    scene, view = random_scene(seed)
    full, ends = drawn(scene, view), (Ends(scene, scene), Ends(view, view))
    rows, _, onward = scene_stage(*ends)
    camera, found = jv.Camera(view, jv.Sensor()), []
    draft = Draft(scene.surfaces, scene.lights, frozenset(), scene.ambient, camera)
    for row in [*rows, *band_rows(onward.sums, direct=True)]:
        if row.drop is None or not row.effect.present:
            continue
        left, expand = only(scene, draft, row), None
        if row.ladder == "bands":
            kept, expand = row.drop(draft).bands
            left = select_bands(scene, kept, len(expand))
        found.append((row, np.abs(drawn(left, view, expand) - full).max(), full.max()))
    return found


def only(scene, draft, row):
    """Return the scene without one effect. For the shadows of a lamp, return only this lamp, and
    all else dark."""
    after = row.drop(draft)
    lights = tuple(light for light in after.lights if light is not None)
    return replace(scene, surfaces=after.surfaces, lights=lights, ambient=after.ambient)


@pytest.mark.parametrize("seeds", MANY)
def test_each_effect_alone_keeps_its_bound(seeds):
    for seed in seeds:
        for row, change, top in alone(seed):
            if row.together != "shadows":
                limit = row.effect.bound * (1 + 1e-9) + ROUNDING * top
                assert change <= limit, f"seed {seed}: {row.effect.name}"


@pytest.mark.parametrize("seeds", MANY)
def test_the_shadows_of_each_lamp_keep_their_bound(seeds):
    """The change is between pictures of one lamp alone, with and without occluders."""
    for seed in seeds:
        scene, view = random_scene(seed)
        rows, _, _ = scene_stage(Ends(scene, scene), Ends(view, view))
        bounds = {row.effect.name: row.effect.bound for row in rows}
        for k, light in enumerate(scene.lights):
            one = replace(scene, lights=(light,), rules=None)
            change = np.abs(drawn(one, view) - drawn(replace(one, occluders=()), view)).max()
            assert change <= bounds[f"shadows[{k}]"] * (1 + 1e-9) + ROUNDING, f"{seed}, {k}"


def test_half_of_a_bound_is_caught():
    """With all bounds halved, the same comparison must fail."""
    broken = [
        row.effect.name for row, change, _ in alone(1) if change > 0.5 * row.effect.bound + ROUNDING
    ]
    assert broken


# ---------------------------------------------------------------- difficult cases, built by hand


def lamp(z, radiance, size=0.4):
    """Return a rectangular lamp over the floor that shines down. It is in front of the camera if z
    < 3."""
    edge = size
    return jv.RectangleLight([-edge / 2, -edge / 2, z], [0, edge, 0], [edge, 0, 0], [radiance])


def bound_of(scene, name, view=VIEW, **options):
    return next(e for e in effects.inspect(scene, view, **options) if e.name == name)


def test_1_a_lamp_that_hides_the_floor_is_not_negligible():
    sun = jv.DirectionalLight([0, 0, 1], [1.0])
    up = jv.RectangleLight([-0.2, -0.2, 1], [0.4, 0, 0], [0, 0.4, 0], [0.0])
    scene = jv.Scene(FLOOR, [up, sun])
    assert bound_of(scene, "lights[0]").bound >= 0.25
    change = drawn(scene, VIEW) - drawn(jv.Scene(FLOOR, sun), VIEW)
    assert np.abs(change).max() == pytest.approx(0.25)


def test_2_and_3_a_dark_lamp_in_view_stays_a_rectangle():
    up = jv.RectangleLight([-0.2, -0.2, 1], [0.4, 0, 0], [0, 0.4, 0], [0.0])
    scene = jv.Scene(FLOOR, [up])
    assert "seen" in bound_of(scene, "lights[0]").why
    extent = bound_of(scene, "lights[0].extent")
    assert extent.bound == np.inf
    assert "seen" in extent.why


def test_7_a_bound_is_never_negative_nor_nan():
    ball = jv.Surface(jv.Sphere([0, 0, 0.5], 0.25), GREY)
    for power, bound in ((0.0, 0.0), (1.0, np.inf)):
        scene = jv.Scene([FLOOR, ball], jv.PointLight([0.25, 0, 0.5], [power]))
        assert all(effect.bound >= 0 for effect in effects.inspect(scene, VIEW))
        assert bound_of(scene, "lights[0]").bound == bound


def test_8_effects_keep_the_names_of_the_first_scene():
    lights = [jv.PointLight([0, 0, z], [1.0]) for z in (900.0, 1.0, 800.0, 2.0)]
    pruned = effects.prune(jv.Scene(FLOOR, lights), VIEW, "1%", level=1.0)
    names = {effect.name for effect in pruned.certificate.dropped if "lights" in effect.name}
    assert names == {"lights[0]", "lights[2]"}
    assert [float(light.position[2]) for light in pruned.scene.lights] == [1.0, 2.0]


def test_effects_are_dropped_in_the_order_of_their_bounds():
    """Lamps of equal cost are dropped in the order of their bounds, until the next no longer
    fits."""
    places = ((2.0, 1.0), (300.0, 1.0), (15.0, 1.0), (900.0, 1.0), (2.0, 0.0), (12.0, 1.0))
    lights = [jv.PointLight([0, 0, z], [power]) for z, power in places]
    gone = effects.prune(jv.Scene(FLOOR, lights), VIEW, "0.2%", level=1.0).certificate.dropped
    found = [effect for effect in gone if effect.name.startswith("lights")]
    assert [effect.name for effect in found] == ["lights[4]", "lights[3]", "lights[1]", "lights[2]"]
    assert [effect.bound for effect in found] == pytest.approx(
        [0, 0.25 / 900**2, 0.25 / 300**2, 0.25 / 15**2]
    )


@pytest.mark.parametrize(("transmission", "left"), [((1.0, 1.0, 1.0), 2), ((0.0, 0.0, 1.0), 3)])
def test_a_filter_replaces_dropped_bands_unless_its_transmission_is_negative(transmission, left):
    """The third band is .8 of the second less .72 of the first."""
    spectra = np.array([[0.1, 0.09, 0.0], [0.0, 0.05, 0.04]])
    halves = [
        jv.Surface(jv.Quad([x, -1, 0], [1, 0, 0], [0, 2, 0]), jv.Lambert(k))
        for x, k in zip((-1, 0), spectra, strict=True)
    ]
    scene = jv.Scene(halves, jv.DirectionalLight([0, 0, 1], [1.0] * 3))
    filters = jv.scene.ColourFilter(np.array([transmission]), pattern=((0,),))
    camera = jv.Camera(replace(VIEW, f_number=4.0), jv.Sensor(colour_filter=filters, gain=1e3))
    pruned = effects.prune(scene, camera, "1e-6DN")
    assert pruned.expand is None
    assert pruned.scene.lights[0].irradiance.shape == (left,)
    kept = [e.why for e in pruned.certificate.kept if e.name == "bands"]
    assert not kept or "cannot take fewer" in kept[0]
    found = np.asarray(pruned.camera.sensor.colour_filter.transmission)
    own = np.stack([np.asarray(s.material.diffuse) for s in pruned.scene.surfaces])
    np.testing.assert_allclose(own @ found[0], spectra @ transmission, rtol=1e-12)


def test_9_pruned_records_are_valid():
    """All spectra lose the same bands, because a scene of mixed bands would be refused."""
    ramp = np.linspace(1, 2, 31)
    surface = jv.Surface(FLOOR.shape, jv.Phong(0.1 * ramp, 0.05 * ramp, 5.0))
    scene = jv.Scene(surface, jv.PointLight([0, 0, 2], 0 * ramp + 1))
    pruned = effects.prune(scene, VIEW, "0.1%", level=1.0)
    material = pruned.scene.surfaces[0].material
    assert (
        material.diffuse.shape == material.specular.shape == pruned.scene.lights[0].intensity.shape
    )


def test_bands_that_no_lamp_shades_stay():
    """Bands that are only emitted cost one number per pixel, as does joining fewer bands."""
    shining = jv.Surface(FLOOR.shape, jv.Lambert([0.2] * 3), [1.0] * 3)
    for lights, fewer in (([], False), ([jv.PointLight([0, 0, 2], [1.0] * 3)], True)):
        left = effects.prune(jv.Scene([shining], lights), VIEW, "0%", level=1.0)
        assert (left.expand is not None) == fewer


def test_11_the_number_of_bands_stays():
    scene = jv.Scene(
        jv.Surface(FLOOR.shape, jv.Mirror([0.5])), jv.PointLight([0, 0, 2], [1e-9, 0, 0])
    )
    pruned = effects.prune(scene, VIEW, "1%", level=1.0)
    assert len(pruned.scene.lights) == 1


def test_13_bounds_are_of_the_integral():
    """At .01 m the bound is pi L, which no quadrature rule exceeds."""
    close = lamp(0.01, 1.0)
    scene = jv.Scene(FLOOR, close)
    assert bound_of(scene, "lights[0]").bound == pytest.approx(0.25 * np.pi)


FAR_OFF = np.array([1e6, -1e6, 1e6])
SUN = jv.PointLight([0, 1e11, 1.5e11], [1e22])


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("floor", "place", "lamp"),
    [
        (jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), np.zeros(3), SUN),
        (
            jv.Quad(FAR_OFF - [1, 1, 0], [2, 0, 0], [0, 2, 0]),
            FAR_OFF,
            jv.PointLight(FAR_OFF + np.array([1, 0, 1]), [1.0]),
        ),
        (
            jv.Quad([-5e6, -5e6, 0], [1e7, 0, 0], [0, 1e7, 0]),
            np.zeros(3),
            jv.PointLight([1, 0, 1], [1.0]),
        ),
    ],
    ids=["a sun at its place", "far from the origin", "a floor of 10,000 km"],
)
def test_distant_objects_hide_no_near_shadow(floor, place, lamp):
    """The ball of 40 cm, whose shadow must be kept, is less than a millionth of the scene."""
    ball = jv.Sphere(place + np.array([0, 0, 0.3]), 0.2)
    scene = jv.Scene([jv.Surface(floor, GREY), jv.Surface(ball, GREY)], [lamp])
    view = replace(VIEW, position=place + np.array([0.3, 0, 3]))
    full, lit = drawn(scene, view), drawn(replace(scene, occluders=()), view)
    assert np.abs(full - lit).max() > 0.1 * full.max()
    assert not effects.prune(scene, view, "0%").certificate.dropped


# ---------------------------------------------------------------- requirements for every effect


def test_every_effect_of_a_full_scene_has_its_row():
    vertices = np.array([[0, 0, 1.0], [0.2, 0, 1], [0, 0.2, 1]])
    mesh = jv.TriangleMesh(vertices, np.array([[0, 1, 2]]), normals=vertices)
    facets = jv.TorranceSparrow([0.1], [0.2], 0.5, interface=jv.Dielectric([1.5]))
    surfaces = [
        jv.Surface(FLOOR.shape, jv.Lambert([0.1], ambient=[0.3]), [0.1]),
        jv.Surface(mesh, facets),
        jv.Surface(jv.Sphere([0, 0, 1], 0.1), jv.OrenNayar([0.1], 0.3)),
        jv.Surface(jv.Sphere([0.5, 0, 1], 0.1), jv.Glass(1.5, absorption=[1.0])),
    ]
    scene = jv.Scene(surfaces, [lamp(4.0, 1.0)], jv.AmbientLight([0.1]))
    names = {effect.name for effect in effects.inspect(scene, VIEW, depth=4)}
    assert names >= {
        "lights[0]",
        "lights[0].extent",
        "shadows[0]",
        "ambient",
        "bounces",
        "surfaces[0].emission",
        "surfaces[1].shape.normals",
        "surfaces[1].material.specular",
        "surfaces[1].material.interface",
        "surfaces[2].material.sigma",
        "surfaces[3].material.absorption",
    }


def test_effects_without_a_bound_give_the_reason():
    class Own(jv.Material):
        pass

    scene = jv.Scene([FLOOR, jv.Surface(jv.Sphere([0, 0, 1], 0.1), Own())], lamp(4.0, 1.0))
    assert "Own" in bound_of(scene, "surfaces[1].material").why


# ---------------------------------------------------------------- options


def test_tracers_are_refused():
    scene = jv.Scene(FLOOR, jv.PointLight([0, 0, 2], [1.0]))

    def of_light(x):
        moved = replace(scene.lights[0], intensity=x)
        effects.inspect(replace(scene, lights=(moved,)), VIEW)

    def of_sensor(x):
        effects.prune(scene, jv.Camera(VIEW, jv.Sensor(gain=x[0])), "1DN")

    for traced in (of_light, of_sensor):
        with pytest.raises(ValueError, match="outside jit"):
            jax.eval_shape(traced, jnp.ones(1))


def test_free_parameters_are_kept_and_bounds_hold_over_their_box():
    lights = [jv.PointLight([0, 0, 2], [1.0]), jv.PointLight([0, 0, 300], [1e-3])]
    scene = jv.Scene(FLOOR, lights)
    box = {"lights[1].intensity": (0.0, 10.0), "surfaces[0].material.diffuse": (0.0, 0.5)}
    free = effects.prune(scene, VIEW, "1%", level=1.0, free=box)
    assert len(free.scene.lights) == 2
    assert next(e for e in free.certificate.kept if e.name == "lights[1]").free
    whole = bound_of(scene, "lights[1]", free=box).bound
    rng = np.random.default_rng(0)
    for _ in range(20):
        light = replace(lights[1], intensity=rng.uniform(0, 10, 1))
        floor = replace(FLOOR, material=jv.Lambert(rng.uniform(0, 0.5, 1)))
        assert bound_of(jv.Scene(floor, [lights[0], light]), "lights[1]").bound <= whole


@pytest.mark.parametrize("where", [(0.0, 0.0, 1.0), (0.5, 0.2, 3.0)])
def test_a_moving_lamp_is_bounded_at_all_its_positions(where):
    ball = jv.Surface(jv.Sphere([0, 0, 0.5], 0.2), jv.Phong([0.1], [0.3], 20.0))
    scene = jv.Scene([FLOOR, ball], jv.PointLight([0, 0, 2], [1.0]))
    box = {"lights[0].position": ((-0.5, -0.5, 1.0), (0.5, 0.5, 3.0))}
    moved = jv.Scene([FLOOR, ball], jv.PointLight(where, [1.0]))
    for name in ("lights[0]", "shadows[0]", "surfaces[1].material.specular"):
        assert bound_of(moved, name).bound <= bound_of(scene, name, free=box).bound


def stretched(seed):
    """Return boxes for half of a random scene's strengths, and for the centres of its balls."""
    scene, _ = random_scene(seed)
    rng, box = np.random.default_rng(seed), {}
    for i, light in enumerate(scene.lights):
        for name in light.spectra:
            own = np.asarray(getattr(light, name), float)
            if own.ndim == 1 and rng.random() < 0.5:
                box[f"lights[{i}].{name}"] = 0.3 * own, 3 * own
    for i, surface in enumerate(scene.surfaces):
        own = getattr(surface.material, "diffuse", None)
        if own is not None and rng.random() < 0.5:
            box[f"surfaces[{i}].material.diffuse"] = 0.3 * own, 2 * own
        if isinstance(surface.shape, jv.Sphere):
            middle = np.asarray(surface.shape.centre, float)
            box[f"surfaces[{i}].shape.centre"] = middle - 0.05, middle + 0.05
    return box


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*QUICK, 11, 17])
def test_bounds_over_a_box_hold_at_20_random_points_of_it(seed):
    """The change by each effect alone is within its bound over the box. At one point the oracle
    renders it, and at all points it is the bound for that point."""
    scene, view = random_scene(seed)
    box, rng = stretched(seed), np.random.default_rng(seed)
    over = {e.name: e.bound for e in effects.inspect(scene, view, free=box)}
    for k in range(20):
        moved = scene
        for name, (low, high) in box.items():
            value = low + (high - low) * rng.random(low.shape)
            moved = replaced({"scene": moved}, {f"scene.{name}": value})["scene"]
        rows, _, _ = scene_stage(Ends(moved, moved), Ends(view, view))
        camera = jv.Camera(view, jv.Sensor())
        draft = Draft(moved.surfaces, moved.lights, frozenset(), moved.ambient, camera)
        for row in rows:
            assert row.effect.bound <= over[row.effect.name] * (1 + 1e-9), row.effect.name
            if k or row.drop is None or not row.effect.present or row.together == "shadows":
                continue
            change = np.abs(drawn(only(moved, draft, row), view) - drawn(moved, view)).max()
            assert change <= over[row.effect.name] * (1 + 1e-9) + ROUNDING, row.effect.name


@pytest.mark.parametrize("end", [np.inf, np.nan])
def test_an_infinite_box_is_refused(end):
    """An infinite box has no position, and its shadows were bounded by exactly zero."""
    scene = jv.Scene(FLOOR, jv.PointLight([0, 0, 2], [1.0]))
    with pytest.raises(jv.InputError, match="finite ends"):
        effects.inspect(scene, VIEW, free={"lights[0].position": (-1.0, end)})


def test_unknown_names_are_told_the_nearest():
    scene = jv.Scene(FLOOR, jv.PointLight([0, 0, 2], [1.0]))
    with pytest.raises(jv.InputError, match=r"surfaces\[0\].material.diffuse"):
        effects.inspect(scene, VIEW, free={"surfaces[0].material.difuse": (0, 1)})


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [("1%", 0.01, "relative"), ("0.5DN", 0.5, "DN"), ("0.1 sigma", 0.1, "sigma")],
)
def test_tolerances_are_read(text, value, unit):
    found = effects.parse(text)
    assert (found.value, found.unit) == (value, unit)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"tolerance": 0.01}, "a Tolerance or its text"),
        ({"free": ["lights[0].intensity"]}, "names of fields"),
        ({"depth": 2.5}, "a whole number"),
    ],
)
def test_options_of_another_kind_are_refused(options, sentence):
    scene = jv.Scene(FLOOR, jv.PointLight([0, 0, 2], [1.0]))
    with pytest.raises(jv.InputError, match=sentence):
        effects.prune(scene, VIEW, **({"tolerance": "1%", "level": 1.0} | options))


@pytest.mark.parametrize("text", ["", "1 cm", "-1%", "nan%", "%"])
def test_no_tolerance_is_refused(text):
    with pytest.raises(jv.InputError, match="tolerance"):
        effects.parse(text)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("1", "is 100 %; write 1% or 0.01."),
        ("2.5", "is 250 %; write 2.5% or 0.025."),
        ("100", "is 10000 %; give less, as in 1%."),
    ],
)
def test_a_forgotten_per_cent_is_refused(text, sentence):
    """Within 100 % of the level everything may be dropped, and the picture is black."""
    scene = jv.Scene(FLOOR, jv.PointLight([0, 0, 2], [1.0]))
    with pytest.raises(jv.InputError, match=re.escape(sentence)):
        effects.prune(scene, VIEW, text, level=1.0)
    assert effects.parse("0.99").value == 0.99


def test_a_certificate_explains_itself():
    lights = [jv.PointLight([0, 0, 2], [1.0]), jv.PointLight([0, 0, 300], [1e-3])]
    certificate = effects.prune(jv.Scene(FLOOR, lights), VIEW, "1%", level=1.0).certificate
    text, table = effects.explain(certificate), certificate._repr_html_()
    for word in ("lights[1]", "dropped", "kept", "bound (of level)", "Dropped 3 of 4"):
        assert word in text
        assert word in table
    json.dumps([effect.__dict__ for effect in certificate.dropped])
    assert "bound (DN)" in effects.explain(replace(certificate, unit="DN"))


def test_paths_are_cut_where_light_is_negligible():
    """Two dark plates face each other, so each further segment has at most rho times the form
    factor."""
    plates = [
        jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Lambert([0.05 / np.pi])),
        jv.Surface(jv.Quad([-1, -1, 4], [0, 2, 0], [2, 0, 0]), jv.Lambert([0.05 / np.pi])),
    ]
    scene = jv.Scene(plates, jv.PointLight([0, 0, 2], [1.0]))
    eye = eye_of(Ends(VIEW, VIEW))
    sums = sums_of(Ends(scene, scene), eye, bounces=True)
    bounds = [row.effect.bound for row in bounce_rows(Onward(sums, 8))]
    assert len(bounds) == 6
    shrinking = np.array(bounds[1:]) / np.array(bounds[:-1])
    assert np.all(shrinking <= 0.05 * 2 / 16 * 16)
    pruned = effects.prune(scene, VIEW, "1%", level=0.01, depth=8)
    assert pruned.depth < 8


def test_bounds_hold_at_every_moment_of_a_motion():
    """A lamp that approaches during the exposure is bounded at its nearest position, and not left
    out."""
    scene = jv.Scene(FLOOR, [jv.PointLight([0, 0, 2], [1.0]), jv.PointLight([0, 0, 99], [1.0])])
    camera = jv.Camera(VIEW, jv.Sensor(exposure_time=1.0))

    def nearer(scene, view, time):
        light = replace(scene.lights[1], position=jnp.stack([0 * time, 0 * time, 99 - 98 * time]))
        return replace(scene, lights=(scene.lights[0], light)), view

    resting = bound_of(scene, "lights[1]", camera).bound
    moving = bound_of(scene, "lights[1]", camera, motion=nearer, moments=9).bound
    assert moving > 100 * resting
    end = jv.PointLight([0, 0, 1 + 98 / 18], [1.0])  # the middle of the last ninth
    assert moving == pytest.approx(bound_of(jv.Scene(FLOOR, end), "lights[0]").bound, rel=0.3)
