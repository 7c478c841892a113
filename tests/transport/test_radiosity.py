"""Radiosity against closed rooms with known answers, Monte Carlo in NumPy, and finite
differences."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import loops

import jaxvision as jv
from jaxvision.lights import MonteCarlo
from jaxvision.scene import Box, Disc, Plane, Quad, Sphere, TriangleMesh
from jaxvision.transport.radiosity import (
    Plan,
    Solution,
    ambient_estimate,
    bounce,
    closure_error,
    exchanged,
    form_factor_table,
    parallel_rectangles,
    patch_means,
    patches_of,
    plan_patches,
    radiosity,
    radiosity_along,
    radiosity_image,
    reciprocity_error,
    shoot,
    solve_radiosity,
)
from jaxvision.transport.radiosity._receivers import receivers_of
from jaxvision.transport.radiosity._sources import shapes_of
from jaxvision.transport.radiosity._trapped import trapping_surface

GREY = jv.Lambert([0.5 / np.pi])


def room(materials, *, emission=None, furniture=(), lights=()):
    """Return the unit cube seen from inside, with walls in pairs: low and high x, y, z."""
    axes = np.eye(3)
    surfaces = []
    for k in range(3):
        u, v = axes[(k + 1) % 3], axes[(k + 2) % 3]
        surfaces += [Quad(np.zeros(3), u, v), Quad(axes[k], v, u)]
    glow = emission or {}
    walls = [
        jv.Surface(quad, material, glow.get(i))
        for i, (quad, material) in enumerate(zip(surfaces, materials, strict=True))
    ]
    return jv.Scene([*walls, *furniture], lights)


def solved(scene, plan, **options):
    return jax.jit(lambda scene: radiosity(scene, plan, **options))(scene)


# ------------------------------------------------ patches

SHAPES = {
    "quad": (Quad([1, 2, 3], [2, 0, 0], [0, 0.5, 0.5]), 2 * np.sqrt(0.5), 1e-12),
    "box": (Box([0, 0, 0], [0.5, 1, 1.5]), 22.0, 1e-12),
    "disc": (Disc([0, 1, 0], [0, 0.6, 0.8], 2.0), 4 * np.pi, 0.03),
    "sphere": (Sphere([0, 1, 0], 2.0), 16 * np.pi, 0.03),
    "mesh": (TriangleMesh(np.eye(3), np.array([[0, 1, 2]])), np.sqrt(3) / 2, 1e-12),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_patches_cover_their_shape(name):
    """The areas of the patches sum to the area of the shape, or to less where it is curved."""
    shape, area, missing = SHAPES[name]
    scene = jv.Scene([jv.Surface(shape, GREY)], [])
    plan = plan_patches(scene, size=0.5, split=2, graded=True)
    patches = jax.jit(lambda scene: patches_of(scene, plan))(scene)
    elements = jax.jit(lambda scene: patches_of(scene, plan, split=2))(scene)
    np.testing.assert_allclose(patches.area.sum(), area, rtol=missing)
    assert patches.area.sum() <= area * (1 + 1e-12)
    np.testing.assert_allclose(elements.area.sum(), patches.area.sum(), rtol=1e-12)
    places = jnp.stack([elements.centre.x, elements.centre.y, elements.centre.z], axis=-1)
    back = patch_means(places, elements, plan)  # elements lie where their patches do
    np.testing.assert_allclose(back[:, 0], patches.centre.x, atol=1e-12)
    np.testing.assert_allclose(back[:, 2], patches.centre.z, atol=1e-12)
    if name in ("box", "sphere"):
        for component in (patches.normal.x, patches.normal.y, patches.normal.z):
            assert abs((patches.area * component).sum()) < 1e-12 * area


def test_two_sided_surfaces_have_two_sides():
    one = jv.Scene([jv.Surface(Sphere([0, 0, 0], 1.0), GREY)], [])
    both = jv.Scene([jv.Surface(Sphere([0, 0, 0], 1.0), GREY, two_sided=True)], [])
    count = len(plan_patches(one, size=0.5).faces)
    plan = plan_patches(both, size=0.5)
    assert len(plan.faces) == 2 * count
    patches = jax.jit(lambda scene: patches_of(scene, plan))(both)
    outward = patches.normal.x * patches.centre.x + patches.normal.y * patches.centre.y
    outward = outward + patches.normal.z * patches.centre.z
    half = len(outward) // 2
    assert (outward[:half] > 0).all() & (outward[half:] < 0).all()


# ------------------------------------------------ form factors of scenes


@pytest.mark.slow
def test_factors_of_a_closed_room_sum_to_one_and_are_reciprocal():
    scene = room([GREY] * 6)
    plan = plan_patches(scene, size=0.34, split=2)
    table = jax.jit(lambda scene: form_factor_table(scene, plan))(scene)
    elements, patches = jax.jit(
        lambda scene: (patches_of(scene, plan, split=2), patches_of(scene, plan))
    )(scene)
    assert jnp.abs(closure_error(table)).max() < 2e-5  # far nodes miss .03 / 5^4 of few factors
    exchange = reciprocity_error(patch_means(table, elements, plan), patches.area)
    assert jnp.abs(exchange).max() < 0.02 * (patches.area[0] * table.max())


@pytest.mark.slow
@pytest.mark.parametrize(("width", "low", "high"), [(1.0, 0.0, 0.0), (0.5, 0.45, 0.55)])
def test_screens_block_form_factors(width, low, high):
    """A screen across the whole room blocks all light between floor and lid of x; half a screen, by
    symmetry, half."""
    screen = jv.Surface(Quad([0.5, 0, 0], [0, width, 0], [0, 0, 1]), GREY, two_sided=True)
    scene = room([GREY] * 6, furniture=[screen])
    plan = plan_patches(scene, size=0.5, split=2)
    table = jax.jit(lambda scene: form_factor_table(scene, plan, rays=4))(scene)
    clear = parallel_rectangles(*(jnp.asarray(1.0) for _ in range(3)))
    through = table[:16, 4:8].sum(axis=1).mean() / clear  # from floor to lid of x
    assert low <= through <= high


ROOM = room([GREY] * 6)


@pytest.mark.slow
def test_boxes_cover_part_of_an_element():
    """A box over the quarter x < .5, y < .5 of a floor of one element covers that part of its
    area."""
    floor = jv.Surface(Quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), GREY)
    for side, area, place in ((0.25, 0.75, 0.75), (0.3, 0.75, 0.75), (0.6, 0.0, 0.5)):
        box = jv.Surface(Box([side, side, 0.3], [side, side, 0.3]), GREY)
        scene = jv.Scene([floor, box], [])
        plan = plan_patches(scene, size=2.0, split=1)
        elements = jax.jit(
            lambda scene, plan=plan: receivers_of(scene, plan, shapes_of(scene)).elements
        )(scene)
        np.testing.assert_allclose(elements.area[0], area, rtol=1e-12)
        np.testing.assert_allclose([elements.centre.x[0], elements.centre.y[0]], place, rtol=1e-12)


@pytest.mark.slow
def test_elements_under_a_box_are_covered_in_float32():
    """With areas that are no round numbers, rounding leaves no uncovered remainder under the
    box."""
    floor = jv.Surface(Quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), GREY)
    box = jv.Surface(Box([0.7, 0.6, 0.1], [0.1, 0.1, 0.1]), GREY)
    scene = jv.as_dtype(jv.Scene([floor, box], []), jnp.float32)
    plan = plan_patches(scene, size=0.15, split=2)
    elements = jax.jit(lambda scene: receivers_of(scene, plan, shapes_of(scene)).elements)(scene)
    x, y, area = (
        np.asarray(v)[:196] for v in (elements.centre.x, elements.centre.y, elements.area)
    )
    np.testing.assert_allclose(area.sum(), 1 - 0.2 * 0.2, atol=0.02)
    hidden = (abs(x - 0.7) < 0.09) & (abs(y - 0.6) < 0.09)
    assert hidden.any()
    assert (area[hidden] == 0).all()
    assert (x + y > 0.07).all()  # none has its place at the origin


@pytest.mark.slow
def test_a_half_shaded_element_is_half_as_bright():
    """Under vertical light, a screen over the half x > .5 of the unit floor halves its
    radiosity."""
    floor = jv.Surface(Quad([0, 0, 0], [1, 0, 0], [0, 1, 0]), GREY)
    screen = jv.Surface(Quad([0.5, 0, 0.5], [0.5, 0, 0], [0, 1, 0]), GREY, two_sided=True)
    scene = jv.Scene([floor, screen], [jv.DirectionalLight([0, 0, 1.0], [2.0])])
    plan = plan_patches(scene, size=2.0, split=1)
    black = jnp.zeros((3, 3))  # no light but the lamp's
    solution = jax.jit(lambda scene: radiosity(scene, plan, table=black))(scene)
    np.testing.assert_allclose(solution.radiosity[0], 0.5 * 0.5 * 2.0, rtol=1e-12)


# ------------------------------------------------ radiosity


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("method", ["direct", "iterative", "progressive"])
def test_radiance_in_a_closed_sphere(method):
    """With albedo .5 and emission .5, radiance is 1 everywhere (pbrt-v4, integrators_test.cpp)."""
    ball = jv.Surface(Sphere([0.2, 0, 0], 2.0), GREY, [0.5], two_sided=True)
    scene = jv.Scene([ball], [])
    plan = plan_patches(scene, size=1.2, split=1)
    solution = solved(scene, plan, method=method)
    inside = len(solution.radiosity) // 2
    error = jnp.abs(solution.radiosity[inside:] / np.pi - 1).max()
    assert error < (2e-3 if method == "progressive" else 1e-3)
    np.testing.assert_allclose(solution.radiosity[:inside], 0.5 * np.pi, rtol=1e-6)  # sees nothing


def monte_carlo(albedos, lit, count, depth):
    """Return the light leaving each wall of the unit cube, by wall number."""
    rng = np.random.default_rng(5)
    place = rng.uniform(size=(count, 3)) * [lit, lit, 0] + [0, 0, 1]
    wall = np.full(count, 5)
    power = np.full(count, np.pi * lit * lit / count)  # of radiance 1
    left = np.zeros(6)
    for _ in range(depth):
        axis, side = wall // 2, wall % 2
        u, v = rng.uniform(size=(2, count))
        local = np.stack(
            [
                np.sqrt(1 - u),
                np.sqrt(u) * np.cos(2 * np.pi * v),
                np.sqrt(u) * np.sin(2 * np.pi * v),
            ],
            axis=-1,
        )
        direction = np.empty((count, 3))
        for k in range(3):
            direction[np.arange(count), (axis + k) % 3] = local[:, k]
        direction[np.arange(count), axis] *= np.where(side == 1, -1, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.where(direction > 0, (1 - place) / direction, -place / direction)
        distance[np.arange(count), axis] = np.where(
            side == 1, place[np.arange(count), axis], 1 - place[np.arange(count), axis]
        ) / np.abs(direction[np.arange(count), axis])
        axis = np.nanargmin(distance, axis=1)
        place = np.clip(place + direction * distance[np.arange(count), axis][:, None], 0, 1)
        wall = 2 * axis + (direction[np.arange(count), axis] > 0)
        power = power * np.array(albedos)[wall]
        left += np.bincount(wall, power, minlength=6)
    return left


@pytest.mark.slow
def test_lamp_in_a_room_of_different_walls_against_monte_carlo():
    """A lamp over a quarter of the ceiling, which touches two walls, lights the room as Monte Carlo
    in NumPy says."""
    albedos = [0.8, 0.2, 0.5, 0.6, 0.7, 0.4]
    lamp = jv.RectangleLight([0, 0, 1 - 1e-6], [0, 0.5, 0], [0.5, 0, 0], [1.0])
    scene = room([jv.Lambert([rho / np.pi]) for rho in albedos], lights=[lamp])
    plan = plan_patches(scene, size=0.17, split=2, graded=True)
    solution = solved(scene, plan)
    area = jax.jit(lambda scene: patches_of(scene, plan).area)(scene)
    means = (solution.radiosity[:, 0] * area).reshape(6, -1).sum(axis=1)
    np.testing.assert_allclose(means, monte_carlo(albedos, 0.5, 400_000, 30), rtol=0.012)


# ------------------------------------------------ solvers

RNG = np.random.default_rng(0)
TABLE = jnp.asarray(RNG.uniform(size=(20, 20)) / 20)
ALBEDO, SENT = jnp.asarray(RNG.uniform(0.1, 0.9, (20, 3))), jnp.asarray(RNG.uniform(size=(20, 3)))


def exact_solution():
    bands = [
        np.linalg.solve(np.eye(20) - np.asarray(ALBEDO)[:, k, None] * np.asarray(TABLE), SENT[:, k])
        for k in range(3)
    ]
    return np.stack(bands, axis=1)


@pytest.mark.sweep("progressive")
@pytest.mark.parametrize("method", ["direct", "iterative", "progressive"])
def test_solvers_and_their_gradients(method):
    """Values agree with NumPy, and gradients by table, albedo and sent light with finite
    differences."""
    weights = jnp.asarray(np.random.default_rng(1).normal(size=(20, 3)))

    def total(*arguments):
        return (weights * solve_radiosity(*arguments, method=method, tolerance=1e-9)).sum()

    arguments = TABLE, ALBEDO, SENT
    got = jax.jit(partial(solve_radiosity, method=method, tolerance=1e-9))(*arguments)
    np.testing.assert_allclose(got, exact_solution(), rtol=1e-7)
    pulled = jax.jit(jax.grad(total, argnums=(0, 1, 2)))(*arguments)
    step = 1e-5
    compiled = jax.jit(total)
    for i in range(3):
        way = np.cos(np.arange(arguments[i].size)).reshape(arguments[i].shape)
        ends = [
            compiled(*(x + s * step * way if j == i else x for j, x in enumerate(arguments)))
            for s in (-1, 1)
        ]
        np.testing.assert_allclose(
            (pulled[i] * way).sum(), (ends[1] - ends[0]) / (2 * step), rtol=1e-5
        )


SHELF = jv.Surface(Quad([0.2, 0.3, 0.4], [0.5, 0, 0], [0, 0.4, 0.1]), GREY)


@pytest.mark.slow
def test_exchange_without_a_table_matches_the_table():
    """150 patches are two tiles, one of which is padded; any choice of rows gives the same numbers
    as the table."""
    scene, some = room([GREY] * 6, furniture=[SHELF]), jnp.array([3, 149, 60])
    plan = plan_patches(scene, size=0.2, split=1)
    sent = jnp.asarray(
        np.random.default_rng(0).uniform(size=(len(patches_of(scene, plan).area), 2))
    )
    table, whole = jax.jit(
        lambda scene: (form_factor_table(scene, plan), exchanged(scene, plan, sent))
    )(scene)
    assert 128 < len(sent) < 256
    np.testing.assert_allclose(whole, np.asarray(table) @ np.asarray(sent), rtol=1e-12)
    found = jax.jit(lambda scene: exchanged(scene, plan, sent, elements=some))(scene)
    np.testing.assert_allclose(found, whole[some], rtol=1e-13)
    with pytest.raises(ValueError, match="'direct' needs a table"):
        solve_radiosity(lambda sent: 0 * sent, 0 * sent, sent)


@pytest.mark.slow
def test_radiosity_without_a_table():
    """In a closed room whose walls have albedo 1/2 and emit radiance 1/2, the radiance is 1."""

    def total(scene, plan, method):
        table = partial(exchanged, scene, plan) if method == "iterative" else None
        return radiosity(scene, plan, table=table, method=method)

    glow = dict.fromkeys(range(6), jnp.asarray([0.5]))
    closed = room([GREY] * 6, emission=glow)
    plan = plan_patches(closed, size=0.34, split=2)
    found = jax.jit(partial(total, plan=plan, method="iterative"))(closed)
    np.testing.assert_allclose(found.radiosity, np.pi, rtol=0.03)
    furnished = room([GREY] * 6, emission={1: jnp.asarray([3.0])}, furniture=[SHELF])
    plan = plan_patches(furnished, size=0.34, split=2)
    exact, found = (
        jax.jit(partial(total, plan=plan, method=method))(furnished)
        for method in ("direct", "iterative")
    )
    np.testing.assert_allclose(found.radiosity, exact.radiosity, rtol=1e-3)
    np.testing.assert_allclose(found.sent, exact.sent, rtol=1e-3)


@pytest.mark.slow
def test_radiosity_without_a_table_has_the_gradients_of_the_table():
    """The gradients by albedo, emission and geometry, from the transposed equation, agree with
    those of the table."""
    scene = room([GREY] * 6, emission={1: jnp.asarray([3.0])}, furniture=[SHELF])
    plan = plan_patches(scene, size=0.2, split=1)

    def mean(scene, table):
        return radiosity(
            scene, plan, table=table and partial(table, scene, plan), method="iterative"
        ).radiosity.mean()

    exact, found = (
        jax.tree.leaves(jax.jit(jax.grad(partial(mean, table=table), allow_int=True))(scene))
        for table in (None, exchanged)
    )
    slopes = [(a, b) for a, b in zip(exact, found, strict=True) if a.dtype == jnp.float64]
    assert max(float(jnp.abs(a).max()) for a, _ in slopes) > 1
    for a, b in slopes:
        np.testing.assert_allclose(b, a, rtol=0, atol=1e-3)


@cache
def cube_table():
    """Return the form factors between the elements and patches of `ROOM` as divided by `PLAN`."""
    return jax.jit(lambda scene: form_factor_table(scene, PLAN))(ROOM)


def closed_room(rho):
    """Return the cube's mean table, its albedo, and the light that a few bright patches send."""
    table = patch_means(cube_table(), patches_of(ROOM, PLAN, split=2), PLAN)
    sent = rho * jnp.asarray(np.random.default_rng(2).uniform(size=(len(table), 1)) ** 8)
    return table, jnp.full_like(sent, rho), sent


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "rho", "dtype", "bound"),
    [
        ("progressive", 0.9, jnp.float32, 2e-4),
        ("progressive", 0.999, jnp.float64, 1e-4),
        ("iterative", 0.999, jnp.float32, 3e-4),
        ("direct", 0.999, jnp.float32, 3e-4),
    ],
)
def test_solvers_at_high_albedo(method, rho, dtype, bound):
    """In a closed room of high albedo, the error is within the stated part of the brightest patch,
    against NumPy in float64."""
    table, albedo, sent = jv.as_dtype(closed_room(rho), dtype)
    truth = np.linalg.solve(
        np.eye(len(table)) - np.asarray(albedo, float) * np.asarray(table, float),
        np.asarray(sent, float),
    )
    got = jax.jit(partial(solve_radiosity, method=method))(table, albedo, sent)
    assert got.dtype == dtype
    assert np.abs(np.asarray(got) - truth).max() < bound * truth.max()


