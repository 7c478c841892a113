"""Tests light that reaches a picture through a lens from outside the frame, and apertures that are
not round."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from oracles import lenses

import jaxvision as jv
from jaxvision import effects
from jaxvision.effects.bodies import Bodies
from jaxvision.effects.cells import eye_of, visible_flags
from jaxvision.effects.motion import motion_stage
from jaxvision.effects.optics import defocus
from jaxvision.effects.stages import FAST, Ends

SHAPE, PITCH, FOCAL = (6, 9), 6e-4, 0.05
POINT = jv.PointLight([0, 0, 2.0], [1.0])
SAMPLES = jv.PixelSamples(jax.random.key(0), 64)
APERTURES = [
    jv.CircularAperture(),
    jv.AnnularAperture(0.5),
    jv.PolygonalAperture(5, angle=0.3),
    jv.RectangularAperture(1.0, 1.0),
    jv.RectangularAperture(3.0, 0.5),
    jv.RectangularAperture(0.2, 0.4),
]
rendered = jax.jit(jv.render, compiler_options=FAST)


def lens(**parts):
    parts = {"f_number": 2.0, "focus_distance": 1.0, **parts}
    return jv.ThinLens(np.zeros(3), np.eye(3), FOCAL, PITCH, resolution=SHAPE, **parts)


def image_of(focus):
    """Return the distance from the lens to the sensor, in m."""
    return 1 / (1 / FOCAL - 1 / focus)


def facing(x, y, z, width, height):
    """Return corner and edges of a rectangle around (x, y, z) that faces the camera."""
    return [x - width / 2, y - height / 2, z], [0, height, 0], [width, 0, 0]


def points_in(aperture, radius, n=41):
    """Return points of the aperture of a lens of this radius in m, (n^2, 2), including its
    corners."""
    side = np.linspace(-1, 1, n)
    if isinstance(aperture, jv.RectangularAperture):
        sizes = radius * float(aperture.width), radius * float(aperture.height)
        return np.stack(np.meshgrid(sizes[0] * side, sizes[1] * side), -1).reshape(-1, 2)
    turn, out = np.meshgrid(np.pi * side, (side + 1) / 2)
    points = radius * np.stack([out * np.cos(turn), out * np.sin(turn)], -1).reshape(-1, 2)
    if isinstance(aperture, jv.PolygonalAperture):
        corners = 0.3 + 2 * np.pi * np.arange(5) / 5
        return radius * np.stack([np.cos(corners), np.sin(corners)], -1)
    return points


@pytest.mark.parametrize("aperture", APERTURES, ids=repr)
def test_every_ray_of_a_pixel_is_in_view(aperture):
    rng = np.random.default_rng(0)
    for f_number, focus in ((1.4, 0.5), (2.0, 1.0), (4.0, 0.2), (8.0, np.inf)):
        eye = eye_of(Ends(*2 * [lens(f_number=f_number, focus_distance=focus, aperture=aperture)]))
        ends = np.stack([*np.meshgrid([-1, 1], [-1, 1])], -1).reshape(-1, 2)
        slopes = ends * [SHAPE[1] / 2, SHAPE[0] / 2] * PITCH / image_of(focus)
        points = points_in(aperture, FOCAL / f_number / 2)
        for slope in slopes:
            depth = np.exp(rng.uniform(np.log(0.01), np.log(1e4), (len(points), 1)))
            ray = np.concatenate([lenses.through(points, slope, depth, 1 / focus), depth], 1)
            assert visible_flags(eye, Bodies(ray[:, None], np.zeros((len(ray), 1)))).all()


def test_points_that_cannot_reach_the_lens_are_out_of_view():
    """Light from at most 2 r beyond the widest ray at depth z can enter."""
    eye, radius = eye_of(Ends(lens(), lens())), FOCAL / 4
    for depth in (0.5, 1.0, 50.0):
        pixel = (SHAPE[1] / 2 + 0.5) * PITCH / image_of(1.0) * depth
        widest = pixel + radius * (1 + depth) * np.array([0.99, 1.2])
        places = np.stack([widest, 0 * widest, 0 * widest + depth], -1)[:, None]
        assert visible_flags(eye, Bodies(places, np.zeros((2, 1)))).tolist() == [True, False]


@pytest.mark.slow
def test_lights_blurred_into_the_picture_are_kept():
    """An emitter and a lamp are outside the frame, far beyond the focus. The picture is compared
    full and pruned."""
    beside = 50 * SHAPE[1] / 2 * PITCH / image_of(1.0) + 0.45
    wall = jv.Surface(jv.Quad(*facing(0, 0, 60, 200, 200)), jv.Lambert([0.3]), emission=[1.0])
    shines = jv.Quad(*facing(beside, 0, 50, 0.15, 2))
    emitter = jv.Surface(shines, jv.Lambert([0.0]), emission=[1000.0])
    lamp = jv.RectangleLight(*facing(-beside, 0, 50, 0.15, 2), [1000.0])
    scene = jv.Scene([wall, emitter], [lamp], occluders=())
    full = np.asarray(rendered(scene, lens(), samples=SAMPLES))
    assert full[:, -1].max() > 2  # the wall alone gives 1, so the emitter is in the picture
    assert full[:, 0].max() > 2  # and so is the lamp
    left = effects.prune(scene, lens(), effects.Tolerance(0.0, place=0.0), samples=SAMPLES)
    small = np.asarray(rendered(left.scene, left.camera, samples=left.samples))
    assert np.abs(small - full).max() <= 1e-5 * full.max()
    rows = {row.name: row for row in effects.inspect(scene, lens(), samples=SAMPLES)}
    assert "of 50 m and beyond" in rows["view.defocus"].why


@pytest.mark.sweep
@pytest.mark.parametrize("aperture", APERTURES[3:], ids=repr)
def test_a_rim_cuts_off_corners_of_the_aperture(aperture):
    """The reference counts the share of rays through the aperture that the rim blocks."""
    view = lens(aperture=aperture, focus_distance=2.0, rim=jv.Rim(0.01, 0.0255))
    view = replace(view, pixel_pitch=1e-5)
    points = points_in(aperture, FOCAL / 4, n=801)
    slope = np.array([SHAPE[1] - 1, SHAPE[0] - 1]) / 2 * 1e-5 / image_of(2.0)
    at_rim = np.hypot(*lenses.through(points, slope, 0.01, 1 / 2.0).T)
    lost = (at_rim > 0.0255 / 2).mean()
    scene = jv.Scene([jv.Surface(jv.Quad(*facing(0, 0, 2, 9, 9)), jv.Lambert([0.0]), [3.0])], POINT)
    row = next(e for e in effects.inspect(scene, view) if e.name == "view.rim")
    area = 4 * float(aperture.width) * float(aperture.height) * (FOCAL / 4) ** 2
    brightness = 3 * area / image_of(2.0) ** 2
    assert row.bound == pytest.approx(lost * brightness, rel=0.01, abs=1e-12)
    assert (row.rank == "exact") == (lost == 0)


@pytest.mark.parametrize("aperture", APERTURES, ids=repr)
def test_corners_of_the_aperture_blur_the_farthest(aperture):
    view = lens(aperture=aperture, focus_distance=2.0)
    points = points_in(aperture, FOCAL / 4)
    for depth in (0.7, 4.0):
        hits = lenses.through(points, np.zeros(2), depth, 1 / 2.0) / depth
        farthest = np.hypot(*hits.T).max() * image_of(2.0) / PITCH
        place = defocus(Ends(view, view), depth, depth)
        assert farthest == pytest.approx(place, rel=1e-5)


def test_a_camera_that_may_move_is_bounded_at_its_nearest_position():
    """The displacement is computed by rays at the camera's nearest position."""
    scene = jv.Scene([jv.Surface(jv.Quad(*facing(0, 0, 2, 9, 9)), jv.Lambert([0.3]))], POINT)
    free = {"view.position": ([0, 0, -0.5], [0, 0, 0.5])}
    rows = effects.inspect(scene, lens(), free=free, samples=SAMPLES)
    place = next(row.place for row in rows if row.name == "view.defocus")
    for depth in (1.5, 2.5):
        hit = lenses.through(np.array([[FOCAL / 4, 0]]), np.zeros(2), depth, 1.0) / depth
        assert np.hypot(*hit.T).max() * image_of(1.0) / PITCH <= place * (1 + 1e-6)


