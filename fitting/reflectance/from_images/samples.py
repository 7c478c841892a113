"""The samples of a fit: lights and pixels chosen from an observation, with what a lobe takes."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from jaxvision import Vec, as_vec
from jaxvision.brdf.blinn import log_cos_half
from jaxvision.geometry.hemisphere import local_frame, to_local

from ..models import REFLECTANCES
from ..names import Model
from .model import Form, Invariants, Samples
from .read import VIEW, Photographs


def lobe_geometry(
    observation: Photographs, models: Iterable[Model], selection: "Selection"
) -> dict[Model, Array | Invariants | None]:
    """What the lobes of models take.

    Args:
        observation: of the object.
        models: whose lobes they are.
        selection: indices of light and pixel.

    Returns:
        By model: the log cosine of the lobe's own angle (Phong, Blinn), the mirror angle in rad
        (Gaussian lobe), all invariants (the others); None for Lambert. Models share their arrays.
    """
    light, pixel = selection.light, selection.pixel

    @cache
    def mirror_angle() -> Array:
        return jnp.asarray(observation.mirror_angle[light, pixel])

    @cache
    def log_cos(axis: str) -> Array:
        if axis == "mirror":
            return jnp.asarray(observation.log_cos_mirror[light, pixel])
        return _log_cos_half(
            jnp.asarray(observation.normals[pixel]), jnp.asarray(observation.wi[light, pixel])
        )

    @cache
    def cosines() -> tuple[Array, Array]:
        both = observation.cosine[light, pixel], observation.normals[pixel, 2]
        return jnp.asarray(both[0]), jnp.asarray(both[1])

    def of(model: Model) -> Array | Invariants | None:
        axis = "half" if REFLECTANCES[model].axis == "half" else "mirror"
        match model:
            case "lambert":
                return None
            case "gaussian-lobe":
                return mirror_angle()
            case "phong" | "blinn":
                return log_cos(axis)
        cos_i, cos_o = cosines()
        return Invariants(cos_i=cos_i, cos_o=cos_o, log_cos=log_cos(axis))

    return {model: of(model) for model in models}


@jax.jit
def _log_cos_half(normals: jax.Array, wi: jax.Array) -> jax.Array:
    view = Vec(*(jnp.full(normals.shape[:1], x, normals.dtype) for x in VIEW))
    frame = local_frame(as_vec(normals))
    return log_cos_half(as_vec(to_local(frame, as_vec(wi))), as_vec(to_local(frame, view)))


@dataclass(frozen=True)
class Selection:
    """Which samples a fit sees.

    Attributes:
        light: (samples,) indices, lights in order.
        pixel: (samples,) indices.
    """

    light: Int[np.ndarray, " samples"]
    pixel: Int[np.ndarray, " samples"]


def select(
    observation: Photographs, *, held_out: bool, form: Form, minimum_cosine: float = 0.0
) -> Selection:
    """Samples of the lights kept for testing, or of the others.

    Attached shadows (n.l <= 0) are predicted to be black and say nothing about the surface, so they
    are left out, unless an ambient term is to be read off them.

    Args:
        observation: of the object.
        held_out: whether to take the lights kept for testing.
        form: whose ambient term counts.
        minimum_cosine: n.l must be above it.

    Returns:
        Their indices.
    """
    seen = observation.cosine > minimum_cosine
    if form.ambient:
        seen = seen | (observation.cosine <= 0)
    light, pixel = np.nonzero(seen & (observation.held_out == held_out)[:, None])
    return Selection(light, pixel)


@dataclass(frozen=True, eq=False)
class Gathered:
    """What the fits of one selection share: its values, gathered from an observation once.

    Attributes:
        observation: of the object.
        selection: of its samples.
        cosine: (samples,) [n.l]+.
        geometry: of each model, what its lobe takes.
        irradiance: (samples,) of each channel by its index, on a surface that faces the light.
        dn: (samples,) of each channel, DN.
        saturated: (samples,) of each channel; None where nothing clips in any.
    """

    observation: Photographs
    selection: Selection
    cosine: Array
    geometry: dict[Model, Array | Invariants | None]
    irradiance: dict[int, Array]
    dn: dict[int, Array]
    saturated: dict[int, Array | None]

    def samples(self, channel: int, form: Form) -> Samples:
        """The samples of one channel, their deviation still 1 DN.

        Args:
            channel: index.
            form: of the fit.

        Returns:
            The samples.
        """
        observation = self.observation
        gamma = None if form.free_gamma else observation.gamma
        return Samples(
            form=form,
            cosine=self.cosine,
            geometry=self.geometry[form.model],
            irradiance=self.irradiance[channel],
            dn=self.dn[channel],
            deviation=jnp.ones_like(self.dn[channel]),
            saturated=self.saturated[channel],
            black=jnp.asarray(observation.black, float),
            white=jnp.asarray(observation.white, float),
            clip=jnp.asarray(observation.clip, float),
            gamma=None if gamma is None else jnp.asarray(gamma, float),
        )


def gather(
    observation: Photographs,
    selection: Selection,
    *,
    models: Iterable[Model],
    channels: Iterable[int],
) -> Gathered:
    """Gathers what fits of a selection need.

    Args:
        observation: of the object.
        selection: indices of light and pixel.
        models: to be fitted.
        channels: indices.

    Returns:
        The values.
    """
    light, pixel = selection.light, selection.pixel
    clips = bool(observation.saturated[:, light, pixel].any())
    dn = {channel: observation.dn[channel, light, pixel] for channel in channels}
    falloff = observation.falloff[light, pixel]
    return Gathered(
        observation=observation,
        selection=selection,
        cosine=jnp.asarray(np.maximum(observation.cosine[light, pixel], 0)),
        geometry=lobe_geometry(observation, models, selection),
        irradiance={c: jnp.asarray(observation.intensity[c, light] * falloff) for c in dn},
        dn={c: jnp.asarray(values) for c, values in dn.items()},
        saturated={
            c: jnp.asarray(values >= observation.clip) if clips else None
            for c, values in dn.items()
        },
    )


def make_samples(
    observation: Photographs, channel: int, form: Form, selection: Selection
) -> Samples:
    """The selected samples of one channel, their deviation still 1 DN.

    Args:
        observation: of the object.
        channel: index.
        form: of the fit.
        selection: indices of light and pixel.

    Returns:
        The samples.
    """
    found = gather(observation, selection, models=(form.model,), channels=(channel,))
    return found.samples(channel, form)


def of_some_pixels(
    observation: Photographs, selection: Selection, step: int
) -> tuple[Photographs, Selection]:
    """Every so many pixels of an observation, and those of a selection.

    Args:
        observation: of the object.
        selection: indices of light and pixel.
        step: between pixels.

    Returns:
        An observation of these pixels alone, and its selection.
    """
    some = slice(None, None, step)
    fewer = replace(
        observation,
        normals=observation.normals[some],
        rows=observation.rows[some],
        columns=observation.columns[some],
        **{
            name: getattr(observation, name)[:, some]
            for name in ("wi", "cosine", "log_cos_mirror", "mirror_angle", "falloff")
        },
        dn=observation.dn[..., some],
    )
    kept = selection.pixel % step == 0
    return fewer, Selection(selection.light[kept], selection.pixel[kept] // step)
