r"""Time rays against triangle meshes by Embree, beside Mitsuba 3 (`llvm_ad_rgb`), whose
`ray_intersect_preliminary` also gives distance and triangle.

    DRJIT_LIBLLVM_PATH=... pytest -m benchmark --benchmark-enable -s tests/benchmarks/bench_mesh.py

embreex passes rays to Embree one by one, divided among the cores. The hits are copied twice and
computed again in JAX, so that gradients reach them. On two cores this has a tenth of Mitsuba's
speed for a thousand triangles, and a fifth for ten thousand and more."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from mitsuba_scenes import mitsuba
from turns import in_turns

from jaxvision import Vec, as_dtype
from jaxvision.geometry import Ray, hit_shape, nearest_shape
from jaxvision.scene import TriangleMesh

pytestmark = pytest.mark.benchmark
SIDE, ROUNDS = 256, 9


def bumpy_ball(subdivisions):
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    v = np.asarray(ball.vertices)
    radius = 1 + 0.15 * np.sin(7 * v[:, 0]) * np.sin(6 * v[:, 1] + 1) * np.sin(5 * v[:, 2])
    return (v * radius[:, None]).astype(np.float32), np.asarray(ball.faces, np.int32)


def camera_rays():
    place = (2 * (np.arange(SIDE) + 0.5) / SIDE - 1) * 0.36
    x, y = np.meshgrid(place, -place)
    direction = np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = np.broadcast_to([0, 0, 4], direction.shape)
    return origin.astype(np.float32), direction.astype(np.float32)


@pytest.mark.parametrize("subdivisions", [3, 5, 6])
def test_mesh_rays_beside_mitsuba(subdivisions):
    mi = mitsuba()
    import drjit as dr

    vertices, faces = bumpy_ball(subdivisions)
    origin, direction = camera_rays()
    rival = mi.Mesh("mesh", len(vertices), len(faces))
    fields = mi.traverse(rival)
    fields["vertex_positions"] = vertices.ravel()
    fields["faces"] = faces.ravel().astype(np.uint32)
    fields.update()
    scene = mi.load_dict({"type": "scene", "mesh": rival})
    theirs = mi.Ray3f(mi.Point3f(origin.T.copy()), mi.Vector3f(direction.T.copy()))
    dr.eval(theirs)

    def rival_meets():
        found = scene.ray_intersect_preliminary(theirs)
        dr.eval(found.t, found.prim_index)
        dr.sync_thread()
        return found

    mesh = as_dtype(TriangleMesh(vertices, faces), jnp.float32)
    ray = Ray(Vec(*jnp.asarray(origin).T), Vec(*jnp.asarray(direction).T))

    def meet(ray, mesh):
        def one(ray):
            return hit_shape(ray, [mesh], nearest_shape(ray, [mesh])).distance

        return jax.vmap(one)(ray)

    begin = time.perf_counter()
    compiled = jax.jit(meet).lower(ray, mesh).compile()
    print(f"\n{len(faces)} triangles, {SIDE**2} rays; compile {time.perf_counter() - begin:.2f} s")
    ours, other = np.asarray(compiled(ray, mesh)), np.asarray(rival_meets().t)
    assert (np.isfinite(ours) == np.isfinite(other)).mean() > 0.9999
    both = np.isfinite(ours) & np.isfinite(other)
    assert 0.2 < both.mean() < 1
    assert np.abs(ours[both] - other[both]).max() < 1e-4
    _, seconds = in_turns(
        {"jaxvision": lambda: jax.block_until_ready(compiled(ray, mesh)), "Mitsuba": rival_meets},
        rounds=ROUNDS,
    )
    for name, taken in seconds.items():
        speed = SIDE**2 / taken / 1e6
        ratio = seconds["Mitsuba"] / taken
        print(f"{name:10s} {1e3 * taken:8.2f} ms, {speed:6.2f} Mrays/s, {ratio:5.2f} times as fast")
    assert seconds["Mitsuba"] > 0.08 * seconds["jaxvision"]
