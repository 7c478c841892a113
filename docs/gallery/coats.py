"""Reflection by rough and coated surfaces

The share of the light that a white surface returns, as a function of the viewing angle. Rough
facets with single reflections lose light. A white body that is not attenuated by the lobe above it
returns too much. EON, multiple scattering and a coat return all light.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv

angle = jnp.linspace(0, 1.555, 60)
viewers = jnp.stack([jnp.sin(angle), 0 * angle, jnp.cos(angle)], axis=-1)
white, black, glass = jnp.array([1 / jnp.pi]), jnp.zeros(1), jv.Dielectric([1.5])
surfaces = {
    "Oren-Nayar, sigma = 0.5": jv.OrenNayar(white, 0.5),
    "EON, r = 0.8": jv.EON(white, 0.8),
    "GGX, alpha = 0.6": jv.TorranceSparrow(black, [1.0], 0.6),
    "with multiple scattering": jv.TorranceSparrow(
        black, [1.0], 0.6, multiple_scattering="kulla-conty"
    ),
    "a lobe over Lambert": jv.TorranceSparrow(white, [1.0], 0.1, interface=glass),
    "Lambert under a coat": jv.Coated(jv.Lambert(white), glass, 0.1),
}
figure, axes = plt.subplots()
for k, (name, material) in enumerate(surfaces.items()):
    returned = jax.vmap(lambda wo, m=material: jv.brdf.albedo(m, wo))(viewers)
    wide = {"lw": 6 - 2 * (k // 2), "ls": "-"} if k % 2 else {"ls": ":"}
    axes.plot(jnp.degrees(angle), returned, color=f"C{k // 2}", label=name, **wide)
axes.set(xlabel="view, degrees from the normal", ylabel="light returned")
axes.legend(fontsize=8)