@pytest.mark.sweep
@pytest.mark.parametrize("method", ["direct", "iterative", "progressive"])
def test_a_white_closed_room_with_light_has_no_equilibrium(method):
    """A white cube, by the form factors of Howell's C-11, has no solution with light; its second
    band has a grey wall and has one."""
    opposite = 0.1998249
    table = np.full((6, 6), (1 - opposite) / 4, np.float32)
    table[np.arange(6), np.arange(6)] = 0
    table[np.arange(6), np.arange(6) ^ 1] = opposite
    albedo = np.ones((6, 3), np.float32)
    albedo[5, 1] = 0.5
    sent = np.zeros((6, 3), np.float32)
    sent[0, :2] = 1
    found = solve_radiosity(table, albedo, sent, method=method)
    assert np.isinf(found[:, 0]).all()
    assert (found[:, 2] == 0).all()  # white, without light
    grey = np.linalg.solve(np.eye(6) - albedo[:, 1:2].astype(float) * table, sent[:, 1])
    np.testing.assert_allclose(found[:, 1], grey, rtol=2e-3)


@pytest.mark.slow
def test_too_few_shots_leave_the_stated_remainder():
    table, albedo, sent = closed_room(0.9)
    rough, unshot = jax.jit(partial(shoot, limit=40))(table, albedo, sent)
    rest = solve_radiosity(table, albedo, sent) - rough
    assert 0.1 * rough.max() < rest.max() < unshot.max() * 0.9 / (1 - 0.9) * 1.01


