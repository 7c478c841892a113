"""Tests derivatives of moving edges against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxvision as jv
from jaxvision.rendering import edges

BLACK, GREY = jv.Lambert([0.0]), jv.Lambert([0.5 / np.pi])
DOWN = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
TURNED = np.array([[2, -1, 2], [2, 2, -1], [-1, 2, 2]]) / 3
FLOOR = jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), GREY)
# below the occluders, so that only the floor is seen
UNDER = jv.Orthographic([0, 0, 0.1], DOWN, 0.25, resolution=(40, 40))


@pytest.mark.slow
def test_each_pixel_gets_its_part_of_the_outline():
    """The radius of a disc of unit radiance grows. The derivative is the length of its outline in
    each pixel."""

    def picture(radius):
        lamp = jv.Surface(jv.Disc([0.1, 0.2, 0], [0, 0, 1], radius), BLACK, [1.0])
        view = jv.Orthographic([0, 0, 5], DOWN, 0.5, resolution=(20, 20))
        return jv.render(jv.Scene(lamp, []), view, edges=jv.Edges(16))[..., 0]

    gains = jax.jacfwd(picture)(jnp.array(3.0))
    turn = 2 * np.pi * (np.arange(200_000) + 0.5) / 200_000
    row, column = (-0.2 - 3 * np.sin(turn)) / 0.5 + 10, (0.1 + 3 * np.cos(turn)) / 0.5 + 10
    lengths = np.histogram2d(row, column, bins=20, range=[[0, 20], [0, 20]])[0]
    lengths *= 2 * np.pi * 3 / 0.25 / len(turn)  # per area of a pixel
    np.testing.assert_allclose(gains, lengths, atol=0.02 * lengths.max())
    without = jax.jit(lambda radius: picture(radius))(jnp.array(3.0))
    assert set(np.unique(without)) == {0.0, 1.0}  # values are of one ray per pixel


@pytest.mark.slow
def test_a_sphere_that_approaches_a_pinhole():
    """The image of a sphere on the axis is a disc of radius f tan(arcsin(r / d))."""

    def area(distance):
        ball = jv.Surface(jv.Sphere(jnp.array([0, 0, 1.0]) * distance, 1.0), BLACK, [1.0])
        view = jv.Pinhole([0, 0, 0], np.eye(3), 1.0, 1 / 16, resolution=(32, 32))
        return jv.render(jv.Scene(ball, []), view, edges=jv.Edges()).sum() / 16**2

    def closed(distance):
        return np.pi / (distance**2 - 1)  # of tan^2

    expected = (closed(2 + 1e-6) - closed(2 - 1e-6)) / 2e-6
    np.testing.assert_allclose(jax.grad(area)(2.0), expected, rtol=2e-3)


@pytest.mark.slow
def test_a_box_from_straight_above():
    """The edges of its top hide those of its bottom."""

    def area(size):
        box = jv.Surface(jv.Box([0, 0, 1], size * jnp.ones(3)), BLACK, [1.0])
        view = jv.Orthographic([0, 0, 9], DOWN, 0.25, resolution=(20, 20))
        return jv.render(jv.Scene(box, []), view, edges=jv.Edges()).sum() * 0.25**2

    np.testing.assert_allclose(jax.grad(area)(0.9), 8 * 0.9, rtol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sphere", "disc", "quad", "box"])
def test_shadows_of_a_sun(kind):
    """Under a light from (0.6, 0, 0.8), the shadow loses the radiance 0.5 / pi x 0.8."""

    def floor(size):
        shape = {
            "sphere": lambda: jv.Sphere([0, 0, 2], size),
            "disc": lambda: jv.Disc([0, 0, 2], [0, 0, 1], size),
            "quad": lambda: jv.Quad([0, 0, 2], size * jnp.array([1.0, 0, 0]), [0, 1, 0]),
            "box": lambda: jv.Box([0, 0, 2], size * jnp.ones(3), rotation=TURNED),
        }[kind]()
        scene = jv.Scene([FLOOR, jv.Surface(shape, BLACK)], jv.DirectionalLight([0.6, 0, 0.8], [1]))
        return jv.render(scene, UNDER, edges=jv.Edges()).sum() * 0.25**2

    area = {  # area of the shadow of unit size, and its power of the size
        "sphere": (np.pi / 0.8, 2),
        "disc": (np.pi, 2),
        "quad": (1.0, 1),
        "box": (4 * np.abs(TURNED @ [0.6, 0, 0.8]).sum() / 0.8, 2),  # three faces of 4 m^2
    }[kind]
    expected = -area[0] * area[1] * 0.9 ** (area[1] - 1) * 0.8 * 0.5 / np.pi
    np.testing.assert_allclose(jax.grad(floor)(0.9), expected, rtol=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["radius", "height"])
def test_soft_shadow_of_a_ball(name):
    """The floor loses the light that falls on the ball: pi L (r / d)^2 cos for each area of the
    lamp."""

    def floor(value):
        size, height = (value, 2.0) if name == "radius" else (0.5, value)
        ball = jv.Surface(jv.Sphere(jnp.array([0, 0, 1.0]) * height, size), BLACK)
        lamp = jv.RectangleLight([-0.7, -0.7, 5], [0, 1.4, 0], [1.4, 0, 0], [1.0])
        clear = jv.render(jv.Scene([FLOOR], lamp), UNDER)
        seen = jv.render(jv.Scene([FLOOR, ball], lamp), UNDER, edges=jv.Edges())
        return (seen - clear).sum() * 0.25**2

    x, weight = np.polynomial.legendre.leggauss(32)

    def closed(value):
        size, height = (value, 2.0) if name == "radius" else (0.5, value)
        square = 0.7**2 * (x[:, None] ** 2 + x**2) + (5 - height) ** 2
        share = size**2 * (5 - height) / square**1.5
        return -0.5 * 0.7**2 * (weight[:, None] * weight * share).sum()

    at = {"radius": 0.5, "height": 2.0}[name]
    expected = (closed(at + 1e-5) - closed(at - 1e-5)) / 2e-5
    np.testing.assert_allclose(jax.grad(floor)(at), expected, rtol=1e-2)


def test_nothing_is_computed_if_no_edge_moves():
    """The derivative by the intensity of a lamp equals that without edges, in the same program."""
    ball = jv.Surface(jv.Sphere([0, 0, 2], 0.5), GREY)

    def total(light, **given):
        scene = jv.Scene([FLOOR, ball], jv.PointLight([0, 0, 5], light))
        return jv.render(scene, UNDER, **given).sum()

    light = jnp.array([1.0])
    plain, more = (
        jax.jit(jax.grad(lambda light, e=e: total(light, edges=e))).lower(light).compile()
        for e in (None, jv.Edges())
    )
    assert more.cost_analysis()["flops"] == plain.cost_analysis()["flops"] > 0


def test_a_moving_side_of_a_rectangle_gives_its_swept_area():
    """The side at column 2 + x of rows 0.5 to 2.5 moves by 1, with a jump of 3."""
    view = jv.Orthographic([0, 0, 5], DOWN, 1.0, resolution=(4, 5))
    middles = (np.arange(40) + 0.5) / 40 * 2
    place = np.float32(np.stack([0.5 + middles, np.full(40, 2.2)], axis=1))
    along, across, jump = (np.float32([v] * 40) for v in ([2 / 40, 0], [0, 1], [-3, 1]))
    gained, contrast = jax.jit(edges._integral)(view, place, along, across, np.ones(40, bool), jump)
    expected = np.zeros((4, 5))
    expected[1:3, 2] = 1.0
    np.testing.assert_allclose(gained[..., 0], -3 * expected, atol=1e-5)  # 160 sums
    np.testing.assert_allclose(gained[..., 1], expected, atol=1e-5)  # 160 sums
    np.testing.assert_allclose(contrast, 3 * expected, atol=1e-5)  # 160 sums


@pytest.mark.parametrize("distance", [3.0, np.inf])
def test_the_rim_of_a_sphere_is_a_zone(distance):
    """By Archimedes, the area between two heights along the axis to the eye is 2 pi R times their
    difference. At these heights the cosine of the view angle is 0 and the limit."""
    radius, limit = 0.8, 0.4
    ball = edges._faces(jv.Scene(jv.Surface(jv.Sphere([1, 2, 3], radius), GREY), []))
    axis = np.array([2.0, -1, 2]) / 3
    near = np.isfinite(distance)
    place = jnp.array([1, 2, 3] + distance * axis if near else axis)
    eye = edges.Eye(place, at_infinity=not near)

    def area(at):
        slope = jax.jacfwd(lambda at: edges._face_point(edges._row(ball, 0), at, eye, limit))(at)
        return jnp.linalg.norm(jnp.cross(*slope.T))

    grid = (np.arange(20) + 0.5) / 20
    at = jnp.asarray(np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2))
    found = jax.jit(lambda at: jax.vmap(area)(at).mean())(at)

    def cosine_of_view(height):  # by the cosine rule
        if not near:
            return height / radius
        way = np.sqrt(distance**2 + radius**2 - 2 * distance * height)
        return (distance * height - radius**2) / (radius * way)

    ends = [brentq(lambda z, c=c: cosine_of_view(z) - c, -radius, radius) for c in (0, limit)]
    np.testing.assert_allclose(found, 2 * np.pi * radius * (ends[1] - ends[0]), rtol=1e-4)


def test_more_samples_are_used_in_pixels_with_edges():
    """The derivative of a chosen pixel is the mean of five groups of samples, whatever the first
    group is."""
    rng = np.random.default_rng(3)
    slopes, contrast = rng.normal(size=(5, 5, 6, 2)), rng.uniform(size=(5, 6))
    samples = jv.PixelSamples(jax.random.key(0), 4)

    def pixels(theta, _view, place, samples, first):
        return theta * jnp.asarray(slopes)[first // samples.count][place]

    @jax.jit
    def gained(theta, contrast):
        again = lambda theta: (theta, None)  # noqa: E731
        return edges._sample_edge_pixels(again, theta, 1.0, pixels, samples, contrast)

    gain = gained(1.0, contrast)
    chosen = contrast >= np.sort(contrast.ravel())[-22]  # as many as border pixels
    expected = np.where(chosen[..., None], slopes.mean(0) - slopes[0], 0)
    np.testing.assert_allclose(gain, expected, atol=1e-6)


NARROW = np.array([0.05, 0, 1]) / np.hypot(0.05, 1)  # direction of a quad's side toward the camera


@pytest.mark.slow
def test_a_narrow_face_needs_few_samples():
    """A quad at a grazing angle, 0.3 x 6 pixels in the picture, moves toward a lamp."""
    corner, along = np.array([0.03, -1.5, -1.5]), np.array([0, 3.0, 0])

    def total(height):
        moved = corner + height * jnp.array([0.0, 0.0, 1.0])
        face = jv.Surface(jv.Quad(moved, along, 3 * NARROW), jv.Lambert([1.0]), two_sided=True)
        view = jv.Orthographic([0, 0, 9], DOWN, 0.5, resolution=(12, 12))
        samples = jv.PixelSamples(jax.random.key(0), 4)
        scene = jv.Scene(face, jv.PointLight([-3, 1, 2], [1.0]))
        return jv.render(scene, view, samples=samples, edges=jv.Edges()).sum() * 0.5**2

    x, weight = np.polynomial.legendre.leggauss(40)
    normal = np.cross(along / 3, NARROW)

    def closed(height):
        s, t = ((side + 1) / 2 for side in np.meshgrid(x, x))
        point = corner + height * np.array([0, 0, 1]) + s[..., None] * along
        way = np.array([-3, 1, 2]) - point - 3 * t[..., None] * NARROW
        light = np.abs(way @ normal) / (way**2).sum(-1) ** 1.5
        return np.sum(weight * weight[:, None] / 4 * light) * 9 * abs(normal[2])

    found = jax.jvp(total, (0.0,), (1.0,))[1]
    np.testing.assert_allclose(found, (closed(1e-4) - closed(-1e-4)) / 2e-4, rtol=1e-2)


@pytest.mark.slow
def test_the_outline_of_a_small_ball():
    """Half of a Lambertian ball, lit from the side, gives 2 / 3 of R^2 times its BRDF."""

    def total(radius):
        ball = jv.Surface(jv.Sphere([0.1, 0.2, 0], radius), jv.Lambert([1.0]))
        view = jv.Orthographic([0, 0, 9], DOWN, 0.5, resolution=(8, 8))
        samples = jv.PixelSamples(jax.random.key(1), 16)
        scene = jv.Scene(ball, jv.DirectionalLight([1, 0, 0], [1.0]))
        return jv.render(scene, view, samples=samples, edges=jv.Edges()).sum() * 0.5**2

    found = jax.jvp(total, (0.75,), (1.0,))[1]
    np.testing.assert_allclose(found, 2 * 0.75 * 2 / 3, rtol=1e-2)


@pytest.mark.slow
def test_further_samples_add_no_bias():
    """The mean is over 200 derivatives of the light from half of a Lambertian ball."""

    def total(radius, key):
        ball = jv.Surface(jv.Sphere([0.1, 0.2, 0], radius), jv.Lambert([1.0]))
        view = jv.Orthographic([0, 0, 9], DOWN, 0.25, resolution=(16, 16))
        scene = jv.Scene(ball, jv.DirectionalLight([1, 0, 0], [1.0]))
        samples = jv.PixelSamples(key, 4)
        return jv.render(scene, view, samples=samples, edges=jv.Edges()).sum() * 0.25**2

    def derivative(key):
        return jax.jvp(lambda radius: total(radius, key), (0.75,), (1.0,))[1]

    keys = jax.random.split(jax.random.key(0), 200)
    found = jax.jit(lambda keys: jax.lax.map(derivative, keys, batch_size=8))(keys)
    error = np.std(found) / np.sqrt(200)
    assert error < 1e-3
    assert abs(np.mean(found) - 2 * 0.75 * 2 / 3) < 4 * error


@pytest.mark.slow
def test_a_disc_out_of_focus():
    """A lens blurs the image of a disc over 3 more pixels, with the same sum and centre."""
    scale = 0.05 / (1 - 0.05 / 4) / 3 / 0.003  # pixels per metre at 3 m, focused at 4 m

    def moments(disc):
        radius, across = disc
        place = jnp.stack([across, jnp.asarray(0.05), jnp.asarray(3.0)])
        lamp = jv.Surface(jv.Disc(place, [0, 0, -1], radius), BLACK, [1.0])
        own = {"resolution": (32, 32), "f_number": 0.025, "focus_distance": 4.0}
        view = jv.ThinLens([0, 0, 0], np.eye(3), 0.05, 0.003, **own)
        samples = jv.PixelSamples(jax.random.key(0), 16)
        seen = jv.render(jv.Scene(lamp, []), view, samples=samples, edges=jv.Edges(32))[..., 0]
        return jnp.stack([seen.sum(), seen.sum(0) @ jnp.arange(-15.5, 16)])

    own = jnp.array([1.0, 0.1])
    found = jax.jit(jax.jacrev(moments))(own)
    area = np.pi * scale**2
    middle = scale * 0.1
    expected = [[2 * area, 0], [2 * area * middle, area * scale]]
    np.testing.assert_allclose(found, expected, atol=0.01 * area * scale)
