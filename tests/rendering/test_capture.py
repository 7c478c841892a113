"""Tests the whole chain against a naive loop, and that absent effects leave nothing in the
program."""

import base64
import io
import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
from oracles import loops
from scipy import ndimage, special

import jaxvision as jv
from jaxvision import scene as s
from jaxvision.optics import sensor_irradiance
from jaxvision.rendering import PixelSamples, Traced, render
from jaxvision.shot import Capture, capture
from jaxvision.transport import Paths, path_traced

BANDS = 3
ROTATION = loops.look_at([0, -4, 1.5], [0, 0, 1.2], [0, 0, 1])
PINHOLE = s.Pinhole([0, -4, 1.5], ROTATION, 0.05, 0.004, resolution=(10, 12))
PARALLEL = s.Orthographic([0, -4, 1.5], ROTATION, 0.25, resolution=(10, 12))
KD, KS, KA = [0.2, 0.15, 0.1], [0.1, 0.2, 0.3], [0.5, 0.6, 0.7]
SURFACES = [
    s.Surface(s.Plane([0, 0, 0], [0, 0, 1]), jv.Lambert(KD, ambient=KA)),
    s.Surface(s.Sphere([-0.9, 0, 0.6], 0.6), jv.Phong(KD, KS, 15.0)),
    s.Surface(s.Sphere([0.9, 0, 0.5], 0.5), jv.Phong(KS, KD, 40.0)),
    s.Surface(s.Sphere([0, 1, 0.8], 0.8), jv.GaussianLobe(KA, KS, 4.0, ambient=KD)),
]
LIGHTS = [jv.PointLight([2, -2, 4], [9.0, 8.0, 7.0]), jv.DirectionalLight([-1, -1, 1], [0.5] * 3)]
SCENE = s.Scene(SURFACES, LIGHTS, s.AmbientLight([0.1, 0.2, 0.3]))
LAMBERT_ONLY = s.Scene(
    [s.Surface(surface.shape, jv.Lambert(KD)) for surface in SURFACES], LIGHTS[:1]
)


def plain_scene():
    """Return the same scene for the loop."""
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


draw = jax.jit(render)


@pytest.mark.slow
@pytest.mark.parametrize("view", [PINHOLE, PARALLEL], ids=["pinhole", "orthographic"])
def test_picture_against_the_naive_loop(view):
    expected = loops.render(*plain_scene(), plain_rays(view), BANDS)
    assert (expected == 0).all(axis=-1).any()  # in shadow, or sky for the pinhole
    assert (expected > 0).all(axis=-1).mean() > 0.5
    np.testing.assert_allclose(draw(SCENE, view), expected, rtol=1e-9, atol=1e-12)


def test_stages_fit_together():
    """1 W m^-2 sr^-1 through f/2 gives pi / 16 W m^-2 on the axis. DN and sRGB then follow by
    hand."""
    wall = s.Surface(s.Plane([0, 0, 2], [0, 0, -1]), jv.Lambert([0.0], ambient=[1.0]))
    scene = s.Scene([wall], [], s.AmbientLight([1.0]))
    view = s.Pinhole([0, 0, 0], np.eye(3), 1, 1e-9, resolution=(1, 1), f_number=2)
    sensor = s.Sensor(exposure_time=10.0, gain=800.0, offset=64.0, bits=12)
    development = s.Development(black_level=64, white_level=64 + 4 * 785, tone=s.SRGB())
    shot = jax.jit(capture)(None, scene, s.Camera(view, sensor, development))
    np.testing.assert_allclose(shot.radiance, [[[1.0]]], rtol=1e-15)
    np.testing.assert_allclose(shot.irradiance, [[[np.pi / 16]]], rtol=1e-15)
    assert float(shot.raw[0, 0, 0]) == round(np.pi / 16 * 8000 + 64)  # 1635
    grey = (1635 - 64) / (4 * 785)
    np.testing.assert_allclose(shot.picture, [[[loops.srgb_encode(grey)]]], rtol=1e-14)
    undeveloped = jax.eval_shape(capture, None, scene, s.Camera(view, sensor))
    assert undeveloped.picture is None


