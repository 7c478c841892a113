"""Tests arguments of public functions: plain numbers and lists work like arrays, and visible misuse
gives one sentence."""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from examples import ROOMS, examples_of
from public_names import doors

import jaxvision as jv
from jaxvision.brdf.fresnel import Schlick, fresnel_conductor, fresnel_dielectric
from jaxvision.brdf.phong import phong_shading
from jaxvision.development import fit_colour_matrix
from jaxvision.files.cameras import read_camera
from jaxvision.histogram import equalise, exact_histogram
from jaxvision.optics import airy_radius
from jaxvision.point_ops import cross_dissolve, gain_bias

UP = [0, 0, 1]
THREE_NORMALS = np.eye(3)


def as_lists(argument):
    """Return a floating-point array as lists, as a user types it, and other arguments unchanged."""
    is_array = isinstance(argument, np.ndarray | jax.Array)
    if is_array and jnp.issubdtype(argument.dtype, jnp.floating):
        return np.asarray(argument).tolist()
    return argument


def as_known(tree):
    """Return NumPy arrays as JAX arrays, whose methods are traced inside a trace."""
    return jax.tree.map(lambda x: jnp.asarray(x) if isinstance(x, np.ndarray) else x, tree)


def shapes(call):
    return [(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(jax.eval_shape(call))]


@pytest.mark.parametrize(
    ("key", "got", "advice"),
    [
        (0, "0", "0"),
        (7, "7", "7"),
        (np.int64(7), r"(np\.int64\()?7\)?", "7"),  # as printed by NumPy
        (jnp.arange(3), r"int\d+ numbers of shape \(3,\)", "0"),
        ("seed", "'seed'", "0"),
    ],
)
def test_a_number_is_refused_as_a_random_key(key, got, advice):
    said = rf"key must be a random key, got {got}; write jax.random.key\({advice}\)."
    light, noise = jnp.ones((2, 2, 1)), jv.PoissonShotNoise()
    sensor = jv.Sensor(quantum_efficiency=[1.0], exposure_time=1.0, shot_noise=noise)
    with pytest.raises(ValueError, match=f"^raw_image: {said}"):
        jv.sensor.raw_image(key, sensor, light)
    with pytest.raises(ValueError, match=f"^raw_image: die_{said}"):
        jv.sensor.raw_image(jax.random.key(0), sensor, light, die_key=key)
    for record in (jv.MonteCarlo, jv.Balanced, jv.PixelSamples):
        with pytest.raises(ValueError, match=f"^{record.__name__}.{said}"):
            record(key, 4)


def test_keys_of_every_type_are_accepted():
    for key in (jax.random.key(0), jax.random.PRNGKey(0), jax.random.key(0, impl="rbg")):
        assert jv.MonteCarlo(key, 4).key is key
        jax.jit(lambda key: jv.Balanced(key, 4).key)(key)
    keys = jax.random.split(jax.random.key(0), 3)
    assert jax.vmap(lambda key: jv.PixelSamples(key, 1).key)(keys).shape == (3,)


@pytest.mark.sweep("geometry", "brdf")
@pytest.mark.parametrize("room", ROOMS)
def test_lists_and_plain_numbers_are_arrays_in_every_public_function(room):
    """The functions are traced, not compiled. Shapes and dtypes of the results equal those for
    arrays."""
    known = doors()
    for name, (arguments, options) in examples_of(room).items():
        if name not in known:
            continue
        function = partial(known[name], **options)
        lists = [as_lists(argument) for argument in arguments]
        try:
            found = shapes(partial(function, *lists))
        except Exception as error:
            pytest.fail(f"{name}: {type(error).__name__}: {error}")
        assert found == shapes(partial(function, *arguments)), name


def records_in(value):
    """Yield a record, the records in its fields, and those in a list."""
    if isinstance(value, eqx.Module):
        yield value
        value = [getattr(value, field.name, None) for field in dataclasses.fields(value)]
    if isinstance(value, tuple | list):
        for part in value:
            yield from records_in(part)


@pytest.mark.sweep(*sorted(set(ROOMS) - {"radiosity", "transport", "lights", "sensor", "optics"}))
@pytest.mark.parametrize("room", ROOMS)
def test_known_numbers_are_checked_inside_a_trace(room):
    """A fit's `predict` calls functions and makes records of known numbers inside a trace."""
    known, records, wrong = doors(), {}, []
    for name, (arguments, options) in examples_of(room).items():
        records |= {type(r): r for r in records_in([*arguments, *options.values()])}
        if name in known:
            call = partial(known[name], *as_known(arguments), **as_known(options))
            wrong += [name] if refuses_in_a_trace(call) else []
    for kind, record in records.items():
        fields = {f.name: getattr(record, f.name) for f in dataclasses.fields(record) if f.init}
        wrong += [kind.__name__] if refuses_in_a_trace(partial(kind, **as_known(fields))) else []
    assert not wrong


def refuses_in_a_trace(call):
    try:
        eqx.filter_eval_shape(call)
    except (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError):
        return True
    return False


def test_plain_numbers_take_the_dtype_of_arrays():
    half = jnp.asarray(0.5, jnp.float32)
    assert jv.image_distance(half, 0.05).dtype == jnp.float32
    assert jv.image_distance(2, 0.05).dtype == jnp.float64
    assert jv.dot(np.ones(3, np.float32), jnp.ones(3, jnp.float32)).dtype == jnp.float32


def test_lists_are_accepted_with_plain_numbers():
    """A plain number may stay one if the dtype cannot represent it."""
    np.testing.assert_allclose(gain_bias([0.1, 0.2], [2, 3], 1), [1.2, 1.6])
    np.testing.assert_array_equal(jv.norm(np.full(3, 200, np.uint8)), np.sqrt(3 * 200.0**2))


def test_integer_division_is_not_silent():
    found = jv.image_distance(jnp.asarray(3), jnp.asarray(2))
    assert float(found) == 6.0


def test_nan_passes():
    assert np.isnan(jv.lambert_shading([0, 0, np.nan], UP, [1.0])).all()
    assert np.isnan(jv.Lambert([np.nan]).diffuse).all()
    assert np.isnan(jv.Sphere(UP, np.nan).radius)


WINDOW = jv.Window([0, 0, 0], [1, 0, 0], [0, 1, 0])
SCENE = jv.Scene([jv.Surface(jv.Sphere([0, 0, 0], 1.0), jv.Lambert([0.2]))], [])
VIEW = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 0.1, resolution=(2, 2))
PATHS = jv.Paths(samples=1, depth=1)
LAMP = jv.RectangleLight([0, 0, 1], [1, 0, 0], [0, 1, 0], [1.0])