def test_rooms_without_absorption_are_detected():
    """A white closed room is found; a grey wall, or a missing one, lets light leave."""
    elements, patches = len(SOLUTION.irradiance), len(SOLUTION.radiosity)
    white, table = np.ones((6, 2), np.float32), np.full((elements, patches), 1 / patches)
    assert trapping_surface(table, white, PLAN) == 0
    assert trapping_surface(table, 0.999 * white, PLAN) is None
    grey = white.copy()
    grey[0] = 0.5
    assert trapping_surface(table, grey, PLAN) is None
    grey[0] = [0.5, 1.0]  # one band of two is enough
    assert trapping_surface(table, grey, PLAN) == 0
    opened = table.copy()
    opened[:, :4] = 0
    assert trapping_surface(opened, white, PLAN) is None


@pytest.mark.slow
def test_bounces_and_shots_converge():
    exact = exact_solution()
    np.testing.assert_allclose(bounce(TABLE, ALBEDO, SENT, count=0), SENT)
    np.testing.assert_allclose(bounce(TABLE, ALBEDO, SENT, count=80), exact, rtol=1e-9)
    rough, unshot = shoot(TABLE, ALBEDO, SENT, tolerance=0.3)
    np.testing.assert_allclose(
        rough + np.asarray(solve_radiosity(TABLE, ALBEDO, ALBEDO * (TABLE @ unshot))),
        exact,
        rtol=1e-9,
    )
    closed = TABLE / TABLE.sum(axis=1, keepdims=True)
    full = solve_radiosity(closed, ALBEDO, SENT)
    rough, unshot = shoot(closed, ALBEDO, SENT, tolerance=0.3)
    better = rough + ambient_estimate(ALBEDO, unshot, jnp.ones(20))
    assert jnp.abs(better - full).max() < jnp.abs(rough - full).max() / 3