@pytest.mark.slow
def test_keys_determine_the_right_draws():
    sensor = s.Sensor(exposure_time=100.0, prnu=0.1, read_noise=1.0)
    camera = s.Camera(PINHOLE, sensor)
    a, b = jax.random.split(jax.random.key(0))
    take = jax.jit(lambda key, die: capture(key, SCENE, camera, die_key=die).raw)
    first, again, other_frame, other_die = take(a, b), take(a, b), take(b, b), take(a, a)
    np.testing.assert_array_equal(first, again)
    assert (first != other_frame).all()
    lit = draw(SCENE, PINHOLE) > 0
    assert (first != other_die)[lit].all()
    np.testing.assert_array_equal(first[~lit], other_die[~lit])


# ------------------------------------------------ only effects of the scene

RANDOM = r"random_bits|threefry|random_wrap|random_fold_in"


def program(function, *arguments):
    return str(jax.make_jaxpr(function)(*arguments))


@pytest.mark.slow
def test_a_noiseless_sensor_traces_no_random_bits():
    def shoot(camera):
        return capture(jax.random.key(0), LAMBERT_ONLY, camera).raw

    quiet = s.Sensor(gain=1.0, bits=8.0, full_well=1e4, dark_current=1.0)
    text = program(lambda c: capture(None, LAMBERT_ONLY, c).raw, s.Camera(PINHOLE, quiet))
    assert not re.search(RANDOM, text)
    noisy = program(shoot, s.Camera(PINHOLE, replace(quiet, read_noise=1.0)))
    assert re.search(RANDOM, noisy)


def test_one_compilation_serves_lights_and_materials():
    traced = []

    @jax.jit
    def shoot(scene):
        traced.append(1)
        return render(scene, PINHOLE)

    for exponent in (5.0, 500.0, np.float64(2)):
        ball = s.Surface(s.Sphere([0, 0, 1], exponent / 500), jv.Phong(KD, KS, exponent))
        shoot(s.Scene([ball], LIGHTS))
    assert len(traced) == 1


@pytest.mark.slow
def test_a_measured_material_is_not_copied_for_every_pixel():
    """With two tables of 2 MB and 64 x 64 pixels, memory stays close to the tables' size."""
    angles = jnp.linspace(0.0, 1.5, 25)
    table = jv.IsotropicTable(
        angles, angles, jnp.linspace(0.0, 3.1, 26), jnp.full((25, 25, 26, 16), 0.2)
    )
    balls = [s.Surface(s.Sphere((x, 0.0, 0.0), 0.5), table) for x in (-0.5, 0.5)]
    scene = s.Scene(balls, [jv.DirectionalLight((0.0, 0.0, 1.0), np.ones(16))])
    view = s.Orthographic((0.0, 0.0, 5.0), np.diag([1.0, -1.0, -1.0]), 0.03, resolution=(64, 64))
    compiled = jax.jit(render).lower(scene, view).compile()
    assert compiled.memory_analysis().temp_size_in_bytes < 100e6


# ------------------------------------------------ the sensor's own sampling of space and time


def moved(scene, view, time):
    """Move the camera to the right at 0.5 m/s."""
    right = jnp.asarray(ROTATION[0])
    return scene, replace(view, position=view.position + 0.5 * time * right)