SENTENCES = {
    "radiance of a normal twice as long": (
        lambda: jv.lambert_shading([0, 0, 2], UP, [1.0]),
        r"lambert_shading: normal must be a unit vector, got one of length 2; divide",
    ),
    "a viewer three times too far": (
        lambda: phong_shading(UP, UP, wo=[0, 0, 3], diffuse=[0.1], specular=[0.1], exponent=30),
        r"phong_shading: wo must be a unit vector, got one of length 3",
    ),
    "three normals for one point": (
        lambda: jv.lambert_shading(THREE_NORMALS, UP, [1.0, 1.0, 1.0]),
        r"normal must have shape \(3,\), got \(3, 3\); for many at once take jax.vmap",
    ),
    "a camera for its view": (
        lambda: jv.project(read_camera("emva1288"), UP),
        "project: view must be a record, Orthographic or Pinhole or ThinLens, got a Camera",
    ),
    "a camera for its sensor": (
        lambda: jv.sensor.set_iso(read_camera("emva1288"), 400.0),
        "set_iso: sensor must be a record, Sensor, got a Camera",
    ),
    "view and scene the wrong way round": (
        lambda: jv.render(VIEW, SCENE),
        "render: scene must be a record, Scene, got a Pinhole",
    ),
    "a scene without a view": (
        lambda: jv.ray_traced(SCENE, None),
        "ray_traced: view must be a record, Orthographic or Pinhole or ThinLens, got None",
    ),
    "a camera before the scene": (
        lambda: jv.capture(None, read_camera("ideal"), SCENE),
        "capture: scene must be a record, Scene, got a Camera",
    ),
    "a view for its camera": (
        lambda: jv.capture(None, SCENE, VIEW),
        "capture: camera must be a record, Camera, got a Pinhole",
    ),
    "paths of a camera": (
        lambda: jv.path_traced(jax.random.key(0), SCENE, read_camera("ideal"), method=PATHS),
        "path_traced: view must be a record, .*, got a Camera",
    ),
    "a scene for a ray": (
        lambda: jv.intersect(jv.Sphere(UP, 1.0), jv.Sphere(UP, 1.0)),
        "intersect: ray must be a record, Ray, got a Sphere",
    ),
    "degrees": (
        lambda: jv.brdf.at_angles(jv.Lambert([0.1]), 45.0, 0.0, 45.0, 180.0),
        "at_angles: theta_i, in rad, must be finite, at least 0 and at most 3.14159, got 45",
    ),
    "a light without a direction": (
        lambda: jv.DirectionalLight([0, 0, 0], [1.0]),
        "DirectionalLight.direction must have a direction",
    ),
    "more than all light reflected": (
        lambda: Schlick([3.0]),
        "Schlick.f0 must be finite, at least 0 and at most 1, got 3",
    ),
    "a roughness in degrees": (
        lambda: jv.OrenNayar([0.1], 30.0),
        r"OrenNayar.sigma must be finite, at least 0 and at most 1\.5708, got 30",
    ),
    "words": (lambda: jv.dot("abc", UP), "dot: u must be numbers, got 'abc'"),
    "nothing": (lambda: jv.dot(None, UP), "dot: u must be numbers, got None"),
    "a table": (lambda: jv.dot({"x": UP}, UP), r"dot: u must be numbers, got \{'x': "),
    "nothing beside a plain number": (
        lambda: jv.gamma_decode([0.5], None),
        "gamma_decode: gamma must be numbers, got None",
    ),
    "complex numbers": (lambda: jv.dot([1j, 0, 0], UP), r"dot: u must be real, got \[1j, 0, 0\]"),
    "complex arrays": (lambda: jv.dot(np.full(3, 1j), UP), "dot: u must be real, got complex128"),
    "a number for a vector": (lambda: jv.norm(1.0), r"v must have shape \(\.\.\., 3\), got \(\)"),
    "nothing in a record": (lambda: jv.Lambert(None), "numbers are wanted, got None"),
    "words in a record": (lambda: jv.Sphere(UP, "one"), "numbers are wanted, got 'one'"),
    "no bands": (lambda: jv.Lambert([]), r"Lambert\.diffuse must have at least one band"),
    "colours that span a plane": (
        lambda: fit_colour_matrix(np.eye(3)[[0, 1, 0, 1]], np.ones((4, 3))),
        "camera must span 3 dimensions",
    ),
    "colours that are not finite": (
        lambda: fit_colour_matrix(np.eye(3), np.full((3, 3), np.nan)),
        "wanted must be finite",
    ),
    "ragged lists": (lambda: jv.dot([1, [2, 3]], UP), "dot: u must be numbers"),
    "nanometres": (
        lambda: airy_radius(550, 4),
        "airy_radius: wavelength is in metres, got 550; 550 nm are 550e-9",
    ),
    "nanometres of a table": (
        lambda: jv.colour_spaces.illuminant("D65", [400.0, 700.0]),
        "wavelength is in metres, got 700; 550 nm are 550e-9",
    ),
    "nanometres of a camera": (
        lambda: jv.read_camera("consumer_bayer", wavelengths=[610.0, 550.0, 465.0]),
        "read_camera: wavelength is in metres, got 610",
    ),
    "nanometres of photons": (
        lambda: jv.PhotonConversion(wavelength=550, pixel_area=25e-12),
        "PhotonConversion.wavelength is in metres, got 550",
    ),
    "square micrometres": (
        lambda: jv.PhotonConversion(wavelength=550e-9, pixel_area=25),
        r"PhotonConversion.pixel_area is in m\^2, got 25",
    ),
    "micrometres of a pixel": (
        lambda: jv.Pinhole(UP, np.eye(3), 0.016, 6.45, resolution=(2, 2)),
        r"Pinhole.pixel_pitch must be in m \(5 um are 5e-6\), got 6.45",
    ),
    "micrometres": (lambda: airy_radius(0.55, 4), "wavelength is in metres, got 0.55"),
    "a cosine for its logarithm": (
        lambda: jv.phong_lobe(0.5, 30),
        "phong_lobe: log_cos_mirror must be at most 0, got 0.5",
    ),
    "pictures as sequences": (
        lambda: cross_dissolve(jnp.ones((3, 2, 3)), jnp.zeros((3, 2, 3))),
        "blend mixes two still pictures",
    ),
    "codes as fractions": (
        lambda: equalise(np.linspace(0, 255, 400).reshape(20, 20)),
        "counted in .0, 1., got values up to 255; divide codes by the largest one",
    ),
    "codes counted as fractions": (
        lambda: exact_histogram(np.linspace(0, 255, 400).reshape(20, 20)),
        "got values up to 255",
    ),
    "negative light": (
        lambda: jv.PointLight(UP, [-4.0]),
        "PointLight.intensity must be at least 0, got -4.0",
    ),
    "negative albedo": (lambda: jv.Lambert([-0.1]), "Lambert.diffuse must be at least 0"),
    "negative exponent": (
        lambda: jv.Phong([0.1], [0.2], -3.0),
        "Phong.exponent must be at least 0, got -3.0",
    ),
    "no normal": (lambda: jv.Plane(UP, [0.0, 0.0, 0.0]), "Plane.normal must have a direction"),
    "no normal of a disc": (lambda: jv.Disc(UP, [0, 0, 0], 1.0), "Disc.normal must have"),
    "millimetres": (
        lambda: jv.ThinLens(UP, np.eye(3), 50.0, 5e-6, resolution=(2, 2), f_number=2.0),
        r"focal_length must be in m \(50 mm are 0.05\), got 50",
    ),
    "millimetres before a hole": (
        lambda: jv.Pinhole(UP, np.eye(3), 8.0, 3.45e-6, resolution=(2, 2)),
        "Pinhole.focal_length must be in m",
    ),
    "a negative f-number": (
        lambda: airy_radius(550e-9, -4),
        r"airy_radius: f_number must be at least 0, got -4\.0",
    ),
    "a negative f-number of a far focus": (
        lambda: jv.hyperfocal_distance(0.05, -8.0, 3e-5),
        r"hyperfocal_distance: f_number must be at least 0, got -8\.0",
    ),
    "a focus behind the lens": (
        lambda: jv.circle_of_confusion(jnp.ones(2), -2.0, 0.05, 2.0),
        "circle_of_confusion: focus_distance must be at least 0",
    ),
    "sharpness behind the lens": (
        lambda: jv.depth_of_field(-1.0, 0.05, 8.0, 3e-5),
        "depth_of_field: focus_distance must be at least 0",
    ),
    "colder than nothing": (
        lambda: jv.spectra.blackbody([5e-7], -3.0),
        "blackbody: temperature must be at least 0, got -3.0",
    ),
    "no gamma": (lambda: jv.gamma_encode([0.5], 0), "gamma_encode: gamma must be above 0, got 0"),
    "a negative gamma": (
        lambda: jv.gamma_decode(jnp.full((2, 1), 0.5), [2.2, -2.2]),
        "gamma_decode: gamma must be above 0, got -2.2",
    ),
    "a curve bent the other way": (
        lambda: jv.point_ops.log_curve([0.5], -0.5),
        "log_curve: strength must be at least 0",
    ),
    "a key of 0": (
        lambda: jv.point_ops.scaled_to_key(np.ones((2, 2)), key_value=0.0),
        "scaled_to_key: key_value must be above 0",
    ),
    "a quantile in percent": (
        lambda: jv.histogram.quantile(jv.histogram.exact_histogram(np.eye(2)), 50.0),
        "quantile: q must be finite, at least 0 and at most 1, got 50.0",
    ),
    "a filter of negative width": (
        lambda: jv.point_ops.graded_filter(np.ones((2, 2, 1)), 0.3, 0.0, 0.0, -1.0),
        "graded_filter: width must be at least 0",
    ),
    "a lamp without an edge": (
        lambda: jv.RectangleLight(UP, [0, 0, 0], [1, 0, 0], [1.0]),
        "RectangleLight.edge_u must have a direction",
    ),
    "a picture without pixels": (
        lambda: jv.development.grey_world_gains(np.ones((0, 3, 3))),
        "with at least one pixel, got shape .0, 3, 3.",
    ),
    "a norm that is none": (
        lambda: jv.development.grey_world_gains(np.ones((2, 2, 3)), norm=0.5),
        "grey_world_gains: norm must be at least 1, got 0.5",
    ),
    "a ray of two lengths": (
        lambda: jv.Ray(UP, [0, 0, 2.0]),
        "Ray.direction must be a unit vector, got one of length 2",
    ),
    "an angle of vectors": (
        lambda: jv.angle_between([1.0, 0, 0], [2.0, 2, 0]),
        r"angle_between: v must be a unit vector, got one of length 2\.828",
    ),
    "a mirror's normal twice as long": (
        lambda: jv.mirror_direction([0, 0, 2.0], UP),
        "mirror_direction: normal must be a unit vector",
    ),
    "a cosine of 2": (
        lambda: fresnel_dielectric(2.0, [1.5]),
        "fresnel_dielectric: cos_theta must be .*at most 1.001, got 2",
    ),
    "an absorption that gives light": (
        lambda: fresnel_conductor(0.5, [1.0], [-3.0]),
        "fresnel_conductor: k must be at least 0, got -3",
    ),
    "a lamp that is a line": (
        lambda: jv.RectangleLight(UP, [1, 0, 0], [2, 0, 0], [1.0]),
        "RectangleLight.edge_u and edge_v are parallel",
    ),
    "a window upside down": (
        lambda: jv.sensor.censored(jv.Moments(jnp.zeros(()), jnp.ones(())), low=1.0, high=0.0),
        "censored: low must not be above high",
    ),
    "wavelengths from long to short": (
        lambda: jv.spectra.band_widths([6e-7, 5e-7, 4e-7]),
        "band_widths: wavelengths must ascend",
    ),
    "a table in nm": (
        lambda: jv.spectra.interpolate_spectrum([0.1, 0.2], [400.0, 500.0], [4.5e-7]),
        "interpolate_spectrum: known is in metres, got 500",
    ),
    "a picture beyond float32": (
        lambda: jv.write_image("never.exr", np.full((1, 1), 1e39)),
        "ends at 3.4e38",
    ),
    "a light field without a sample": (
        lambda: jv.LightFieldLight(np.ones((0, 1, 1, 1, 1)), WINDOW, WINDOW),
        "LightFieldLight.radiance must have at least one sample along each axis",
    ),
    "two pictures of two sizes": (
        lambda: jv.matting.triangulation_matte(
            *map(np.ones, [(4, 5, 3), (4, 5, 3), (4, 3), (4, 5, 3)])
        ),
        "triangulation_matte: both pictures must have one shape",
    ),
    "no receiver": (
        lambda: jv.adaptive_irradiance(LAMP, np.ones((0, 3)), np.array([0.0, 0, 1])),
        "points must hold at least one receiver",
    ),
    "a table that is not square": (
        lambda: jv.transport.radiosity.solve_radiosity(
            np.ones((2, 3)), np.ones((2, 1)), np.ones((2, 1))
        ),
        r"solve_radiosity: table must have shape \(2, 2\)",
    ),
    "negative radius": (lambda: jv.Sphere(UP, -1.0), "Sphere.radius must be at least 0"),
}


