"""A photon transfer curve

Pairs of frames of a uniform field at 24 light levels. The variance increases with the mean, and the
slope is the gain, 0.25 DN per electron. In the dark only read noise and rounding contribute. At the
full well all pixels have the same charge, and only read noise remains.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt

import jaxvision as jv

noise = {"shot_noise": jv.PoissonShotNoise(), "read_noise": 6.0}
reading = {"gain": 0.25, "offset": 64.0, "bits": 12}
sensor = jv.Sensor(quantum_efficiency=0.5, full_well=15_000.0, **noise, **reading)
photons = jnp.geomspace(30, 40_000, 24)[:, None, None, None] * jnp.ones((24, 128, 128, 1))
take = jax.jit(lambda key: jv.raw_image(key, sensor, photons))
one, other = take(jax.random.key(0)), take(jax.random.key(1))
mean = one.mean((1, 2, 3)) - 64
variance = ((one - other) ** 2 / 2).mean((1, 2, 3))
floor = (0.25 * 6.0) ** 2 + 1 / 12
plt.loglog(mean, variance, "o", label="measured, one point a level")
plt.loglog(mean, 0.25 * mean, label="photon noise alone: 0.25 DN per electron")
plt.axhline(floor, color="grey", ls="--", lw=1)
plt.text(14, 0.9 * floor, "read noise and rounding alone", color="grey", va="top")
plt.annotate(
    "well full: no photon noise\nis left",
    (mean[-1], variance[-1]),
    (450, 9),
    ha="center",
    arrowprops={"arrowstyle": "->", "color": "grey", "relpos": (1, 0)},
)
plt.ylim(0.5, 3000)
plt.xlabel("mean above black [DN]")
plt.ylabel("variance [DN²]")
plt.legend()