@pytest.mark.slow
def test_a_motion_is_the_mean_over_its_moments():
    sensor = s.Sensor(exposure_time=0.4)
    view = replace(PARALLEL, resolution=(4, 5))
    take = jax.jit(lambda camera: capture(None, LAMBERT_ONLY, camera, motion=moved, moments=2))
    shot = take(s.Camera(view, sensor))
    still = [draw(*moved(LAMBERT_ONLY, view, time)) for time in (0.1, 0.3)]
    np.testing.assert_allclose(shot.radiance, (still[0] + still[1]) / 2, rtol=1e-12)
    rolling = take(s.Camera(view, replace(sensor, shutter=s.RollingShutter(0.4 / 3))))
    # the span is 0.8 s in two slots; the first row sees only the first slot, and the last only the
    # second
    seen = [draw(*moved(LAMBERT_ONLY, view, time)) for time in (0.2, 0.6)]
    np.testing.assert_allclose(rolling.irradiance[0], seen[0][0], rtol=1e-12)
    np.testing.assert_allclose(rolling.irradiance[3], seen[1][3], rtol=1e-12)
    with pytest.raises(ValueError, match=r"Sensor\.exposure_time must be given"):
        capture(None, LAMBERT_ONLY, s.Camera(view, s.Sensor()), motion=moved)


