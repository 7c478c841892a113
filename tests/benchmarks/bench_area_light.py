r"""An unoccluded rectangular light on a Lambert floor, 512 x 512: error against time of the closed
form, of nodes as many as the distance asks for, of quadrature, of Monte Carlo, and of Mitsuba 3's
direct integrator (llvm_ad_rgb).

The first two are a picture of the floor written for them (`floor_picture`), the others the general
`render`: the ratio to Mitsuba is printed for all, and the 1000 is asked of the nodes.

    DRJIT_LIBLLVM_PATH=... pytest -m benchmark --benchmark-enable -s \
        tests/benchmarks/bench_area_light.py

Equal work: both intersect the floor and integrate one light; Mitsuba also traces the shadow ray of
each of its samples, which meets nothing. Its time at error 1e-3 is extrapolated from 64 and 256
samples with the exponent those show. Floats are 32 bits on both sides; the truth is ours in 64.
"""

import os
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from turns import in_turns

from jaxvision import (
    Lambert,
    MonteCarlo,
    Pinhole,
    Plane,
    Quadrature,
    RectangleLight,
    Scene,
    Surface,
    as_dtype,
    camera_ray,
    intersect,
    look_at,
    render,
)
from jaxvision.core._loops.fusion import TILE, fuse
from jaxvision.core._vector import as_array
from jaxvision.lights.adaptive import adaptive_irradiance
from jaxvision.lights.polygon import rectangle_irradiance
from jaxvision.optics import pixel_grid

pytestmark = pytest.mark.benchmark

SIDE, FIELD, ALBEDO, RADIANCE = 512, 40.0, 0.5, 10.0
EYE, CENTRE, EDGE_U, EDGE_V = np.array([0, 3.0, 5.0]), [0, 1.5, 0], [1.2, 0, 0], [0, 0, 0.8]
ROUNDS = 7


def scene_and_view(dtype):
    rotation = look_at(jnp.asarray(EYE), jnp.zeros(3), jnp.asarray([0.0, 1, 0]))
    pitch = 2 * np.tan(np.radians(FIELD) / 2) / SIDE
    view = Pinhole(EYE, rotation, 1.0, pitch, resolution=(SIDE, SIDE))
    corner = np.array(CENTRE) - np.array(EDGE_U) / 2 - np.array(EDGE_V) / 2
    lamp = RectangleLight(corner, EDGE_U, EDGE_V, [RADIANCE])  # u x v points down: -y
    floor = Surface(Plane([0, 0, 0], [0, 1, 0]), Lambert([ALBEDO / np.pi]))
    return as_dtype((Scene([floor], [lamp]), view), dtype)


