"""Tests bounds of effects that reach beyond one pixel or one sample, and of lamps that only
occlude, against pictures."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import direct_light

import jaxvision as jv
from jaxvision import effects
from jaxvision import scene as s
from jaxvision.effects.optics import optics_stage
from jaxvision.effects.sensor import sensor_stage
from jaxvision.effects.stages import Arriving, Ends
from jaxvision.optics import sensor_irradiance
from jaxvision.rendering import PixelSamples
from jaxvision.sensor import pixel_means


def on_sensor(sensor, brightest, shape):
    rows, response = sensor_stage(Ends(sensor, sensor), np.array([brightest]), shape=shape)
    return {row.effect.name: row.effect for row in rows}, response


@pytest.mark.parametrize("blooming", [0.5, 0.9, 1.0])
def test_overflowing_charge_accumulates_in_pixels_between(blooming):
    """A dark pixel at the end of a column that is just full receives some of every change."""
    rows, brightest = 64, 1015.0
    light = jnp.full((rows, 1, 1), brightest).at[0].set(0)
    sensor = s.Sensor(
        quantum_efficiency=0.99, dark_current=3.0, full_well=1e3, blooming=blooming, gain=1.0
    )
    found, response = on_sensor(sensor, brightest, (rows, 1))
    whole = np.asarray(jv.raw_image(None, sensor, light))

    def moved(sensor, light=light):
        return np.abs(np.asarray(jv.raw_image(None, sensor, light)) - whole).max()

    rounding = 1e-6 * rows * brightest
    for name in ("quantum_efficiency", "dark_current"):
        change = moved(replace(sensor, **{name: None}))
        assert 2 < change <= found[f"sensor.{name}"].bound + rounding
    dimmer = moved(sensor, 0.98 * light)
    assert dimmer <= response.dn(np.array([0.02 * brightest]), frozenset()) + rounding


def test_full_wells_pass_on_a_change_completely():
    """A bright pixel is in a column with little remaining capacity, with one dark pixel at its
    end."""
    light = jnp.full((14, 1, 1), 9.9).at[0].set(0).at[13].set(20.0)
    sensor = s.Sensor(dark_current=0.004, full_well=10.0, blooming=1.0, gain=1.0)
    whole = jv.raw_image(None, sensor, light)
    change = jnp.abs(jv.raw_image(None, replace(sensor, dark_current=None), light) - whole).max()
    bound = on_sensor(sensor, 20.0, (14, 1))[0]["sensor.dark_current"].bound
    assert 8 * 0.004 < change <= bound


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [
        {"charge_transfer": s.ChargeTransfer(0.01, trail=3)},
        {"charge_transfer": s.ChargeTransfer(0.01, serial_inefficiency=0.02, trail=2)},
        {"full_well": 1000.0, "blooming": 0.9},
        {},
    ],
)
@pytest.mark.parametrize("kind", ["hot_pixels", "dead_pixels"])
def test_rare_pixels_include_the_neighbours_that_they_change(more, kind):
    """The reference counts the pixels that differ in pictures of four dies."""
    shape, fraction = (40, 40), 2e-3
    sensor = s.Sensor(gain=1.0, **more)
    rare = {"hot_pixels": s.HotPixels(fraction, 5e3), "dead_pixels": fraction}[kind]
    sensor = replace(sensor, **{kind: rare})
    light = jnp.full((*shape, 1), 900.0)
    clean = jv.raw_image(None, replace(sensor, **{kind: None}), light)
    dies = jax.random.split(jax.random.key(3), 4)
    frames = jax.vmap(lambda die: jv.raw_image(None, sensor, light, die_key=die))(dies)
    differ = float(jnp.mean(jnp.sum(jnp.abs(frames - clean[None]) > 1e-2, axis=(1, 2, 3))))
    promised = on_sensor(sensor, 900.0, shape)[0][f"sensor.{kind}"].rare
    assert 1 < differ <= 1.5 * promised  # the dies have 13 +- 4 such pixels on average
    assert more or promised == pytest.approx(fraction * 1600)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["rim", "distortion"])
def test_a_lens_is_bounded_at_all_samples_of_a_pixel(part):
    """The corners of a pixel are farther out than its centre, where the rim still blocks
    nothing."""
    n = 4
    parts = {
        "rim": {"rim": s.Rim(0.02, 0.0165), "resolution": (2, 2)},
        "distortion": {"distortion": s.Distortion([0.3, 0.1]), "resolution": (1, 1)},
    }[part]
    view = s.ThinLens(np.zeros(3), np.eye(3), 0.05, 6e-3, f_number=4.0, focus_distance=2.0, **parts)
    aperture = s.PixelAperture(1.0, oversampling=n)

    def picture(view):
        rows, columns = view.resolution
        fine = replace(view, resolution=(n * rows, n * columns), pixel_pitch=view.pixel_pitch / n)
        return np.asarray(
            pixel_means(sensor_irradiance(fine, jnp.ones((*fine.resolution, 1))), aperture)
        )

    arriving = Arriving(np.ones(1), 1.0, np.inf, np.zeros(1))
    rows, reaching = optics_stage(Ends(view, view), arriving, oversampling=n)
    bound = {row.effect.name: row.amount[0] for row in rows}[f"view.{part}"]
    change = np.abs(picture(replace(view, **{part: None})) - picture(view)).max()
    assert 1e-5 < change <= bound
    assert picture(view).max() <= reaching.irradiance[0]


@pytest.mark.slow
def test_a_dark_lamp_hides_the_sky_in_a_mirror():
    """As a point it would not hide the sky, so it must stay a rectangle."""
    mirror = jv.Surface(jv.Quad([-1, -1, 0], [2, 0, 0], [0, 2, 0]), jv.Mirror([0.9]))
    lamp = jv.RectangleLight([-0.5, -0.5, 2], [0, 1, 0], [1, 0, 0], [0.0])
    scene = jv.Scene(mirror, [lamp, jv.environment_map(np.ones((4, 8, 1)))])
    down = np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1.0]])
    view = jv.Pinhole([0, 0, 1.5], down, 0.05, 4e-3, resolution=(8, 8))
    pruned = effects.prune(scene, view, "0%", level=1.0)
    np.testing.assert_array_equal(jv.render(pruned.scene, view), jv.render(scene, view))
    assert np.ptp(jv.render(scene, view)) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("shape", "least"), [("card", 0.5), ("ball", 0.0)])
def test_a_mirror_shows_the_lamps_in_the_reflected_direction(shape, least):
    """Lamps are in all directions, and the pictures are from NumPy. A lamp that may be left out is
    in no mirror."""
    made = {
        "card": jv.Quad([-0.3, -0.3, 0], [0.6, 0, 0], [0, 0.6, 0]),
        "ball": jv.Sphere([0, 0, 0], 0.3),
    }
    mirror = jv.Surface(made[shape], jv.Mirror([0.9]))
    eye = np.array([0.8, 0.0, 2.0])
    axes = jv.look_at(eye, np.zeros(3), np.array([0, 1.0, 0]))
    view = jv.Pinhole(eye, axes, 1.0, 0.02, resolution=(24, 24))
    rng, shown, proved = np.random.default_rng(0), 0, 0
    for _ in range(40):
        place = np.array([0, 0, 0.5]) + rng.normal(size=3)
        place *= rng.uniform(1.5, 4) / np.linalg.norm(place)
        u = np.cross(place, rng.normal(size=3))
        u *= 0.3 / np.linalg.norm(u)
        v = 0.3 * np.cross(u, place) / np.linalg.norm(np.cross(u, place))
        lamp = jv.RectangleLight(place - (u + v) / 2, u, v, [1.0])
        scene = jv.Scene(mirror, lamp)
        seen = direct_light.picture(*jax.tree.map(np.asarray, (scene, view))).max()
        bound = next(e.bound for e in effects.inspect(scene, view) if e.name == "lights[0]")
        assert seen <= bound
        shown, proved = shown + (seen > 0), proved + (bound == 0)
    assert 1 <= shown < 20
    assert proved >= least * (40 - shown)


@pytest.mark.slow
def test_a_free_aperture_stays_that_of_the_lens():
    """A pinhole has the working f-number, which for a lens focused at 10 f is larger by a ninth."""
    card = jv.Surface(jv.Quad([-0.3, -0.3, 0.5], [0, 0.6, 0], [0.6, 0, 0]), jv.Lambert([0.3]))
    scene = jv.Scene(card, jv.PointLight([0, 0, 0], [1.0]))
    view = jv.ThinLens(
        np.zeros(3), np.eye(3), 0.05, 2e-3, f_number=4.0, focus_distance=0.5, resolution=(2, 2)
    )
    camera, samples = jv.Camera(view, jv.Sensor(gain=1e3)), PixelSamples(jax.random.key(0), 4)
    free = {"view.f_number": (3.0, 4.0)}
    pruned = effects.prune(scene, camera, "0.5DN", free=free, samples=samples)

    def brightest(scene, camera, samples):
        opened = replace(camera, view=replace(camera.view, f_number=3.0))
        return float(jv.capture(None, scene, opened, samples=samples).raw.max())

    whole, left = brightest(scene, camera, samples), brightest(pruned.scene, pruned.camera, samples)
    assert abs(whole - left) <= pruned.certificate.total + 1e-4 * whole


@pytest.mark.slow
def test_a_parallel_view_that_may_move_into_a_ball_sees_its_inside():
    ball = jv.Surface(jv.Sphere([0, 0, 0], 1), jv.Lambert([0.3]), two_sided=True)
    scene = jv.Scene(ball, jv.PointLight([0, 0, 0.0], [1.0]))
    down = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    view = jv.Orthographic([0, 0, 3], down, 0.1, resolution=(2, 2))
    rows = effects.inspect(scene, view, free={"view.position": ([0, 0, 0], [0, 0, 3])})
    bound = {row.name: row.bound for row in rows}["lights[0]"]
    assert 0.1 < float(jv.render(scene, replace(view, position=[0.0, 0, 0])).max()) <= bound
