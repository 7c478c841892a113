"""Derivatives of moving edges against closed forms: what a picture gains and loses at its edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxvision as jv

BLACK, GREY = jv.Lambert([0.0]), jv.Lambert([0.5 / np.pi])
DOWN = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
TURNED = np.array([[2, -1, 2], [2, 2, -1], [-1, 2, 2]]) / 3
FLOOR = jv.Surface(jv.Plane([0, 0, 0], [0, 0, 1]), GREY)
# below what casts shadows, so that the floor alone is seen
UNDER = jv.Orthographic([0, 0, 0.1], DOWN, 0.25, resolution=(40, 40))


@pytest.mark.slow
def test_each_pixel_gains_its_part_of_the_outline():
    """A disc of unit radiance whose radius grows: the length of its outline in each pixel."""

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
    assert set(np.unique(without)) == {0.0, 1.0}  # the value is that of one ray per pixel


@pytest.mark.slow
def test_a_sphere_that_nears_a_pinhole():
    """The image of a sphere on the axis is a disc of the radius f tan(arcsin(r / d))."""

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
    """A shadow under the light (0.6, 0, 0.8), which loses the radiance 0.5 / pi x 0.8."""

    def floor(size):
        shape = {
            "sphere": lambda: jv.Sphere([0, 0, 2], size),
            "disc": lambda: jv.Disc([0, 0, 2], [0, 0, 1], size),
            "quad": lambda: jv.Quad([0, 0, 2], size * jnp.array([1.0, 0, 0]), [0, 1, 0]),
            "box": lambda: jv.Box([0, 0, 2], size * jnp.ones(3), rotation=TURNED),
        }[kind]()
        scene = jv.Scene([FLOOR, jv.Surface(shape, BLACK)], jv.DirectionalLight([0.6, 0, 0.8], [1]))
        return jv.render(scene, UNDER, edges=jv.Edges()).sum() * 0.25**2

    area = {  # of the shadow of unit size: its power of the size
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
    """The floor loses what falls on the ball: pi L (r / d)^2 cos for each area of the lamp."""

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


def test_nothing_is_computed_where_no_edge_moves():
    """The derivative in the light of a lamp is that without edges, by the same program."""
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


NARROW = np.array([0.05, 0, 1]) / np.hypot(0.05, 1)  # direction of a quad's side toward the camera


@pytest.mark.slow
def test_a_narrow_face_needs_few_samples():
    """A quad seen at a grazing angle, 0.3 x 6 pixels in the picture, moves toward a lamp."""
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
def test_the_rim_of_a_small_ball():
    """Half of a Lambert ball, lit from the side, gives 2 / 3 of R^2 times its BRDF."""

    def total(radius):
        ball = jv.Surface(jv.Sphere([0.1, 0.2, 0], radius), jv.Lambert([1.0]))
        view = jv.Orthographic([0, 0, 9], DOWN, 0.5, resolution=(8, 8))
        samples = jv.PixelSamples(jax.random.key(1), 16)
        scene = jv.Scene(ball, jv.DirectionalLight([1, 0, 0], [1.0]))
        return jv.render(scene, view, samples=samples, edges=jv.Edges()).sum() * 0.5**2

    found = jax.jvp(total, (0.75,), (1.0,))[1]
    np.testing.assert_allclose(found, 2 * 0.75 * 2 / 3, rtol=1e-2)


@pytest.mark.slow
def test_a_disc_out_of_focus():
    """A lens spreads the image of a disc over 3 pixels more, and keeps its sum and its middle."""
    scale = 0.05 / (1 - 0.05 / 4) / 3 / 0.003  # pixels per metre at 3 m, in focus at 4 m

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
