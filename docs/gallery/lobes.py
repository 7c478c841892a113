"""Three lobes of one material

Three lobes reflect the same light, incident at 60 degrees. The lobes are Phong's, Blinn's with four
times the exponent, which is nearly equal in this plane, and GGX facets with Fresnel's law, which
are bright at grazing angles, too. Each lobe is drawn relative to its largest value.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv

angle = jnp.linspace(-jnp.pi / 2, jnp.pi / 2, 361)
viewers = jnp.stack([jnp.sin(angle), 0 * angle, jnp.cos(angle)], axis=-1)
light = jnp.array([-jnp.sin(jnp.pi / 3), 0.0, jnp.cos(jnp.pi / 3)])
black, glass = jnp.zeros(1), jv.Dielectric([1.5])
lobes = {
    "Phong, n = 40": jv.NormalisedPhong(black, [0.1], 40.0),
    "Blinn, n = 160": jv.NormalisedBlinn(black, [0.1], 160.0),
    "GGX, alpha = 0.15": jv.TorranceSparrow(black, [1.0], 0.15, interface=glass),
}
figure, axes = plt.subplots(subplot_kw={"projection": "polar"})
for (name, material), style in zip(lobes.items(), ("-", ":", "-"), strict=True):
    lobe = jax.vmap(lambda wo, m=material: jv.brdf.evaluate(m, light, wo))(viewers)
    axes.plot(angle, lobe[:, 0] / lobe.max(), style, label=name)
axes.set(theta_zero_location="N", theta_direction=-1, thetamin=-90, thetamax=90, yticks=[])
axes.axvline(jnp.pi / 3, color="0.7", ls=":")
figure.legend(loc="outside lower center", ncols=3, fontsize=8)