# ------------------------------------------------ pictures and gradients


def picture(scene, plan, view):
    return radiosity_image(scene, plan, radiosity(scene, plan), view)


VIEW = jv.Pinhole(
    [0.5, 0.5, 0.05],
    loops.look_at([0.5, 0.5, 0.05], [0.45, 0.52, 1.0], [0, 1, 0]),
    1.0,
    0.25,
    resolution=(6, 8),
)


@pytest.mark.slow
def test_picture_of_a_glowing_cube_is_even():
    scene = room([GREY] * 6, emission={i: [0.5] for i in range(6)})
    plan = plan_patches(scene, size=0.5, split=2)
    image = jax.jit(lambda scene: picture(scene, plan, VIEW))(scene)
    np.testing.assert_allclose(image, 1, atol=5e-3)


@pytest.mark.slow
def test_each_side_of_a_sheet_shows_its_own_radiosity():
    """On the second of two sheets, whose irradiance differs from side to side, each side shows k_d
    E."""
    sheets = [Quad([0, 0, z], [1.0, 0, 0], [0, 1.0, 0]) for z in (0.0, 1.0)]
    scene = jv.Scene([jv.Surface(sheet, GREY, two_sided=True) for sheet in sheets], [])
    plan = plan_patches(scene, size=0.5, split=1)
    facing = jax.jit(lambda scene: patches_of(scene, plan))(scene)
    light = np.where(np.asarray(facing.normal.z) > 0, 1.0, 2.0) + 4 * np.asarray(facing.centre.z)
    values = jnp.asarray(light)[:, None]
    solved = Solution(values, values, values, jnp.zeros(len(light), bool))

    @jax.jit
    def seen(start, direction):
        return radiosity_along(scene, plan, solved, jv.Ray(start, direction))[0]

    for z, down, expected in (
        (2.0, -1.0, 5.0),
        (0.6, 1.0, 6.0),
        (0.4, -1.0, 1.0),
        (-1.0, 1.0, 2.0),
    ):
        found = seen(jnp.asarray([0.3, 0.4, z]), jnp.asarray([0, 0, down]))
        np.testing.assert_allclose(found, 0.5 / np.pi * expected, rtol=1e-6)