@pytest.mark.parametrize("misuse", SENTENCES)
def test_misuse_has_one_sentence(misuse):
    call, sentence = SENTENCES[misuse]
    with pytest.raises(ValueError, match=sentence):
        call()


def test_optional_arguments_without_their_names_are_named():
    with pytest.raises(TypeError, match=r"to_integers takes 1 of its .* place; write bits=8\."):
        jv.to_integers(np.ones(2), 8)  # pyright: ignore[reportCallIssue]


def test_traced_values_are_not_checked():
    """Inside a compiled function numbers are unknown, but shapes are known."""
    jax.eval_shape(lambda wo: jv.lambert_shading(wo, wo, jnp.ones(1)), jnp.full(3, 2.0))
    jax.eval_shape(lambda normal: jv.Plane(normal, normal), jnp.zeros(3))
    jax.eval_shape(lambda gamma: jv.gamma_decode(gamma, gamma), jnp.asarray(-1.0))
    jax.eval_shape(lambda f: jv.Pinhole(UP, np.eye(3), f, 1e-6, resolution=(2, 2)), 50.0)
    with pytest.raises(ValueError, match="normal must have shape"):
        jax.eval_shape(lambda wo: jv.lambert_shading(wo, wo, jnp.ones(1)), jnp.ones((2, 3)))


