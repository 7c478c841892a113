"""A clear, a hazy and an overcast day

The CIE's skies 12, 8 and 1 with the same light on level ground, and the sun as a disc on the clear
and the hazy day. The shadow of a pole has a penumbra and is lit by the sky only.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv

sun = jnp.array([0.5, -0.5, 0.7])
grey, dark = jv.Lambert([0.5 / jnp.pi] * 3), jv.Lambert([0.25 / jnp.pi] * 3)
surfaces = [
    jv.Surface(jv.Plane((0.0, 0, 0), (0.0, 0, 1)), grey),
    jv.Surface(jv.Box((0.0, 0, 1), (0.08, 0.08, 1.0)), dark),
    jv.Surface(jv.Sphere((0.9, 0.2, 0.4), 0.4), jv.Coated(grey, jv.Dielectric([1.5]), 0.05)),
]
days = {"clear, kind 12": (12, 400.0), "hazy, kind 8": (8, 150.0), "overcast, kind 1": (1, 0.0)}
view = jv.look_at(jnp.array([0.6, -5.0, 2.2]), jnp.array([0.2, 0.3, 0.6]), jnp.array([0.0, 0, 1]))
camera = jv.Pinhole((0.6, -5.0, 2.2), view, 1.0, 0.0045, resolution=(160, 220))
figure, axes = plt.subplots(3, 1, figsize=(4, 8.6))
for axis, (name, (kind, direct)) in zip(axes, days.items(), strict=True):
    sky = jv.lights.daylight(kind, sun, irradiance=[90.0, 100.0, 125.0])
    lights = [sky] + [jv.SunDisc(sun, [direct] * 3)] * (direct > 0)
    rule = jv.Balanced(jax.random.key(0), 64)
    radiance = jax.jit(jv.render)(jv.Scene(surfaces, lights), camera, rule=rule)
    axis.imshow(jv.srgb_encode((radiance / 90).clip(0, 1)))
    axis.set(title=name, xticks=[], yticks=[])