@pytest.mark.slow
def test_floor_beside_boxes_is_not_dark():
    """In a closed room of albedo .5 that emits .5, all radiances are 1. Pixels of the floor .016
    from a box on elements of .07 are within 6 %, mostly half shadows of 16 rays a lamp, and the
    mean within .3 %."""
    boxes = [
        jv.Surface(Box([0.3, 0.3, 0.15], [0.1, 0.1, 0.15]), GREY, [0.5]),
        jv.Surface(Box([0.7, 0.6, 0.1], [0.1, 0.1, 0.1]), GREY, [0.5]),
    ]
    scene = room([GREY] * 6, emission={i: [0.5] for i in range(6)}, furniture=boxes)
    plan = plan_patches(scene, size=0.15)
    eye, middle = jnp.asarray([0.5, 0.95, 0.6]), jnp.asarray([0.5, 0.4, 0.2])
    view = jv.Pinhole(
        eye,
        jv.look_at(eye, middle, jnp.asarray([0.0, 0.0, 1.0])),
        1.0,
        2 / 48,
        resolution=(48, 48),
    )
    scene, view = jv.as_dtype((scene, view), jnp.float32)
    image = jax.jit(lambda scene: picture(scene, plan, view))(scene)
    np.testing.assert_allclose(image, 1, atol=0.06)
    np.testing.assert_allclose(image.mean(), 1, atol=3e-3)


