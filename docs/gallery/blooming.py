"""Blooming of a CCD

A lamp that generates 25 times the charge of a full well, next to lit windows. Charge spills along
the columns (blooming), is collected during the transfer (smear), or is left behind by the transfer.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
from matplotlib.colors import LogNorm

import jaxvision as jv

rows, columns = jnp.mgrid[0:160, 0:120]
night = jnp.where((rows > 112) & (rows < 122) & (columns % 22 < 8), 6e3, 400.0)
night = jnp.where(jnp.hypot(rows - 62, columns - 60) < 5, 5e5, night)[..., None]
ccd = jv.Sensor(full_well=20_000.0, shot_noise=jv.FastPoissonShotNoise(), read_noise=10.0)
kinds = {
    "blooming": replace(ccd, blooming=1.0),
    "smear, 0.02 %": replace(ccd, smear=2e-4),
    "trail, 1 %": replace(ccd, charge_transfer=jv.ChargeTransfer(0.01)),
}
figure, axes = plt.subplots(1, 3, figsize=(5.6, 2.8))
for axis, (name, kind) in zip(axes, kinds.items(), strict=True):
    read = jv.collect(jax.random.key(0), kind, night)[..., 0]
    axis.imshow(read, cmap="gray", norm=LogNorm(200, 20_000, clip=True))
    axis.set_title(name)
    axis.axis("off")