@pytest.mark.slow
def test_motion_towards_a_lens_is_bounded_over_the_aperture():
    """For a point p and an aperture point a, the displacement is x' - x = (p - a) (1 / z' - 1 /
    z)."""
    card = facing(0, 0, 3, 0.1, 0.1)
    scene = jv.Scene([jv.Surface(jv.Quad(*card), jv.Lambert([0.3]))], POINT)
    view = replace(lens(f_number=1.0, focus_distance=0.2), resolution=(2, 2))

    def approach(scene, view, time):
        near = replace(scene.surfaces[0].shape, corner=np.array(card[0]) - [0, 0, 50 * float(time)])
        return replace(scene, surfaces=(replace(scene.surfaces[0], shape=near),)), view

    sensor = jv.Sensor(exposure_time=0.02)
    args = Ends(scene, scene), Ends(view, view), approach
    row = motion_stage(*args, sensor=Ends(sensor, sensor), moments=4)[0]
    last = 3 - 50 * 0.02 * 7 / 8
    points = points_in(jv.CircularAperture(), FOCAL / 2)
    places = [lenses.through(points, np.zeros(2), z, 1 / 0.2) for z in (3.0, last)]
    seen = (np.abs(places[0]) <= 0.05).all(1)  # points of the card, by rays through the centre
    moved = (places[0][seen] - points[seen]) * (1 / last - 1 / 3)
    assert row.effect.place >= np.hypot(*moved.T).max() * image_of(0.2) / PITCH