def floor_picture(scene, view, irradiance):
    """Radiance of the floor alone, the light itself not in view: (SIDE, SIDE). `irradiance`: of a
    tile of receivers, as `adaptive_irradiance` takes them."""
    floor, lamp = scene.surfaces[0], scene.lights[0]
    rows, columns = pixel_grid(view)

    def met(row, column):
        return intersect(camera_ray(view, row, column), floor.shape).point

    def tile(rows):
        points = jax.vmap(jax.vmap(met, in_axes=(None, 0)), in_axes=(0, None))(rows, columns)
        points = fuse(jax.tree.map(jnp.ravel, points))
        return irradiance(lamp, points, floor.shape.normal)[:, 0]

    lit = jax.lax.map(tile, rows.reshape(-1, TILE // SIDE))
    return (floor.material.diffuse[0] * lit).reshape(SIDE, SIDE)


def closed_form(lamp, points, normal):
    return jax.vmap(rectangle_irradiance, in_axes=(None, 0, None))(lamp, points, normal)


def sees_the_floor(view):
    """(SIDE, SIDE): where the lamp's back, a hundredth of its edges wider all round for the pixels
    it cuts, does not cover the floor. Of geometry alone, no picture asked."""
    u, v, corner = np.array(EDGE_U), np.array(EDGE_V), np.array(CENTRE)
    corner = corner - u / 2 - v / 2
    rows, columns = pixel_grid(view)
    over_columns = jax.vmap(
        lambda row, column: as_array(camera_ray(view, row, column).direction), in_axes=(None, 0)
    )
    toward = np.asarray(jax.vmap(over_columns, in_axes=(0, None))(rows, columns))
    at = EYE + toward * ((CENTRE[1] - EYE[1]) / toward[..., 1:2]) - corner
    inside = [np.abs(at @ edge / (edge @ edge) - 0.5) < 0.51 for edge in (u, v)]
    return ~(inside[0] & inside[1])


def mitsuba_rival():
    """(render(samples) -> (SIDE, SIDE) array) of the same scene."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        pytest.skip("name Mitsuba's LLVM library in DRJIT_LIBLLVM_PATH")
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    import drjit

    transform = mi.ScalarTransform4f
    place = np.eye(4)
    place[:3, 0], place[:3, 1] = np.array(EDGE_U) / 2, np.array(EDGE_V) / 2
    place[:3, 2], place[:3, 3] = [0, -1, 0], CENTRE
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": ALBEDO}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": {
                "type": "perspective",
                "fov": FIELD,
                "to_world": transform().look_at(EYE.tolist(), [0, 0, 0], [0, 1, 0]),
                "film": {
                    "type": "hdrfilm",
                    "width": SIDE,
                    "height": SIDE,
                    "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                    "component_format": "float32",
                },
                "sampler": {"type": "multijitter", "sample_count": 64},
            },
            "floor": {
                "type": "rectangle",
                "to_world": transform().rotate([1, 0, 0], -90).scale(500),
                "bsdf": grey,
            },
            "lamp": {
                "type": "rectangle",
                "to_world": transform(place.tolist()),
                "bsdf": black,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": RADIANCE}},
            },
        }
    )
    direct = mi.load_dict(
        {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True}
    )
    seed = iter(range(10**6))

    def draw(samples):
        image = mi.render(scene, integrator=direct, spp=samples, seed=next(seed))
        drjit.eval(image)
        drjit.sync_thread()
        return image

    return lambda samples: np.asarray(draw(samples), float).reshape(SIDE, SIDE)


def test_error_against_time_beside_mitsuba():
    draw = mitsuba_rival()
    small, exact = scene_and_view(jnp.float32), scene_and_view(jnp.float64)
    truth = np.asarray(jax.jit(partial(floor_picture, irradiance=closed_form))(*exact))

    rivals, pictures = {}, {}

    def add(name, function):
        begin = time.perf_counter()
        compiled = jax.jit(function).lower(*small).compile()
        cold = time.perf_counter() - begin
        pictures[name] = np.asarray(compiled(*small), float).reshape(SIDE, SIDE)
        rivals[name] = lambda: jax.block_until_ready(compiled(*small))
        print(f"{name:24s} compile {cold:5.2f} s")

    add("closed form", partial(floor_picture, irradiance=closed_form))
    for tolerance in (1e-3, 1e-4):
        nodes = partial(adaptive_irradiance, tolerance=tolerance)
        add(f"nodes to {tolerance:.0e}", partial(floor_picture, irradiance=nodes))
    for order in (2, 3, 4, 8):
        rule = Quadrature(order)
        add(
            f"quadrature {order} x {order}", lambda s, v, rule=rule: render(s, v, rule=rule)[..., 0]
        )
    drawn = MonteCarlo(jax.random.key(0), 64)
    add("Monte Carlo 64", lambda s, v: render(s, v, rule=drawn)[..., 0])

    for name, irradiance in (("closed form", closed_form), ("nodes to 1e-04", nodes)):

        def total(scene, view, irradiance=irradiance):
            return floor_picture(scene, view, irradiance).mean()

        gradient = jax.jit(jax.grad(total)).lower(*small).compile()
        rivals[f"{name}, gradient"] = lambda f=gradient: jax.block_until_ready(f(*small))
    for samples in (64, 256):
        pictures[f"Mitsuba {samples}"] = draw(samples)
        rivals[f"Mitsuba {samples}"] = lambda samples=samples: draw(samples)

    in_view = sees_the_floor(exact[1])
    assert in_view.mean() > 0.7
    error = {k: float(np.sqrt(np.mean((x / truth - 1)[in_view] ** 2))) for k, x in pictures.items()}
    _, seconds = in_turns(rivals, rounds=ROUNDS)

    rate = np.log(error["Mitsuba 64"] / error["Mitsuba 256"]) / np.log(4)
    at_aim = seconds["Mitsuba 256"] * (error["Mitsuba 256"] / 1e-3) ** (1 / rate)
    print(f"\n{'method':24s} {'ms':>9s} {'rms error':>10s} {'Mitsuba at 1e-3 / this':>24s}")
    for name in rivals:
        ratio = f"{at_aim / seconds[name]:.0f}" if error.get(name, 1) <= 1e-3 else "-"
        print(f"{name:24s} {1e3 * seconds[name]:9.2f} {error.get(name, np.nan):10.1e} {ratio:>24s}")
    print(f"Mitsuba's error falls as samples^-{rate:.2f}; at 1e-3 it takes {at_aim:.1f} s")
    assert error["closed form"] < 1e-5
    for tolerance in (1e-3, 1e-4):
        assert error[f"nodes to {tolerance:.0e}"] < tolerance
    assert error["quadrature 4 x 4"] < 1e-3
    assert at_aim / seconds["nodes to 1e-03"] > 1000
