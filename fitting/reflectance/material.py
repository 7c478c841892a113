"""Conversion of a fitted reflectance to materials for a scene: the best fit, and posterior
draws."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxvision.brdf.lambert import Lambert
from jaxvision.files.materials import write_material
from jaxvision.scene import Material

from ..inference.parameters import names
from ..inference.posterior import Posterior
from .models import REFLECTANCES, has_lobe, shape_of
from .names import Model

DRAWS = 1000  # most draws that are kept


def fitted_material(model: Model, index: float, posterior: Posterior) -> tuple[Material, Material]:
    """Return the material of one channel, a record of one band, and posterior draws of it.

    Amplitudes are per unit of the rig's intensity. The amplitudes are in sr^-1 (without unit for
    normalised lobes) if that intensity is the digital number, above black, of a surface that faces
    the light and reflects 1 sr^-1.
    """
    labels = names(posterior.space)
    wanted = ["diffuse"] if model == "lambert" else ["diffuse", shape_of(model).name]
    wanted += ["specular"] if has_lobe(model) else []
    columns = np.array([labels.index(name) for name in wanted])
    rows = np.linspace(0, len(posterior.samples) - 1, min(DRAWS, len(posterior.samples)))

    def material(values: Float[Array, " numbers"]) -> Material:
        if model == "lambert":
            return Lambert(values[:1])
        build = REFLECTANCES[model].material
        assert build is not None, model
        amplitudes = (values[:1], values[2:])
        if not has_lobe(model):
            return eqx.tree_at(lambda m: m.diffuse, build(values[1], index), amplitudes[0])
        return eqx.tree_at(lambda m: (m.diffuse, m.specular), build(values[1], index), amplitudes)

    drawn = jnp.asarray(posterior.samples[rows.astype(int)][:, columns])
    return material(jnp.asarray(posterior.mode[columns])), eqx.filter_vmap(material)(drawn)


def material_files(
    fitted: dict[str, tuple[Model, float, Posterior]],
) -> dict[str, Callable[[Path], None]]:
    """Return functions that write the materials of a calibration, by the name of the file that each
    writes."""
    return {
        "material" if channel == "grey" else f"material_{channel}": partial(_write, *of_channel)
        for channel, of_channel in fitted.items()
    }


def _write(model: Model, index: float, posterior: Posterior, path: Path) -> None:
    best, draws = fitted_material(model, index, posterior)
    write_material(best, path, draws=draws)