def beside_the_frame(seed):
    """Return a lens and a scene of a wall, two emitters and a lamp, at random depths outside its
    frame."""
    rng = np.random.default_rng(seed)
    focus = float(np.exp(rng.uniform(np.log(0.15), np.log(5))))
    f_number = rng.uniform(1, 4)
    square = jv.RectangularAperture(*rng.uniform(0.3, 2, 2))
    aperture = [jv.CircularAperture(), square][rng.integers(2)]
    view = lens(f_number=f_number, focus_distance=focus, aperture=aperture)
    view = replace(view, pixel_pitch=2e-4)

    def aside():
        z = float(np.exp(rng.uniform(np.log(0.3), np.log(100))))
        blur = FOCAL / f_number / 2 * abs(1 - z / focus)
        edges = np.array([SHAPE[1], SHAPE[0]]) / 2 * 2e-4 / image_of(focus) * z
        size = rng.uniform(0.1, 0.5, 2) * (blur + edges)
        place = rng.uniform(-1, 1, 2) * edges
        side = rng.integers(2)
        off = edges + size / 2 + rng.uniform(0, 1.2) * blur
        place[side] = rng.choice([-1, 1]) * off[side]
        return facing(*place, z, *size)

    def power():
        return [float(np.exp(rng.uniform(np.log(1e-2), np.log(1e3))))]

    grey = jv.Lambert([0.3])
    wall = jv.Surface(jv.Quad(*facing(0, 0, 120, 900, 900)), grey, emission=[1.0])
    emitters = [jv.Surface(jv.Quad(*aside()), grey, emission=power()) for _ in range(2)]
    lamp = jv.RectangleLight(*aside(), power())
    return jv.Scene([wall, *emitters], [POINT, lamp], occluders=()), view


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_random_scenes_through_a_lens(seed):
    scene, view = beside_the_frame(seed)
    full = np.asarray(rendered(scene, view, samples=SAMPLES))
    for tolerance in (0.0, 0.01, 0.1):
        goal = effects.Tolerance(tolerance, place=0.0)
        left = effects.prune(scene, view, goal, level=full.max(), samples=SAMPLES)
        small = np.asarray(rendered(left.scene, left.camera, samples=left.samples))
        assert np.abs(small - full).max() <= (left.certificate.total + 1e-12) * full.max()