def test_half_precision_counts_and_sums_in_float32():
    """Half precision represents integers one by one up to 2048, and ends at 65504."""
    picture = jnp.linspace(0, 1, 4096).reshape(64, 64).astype(jnp.float16)
    as_single = picture.astype(jnp.float32)
    np.testing.assert_array_equal(equalise(picture), equalise(as_single))
    counted, expected = exact_histogram(picture, bins=16), exact_histogram(as_single, bins=16)
    np.testing.assert_array_equal(counted.edges, expected.edges)
    fractions = jv.histogram.cumulative_distribution(counted)
    np.testing.assert_array_equal(fractions, jv.histogram.cumulative_distribution(expected))
    np.testing.assert_array_equal(jv.to_integers(jnp.ones(2, jnp.float16) / 2, bits=16), 32768)
    whole = jv.filters.integral_image(jnp.ones((400, 400), jnp.float16))
    assert float(jv.filters.box_sum(whole, 398, 398, 400, 400)) == 4
    grey = jnp.ones((512, 512, 3), jnp.float16)
    assert jnp.all(jv.development.grey_world_gains(grey) == 1)


def test_a_misspelt_argument_names_the_nearest():
    for take in (jv.matting.over, jv.optics.airy_radius):
        with pytest.raises(TypeError, match="has no argument"):
            take(wrong=1.0)
    said = "airy_radius has no argument 'f_numer'; the nearest is 'f_number'."
    with pytest.raises(TypeError, match=said):
        jv.optics.airy_radius(550e-9, f_numer=4.0)