@pytest.mark.slow
def test_oversampled_pixels_are_means_over_their_apertures():
    view = replace(PINHOLE, resolution=(4, 5), f_number=2.0)
    aperture = s.PixelAperture(0.25, oversampling=2)
    shot = jax.jit(capture)(None, LAMBERT_ONLY, s.Camera(view, s.Sensor(pixel_aperture=aperture)))
    fine = replace(view, resolution=(8, 10), pixel_pitch=view.pixel_pitch / 2)
    samples = np.asarray(sensor_irradiance(fine, draw(LAMBERT_ONLY, fine)))
    means = samples.reshape(4, 2, 5, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(shot.irradiance, means, rtol=1e-12)
    np.testing.assert_allclose(shot.raw, 0.25 * means, rtol=1e-12)


@pytest.mark.slow
def test_a_mosaic_is_captured_with_one_number_per_pixel():
    colours = s.ColourFilter(np.eye(3), pattern=((0, 1), (1, 2)))
    shot = jax.jit(capture)(None, SCENE, s.Camera(PINHOLE, s.Sensor(colour_filter=colours)))
    assert shot.irradiance.shape == (10, 12, 3)
    np.testing.assert_array_equal(shot.raw[1::2, 1::2, 0], shot.irradiance[1::2, 1::2, 2])


# ------------------------------------------------ through a lens

F, F_NUMBER, WALL = 0.05, 2.0, 2.0
LENS = s.ThinLens(
    [0, 0, 0], np.eye(3), F, 1e-4, resolution=(4, 24), f_number=F_NUMBER, focus_distance=1.0
)
HALF_WALL = s.Scene(
    [s.Surface(s.Quad([0, -1, WALL], [0, 2, 0], [1, 0, 0]), jv.Lambert([0.0]), emission=[1.0])], []
)


@pytest.mark.slow
def test_a_captured_picture_is_blurred_by_diffraction():
    """The reference Airy pattern uses SciPy's Bessel function, integrated over pixels by
    midpoints."""
    view = replace(LENS, focus_distance=None, f_number=jnp.asarray(8.0), pixel_pitch=1.5e-6)
    wave, size, n = 5e-7, 21, 96
    bent = replace(view, diffraction=s.Diffraction(wave, size=size))
    shoot = jax.jit(lambda view: capture(None, HALF_WALL, s.Camera(view, s.Sensor())))
    plain, spread = shoot(view), shoot(bent)
    np.testing.assert_array_equal(plain.radiance, spread.radiance)
    places = (np.arange(size * n) + 0.5) / n - size / 2
    x = np.pi * 1.5e-6 * np.hypot(places[:, None], places) / (wave * 8)
    airy = (2 * special.j1(x) / x) ** 2
    kernel = airy.reshape(size, n, size, n).sum(axis=(1, 3))
    expected = ndimage.correlate(
        np.asarray(plain.irradiance)[..., 0], kernel / kernel.sum(), mode="nearest"
    )
    np.testing.assert_allclose(spread.irradiance[..., 0], expected, atol=2e-6 * expected.max())
    assert np.abs(spread.irradiance - plain.irradiance).max() > 0.05 * expected.max()
    flat = sensor_irradiance(bent, jnp.ones((*view.resolution, 1)))
    cos4 = sensor_irradiance(view, jnp.ones((*view.resolution, 1)))
    np.testing.assert_allclose(flat, cos4, rtol=1e-6)


@pytest.mark.slow
def test_multiple_reflections_are_those_of_the_integrator():
    """The scene is a box of a floor and a wall with emission. The radiance is from paths, and the
    camera unchanged."""
    wall = s.Surface(s.Quad([-2, 2, 0], [4.0, 0, 0], [0, 0, 4.0]), jv.Lambert([0.1] * 3), [2.0] * 3)
    room = s.Scene([wall, *LAMBERT_ONLY.surfaces[:2]], [])
    camera = s.Camera(replace(PINHOLE, f_number=4.0), s.Sensor(gain=3.0))
    paths, key = Paths(4, 3), jax.random.key(2)
    shot = jax.jit(lambda key: capture(key, room, camera, integrator=paths))(key)
    traced = jax.vmap(lambda key: path_traced(key, room, camera.view, method=paths).radiance)
    found = jax.jit(traced)(jax.random.split(jax.random.key(3), 32))
    error = np.asarray(found).std(axis=0, ddof=1)
    apart = np.abs(shot.radiance - found.mean(axis=0)) / np.maximum(error, 1e-3)
    assert np.median(apart) < 1
    assert shot.radiance.mean() > 0.1
    # the standard error is the scatter of pictures with other keys, and a lens does not change it
    assert shot.error is not None
    assert np.sqrt((shot.error**2).mean() / (error**2).mean()) == pytest.approx(1, abs=0.3)
    whole = float(np.sqrt((shot.error**2).mean() / (shot.radiance**2).mean()))
    assert float(Traced(shot.radiance, shot.error).relative_error) == pytest.approx(whole)
    moving = capture(
        key,
        room,
        replace(camera, sensor=s.Sensor(gain=3.0, exposure_time=1.0)),
        integrator=paths,
        motion=lambda scene, view, time: (scene, view),
        moments=2,
    )
    assert moving.error is None
    np.testing.assert_allclose(shot.irradiance, sensor_irradiance(camera.view, shot.radiance))
    np.testing.assert_allclose(shot.raw, 3 * shot.irradiance, rtol=1e-12)
    cut = capture(key, room, camera, integrator=paths, tolerance="0.001DN")
    assert cut.certificate is not None
    np.testing.assert_allclose(cut.raw, shot.raw, atol=1e-3)
    flat = capture(None, room, camera, integrator=lambda scene, view: jnp.ones((10, 12, 3)))
    np.testing.assert_array_equal(flat.radiance, 1)


@pytest.mark.slow
def test_radiance_without_a_lens_is_named():
    photons = s.PhotonConversion(wavelength=550e-9, pixel_area=25e-12)
    camera = s.Camera(PINHOLE, s.Sensor(exposure_time=0.01, photon_conversion=photons))
    with pytest.warns(UserWarning, match="the view has no f_number"):
        bare = capture(None, LAMBERT_ONLY, camera)
    behind_lens = replace(camera, view=replace(PINHOLE, f_number=4.0))
    raw = capture(None, LAMBERT_ONLY, behind_lens).raw
    cos4 = sensor_irradiance(behind_lens.view, jnp.ones((*PINHOLE.resolution, 1)))
    np.testing.assert_allclose(raw, bare.raw * cos4, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"integrator": Paths(1, 2)}, "give a key"),
        ({"integrator": "path"}, r"Paths\(samples, depth\)"),
        ({"integrator": Paths}, r"Paths\(samples, depth\)"),
        ({"integrator": Paths(1, 2), "samples": PixelSamples(jax.random.key(0), 2)}, "leave them"),
        ({"integrator": lambda scene, view: None, "tolerance": "1DN"}, "got a function"),
    ],
)
def test_a_mismatched_integrator_is_refused(options, said):
    with pytest.raises(ValueError, match=said):
        capture(None, SCENE, s.Camera(PINHOLE, s.Sensor()), **options)


