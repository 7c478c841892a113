"""Shared parts of the benchmarks against Mitsuba 3 (`llvm_ad_rgb`): import, camera, parallelogram,
and the Cornell box of `oracles.cornell_box`.

Mitsuba needs the LLVM library that `DRJIT_LIBLLVM_PATH` names, see its documentation."""

import os
from typing import Any

import numpy as np
import pytest
from oracles import cornell_box


def mitsuba() -> Any:
    """Return the module with its variant set, or skip the test with a reason if Mitsuba cannot
    run."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        pytest.skip("name Mitsuba's LLVM library in DRJIT_LIBLLVM_PATH")
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("llvm_ad_rgb")
    return mi


def finished(result):
    """Wait for a result of Mitsuba, which computes asynchronously, and return it."""
    import drjit

    drjit.eval(result)
    drjit.sync_thread()
    return result


def perspective(
    mi, eye, target, up, *, field, side, pixel_format="rgb", sampler=None
) -> dict[str, Any]:
    """Return a pinhole camera of `side` x `side` pixels with a box filter, in float32. `field` is
    in degrees."""
    toward = mi.ScalarTransform4f().look_at(*([float(x) for x in v] for v in (eye, target, up)))
    return {
        "type": "perspective",
        "fov": float(field),
        "to_world": toward,
        "film": {
            "type": "hdrfilm",
            "width": side,
            "height": side,
            "rfilter": {"type": "box"},
            "pixel_format": pixel_format,
            "component_format": "float32",
        },
        "sampler": sampler or {"type": "independent"},
    }


def parallelogram(mi, corner, u, v, **rest) -> dict[str, Any]:
    """Return the parallelogram corner + a u + b v, with a and b in [0, 1] and its front towards u x
    v."""
    corner, u, v = (np.asarray(x, float) for x in (corner, u, v))
    normal = np.cross(u, v)
    place = np.eye(4)
    place[:3] = np.stack(
        [u / 2, v / 2, normal / np.linalg.norm(normal), corner + u / 2 + v / 2], axis=1
    )
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(place.tolist()), **rest}


def rgb(value) -> dict[str, Any]:
    """Return a colour, or one number for all three channels."""
    return {"type": "rgb", "value": np.asarray(value, float).tolist()}


def diffuse(albedo) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": rgb(albedo)}


def mitsuba_cornell_box(mi, *, side, integrator):
    """Return the published camera and box with `side` x `side` pixels, from the parallelograms,
    colours and lamp of `oracles.cornell_box`."""
    box = cornell_box
    field = 2 * np.degrees(np.arctan(box.FILM / 2 / box.FOCAL_LENGTH))
    lamp = {"type": "area", "radiance": rgb(box.RADIANCE)}
    contents = {
        "type": "scene",
        "integrator": integrator,
        "sensor": perspective(mi, box.EYE, box.TARGET, box.UP, field=field, side=side),
        "lamp": parallelogram(mi, *box.LAMP, bsdf=diffuse([0, 0, 0]), emitter=lamp),
    }
    for i, (face, albedo) in enumerate(zip(box.FACES, box.ALBEDOS, strict=True)):
        contents[f"face{i}"] = parallelogram(mi, *face, bsdf=diffuse(albedo))
    return mi.load_dict(contents)