@pytest.mark.slow
def test_gather_and_interpolation_agree_in_a_glowing_cube():
    """Gathering along a ray from walls of radiance 1 gives 1, for any number of walls."""
    scene = room([GREY] * 6, emission={i: [0.5] for i in range(6)})
    even = Solution(
        SOLUTION.radiosity * np.pi,
        0.5 * np.pi * SOLUTION.irradiance,
        0.5 * np.pi * SOLUTION.sent,
        SOLUTION.covered,
    )
    ray = jv.Ray(jnp.asarray([0.4, 0.3, 0.2]), jnp.asarray([2.0, 3.0, 6.0]) / 7)

    @jax.jit
    def both(scene):
        gather = MonteCarlo(jax.random.key(0), 5)
        return [radiosity_along(scene, PLAN, even, ray, gather=way) for way in (None, gather)]

    np.testing.assert_allclose(both(scene), 1, rtol=1e-6)


PLAN = plan_patches(ROOM, size=0.5, split=2)
SOLUTION = Solution(
    *(jnp.asarray(np.ones((n, 1))) for n in (24, 96, 96)), jnp.asarray(np.zeros(96, bool))
)


@pytest.mark.slow
def test_an_environment_is_seen_behind_the_scene():
    quad = jv.Surface(Quad([-0.2, -0.2, 0], [0.4, 0, 0], [0, 0.4, 0]), GREY)
    scene = jv.Scene([quad], [jv.environment_map(np.ones((2, 4, 1)))])
    plan = plan_patches(scene, size=0.2)
    rotation = jv.look_at(jnp.asarray([0.0, 0, 2]), jnp.zeros(3), jnp.asarray([0, 1.0, 0]))
    view = jv.Pinhole([0, 0, 2.0], rotation, 1.0, 0.15, resolution=(3, 3))
    picture = jax.jit(lambda scene: radiosity_image(scene, plan, radiosity(scene, plan), view))(
        scene
    )
    np.testing.assert_allclose(picture[0, 0], 1, rtol=1e-12)
    np.testing.assert_allclose(picture[1, 1], 0.5, rtol=0.05)