@pytest.mark.parametrize(
    "sensor",
    [
        s.Sensor(quantum_efficiency=np.full(31, 0.5)),
        s.Sensor(photon_conversion=s.PhotonConversion(np.full(31, 5e-7), 1e-11)),
        s.Sensor(colour_filter=s.ColourFilter(np.ones((3, 31)), pattern=((0, 1), (1, 2)))),
    ],
)
def test_unequal_bands_are_refused_before_anything_is_rendered(sensor):
    rendered = []
    with pytest.raises(ValueError, match=r"scene has 3 bands and Sensor\..* 31: .*wavelengths="):
        capture(None, SCENE, s.Camera(PINHOLE, sensor), integrator=lambda *_: rendered.append(1))
    assert not rendered


@pytest.mark.parametrize(
    ("sensor", "missing"),
    [
        (s.Sensor(read_noise=2.0), "key"),
        (s.Sensor(prnu=0.01), "die_key"),
    ],
)
def test_a_missing_key_is_refused_before_rendering(sensor, missing, monkeypatch):
    rendered = []
    monkeypatch.setattr("jaxvision.shot.render", lambda *_, **__: rendered.append(1))
    with pytest.raises(ValueError, match=rf"^{missing} must be a random key, got None"):
        capture(None, SCENE, s.Camera(PINHOLE, sensor))
    assert not rendered


@pytest.mark.slow
def test_a_camera_in_the_scenes_bands_is_accepted():
    sensor = jv.read_camera("emva1288", wavelengths=[610e-9, 550e-9, 465e-9]).sensor
    with pytest.warns(UserWarning, match=r"gets 0\.0052 photons .* without a photon_conv"):
        shot = capture(
            jax.random.key(0),
            SCENE,
            s.Camera(PINHOLE, sensor),
            die_key=jax.random.key(1),
            integrator=lambda scene, view: jnp.ones((10, 12, 3)),
        )
    assert shot.raw.shape == (10, 12, 3)


def test_capture_has_a_derivative_by_the_exposure_time():
    """The scene is known, and only the exposure is traced. The derivative is the light times the
    efficiency."""

    def mean(exposure):
        sensor = s.Sensor(
            quantum_efficiency=0.5, exposure_time=exposure, shot_noise=s.PoissonShotNoise()
        )
        camera = s.Camera(PINHOLE, sensor)
        light = lambda scene, view: jnp.full((10, 12, 3), 1e6)  # noqa: E731
        shot = capture(jax.random.key(0), SCENE, camera, integrator=light)
        return shot.raw.sum() / shot.irradiance.sum()

    slope = jax.grad(mean)(jnp.asarray(0.01))
    np.testing.assert_allclose(slope, 0.5, rtol=0.01)


def shown(shot):
    """Return the picture (h, w, 3) shown in a notebook."""
    (found,) = re.findall('src="data:image/png;base64,([^"]+)"', shot._repr_html_())
    return plt.imread(io.BytesIO(base64.b64decode(found)))[..., :3]


def test_a_notebook_shows_the_picture_beside_the_table():
    rng = np.random.default_rng(0)
    light, raw = jnp.ones((40, 60, 3)), jnp.asarray(rng.uniform(100, 4000, (40, 60, 1)))
    developed = jnp.asarray(rng.uniform(-0.2, 1.2, (40, 60, 3)))
    shot = Capture(light, light, raw, developed)
    np.testing.assert_allclose(shown(shot), np.clip(developed, 0, 1), atol=0.003)
    assert "<td" in shot._repr_html_()
    grey = np.asarray((raw - raw.min()) / (raw.max() - raw.min()))
    np.testing.assert_allclose(
        shown(Capture(light, light, raw, None)), np.repeat(grey, 3, axis=2), atol=0.003
    )
    frames = Capture(light[None], light[None], jnp.stack([raw.at[0, 0].set(jnp.nan)] * 2), None)
    assert shown(frames).shape == (40, 60, 3)
    large = jnp.zeros((1000, 1281, 1))
    assert max(shown(Capture(large, large, large, None)).shape) <= 320