# ------------------------------------------------ bad input


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        (
            jv.Surface(Plane([0, 0, 0], [0, 0, 1]), GREY),
            r"surfaces\[1\].shape must be bounded.*Plane",
        ),
        (
            jv.Surface(Sphere([0, 0, 0], 1.0), jv.Phong([0.1], [0.1], 5.0)),
            r"surfaces\[1\].material must be Lambert.*Phong",
        ),
    ],
)
def test_unsupported_scenes_of_radiosity_raise(surface, message):
    first = jv.Surface(Sphere([0, 0, 0], 1.0), GREY)
    with pytest.raises(ValueError, match=message):
        plan_patches(jv.Scene([first, surface], []), size=1.0)


def test_options_of_radiosity_out_of_range_raise():
    with pytest.raises(ValueError, match="size must be positive, got 0"):
        plan_patches(ROOM, size=0.0)
    with pytest.raises(
        ValueError, match=r"Plan\.split must be a whole number of at least 1, got 0"
    ):
        Plan(PLAN.faces, 0)
    with pytest.raises(ValueError, match="rays must be a whole number of at least 1, got 0"):
        form_factor_table(ROOM, PLAN, rays=0)
    with pytest.raises(ValueError, match="direct, iterative, progressive, got 'guess'"):
        solve_radiosity(TABLE, ALBEDO, SENT, method="guess")
