"""The samples of a fit: lights and pixels chosen from photographs, with their geometry."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from .model import Samples
from .read import VIEW, Photographs
from .signal import Form, Geometry, in_plane


@dataclass(frozen=True)
class Selection:
    """The samples that a fit uses."""

    light: Int[np.ndarray, " samples"]  # indices, lights in order
    pixel: Int[np.ndarray, " samples"]  # indices


def select(
    observation: Photographs, *, held_out: bool, form: Form, minimum_cosine: float = 0.0
) -> Selection:
    """Select the samples of the held-out lights, or of the others, with n.l above a minimum.

    Attached shadows (n.l <= 0) are predicted to be black and contain no information about the
    surface, so they are used only for an ambient term.
    """
    seen = observation.cosine > minimum_cosine
    if form.ambient:
        seen = seen | (observation.cosine <= 0)
    light, pixel = np.nonzero(seen & (observation.held_out == held_out)[:, None])
    return Selection(light, pixel)


@dataclass(frozen=True, eq=False)
class Gathered:
    """Values that all fits of one selection share, gathered once from an observation."""

    observation: Photographs  # of the object
    selection: Selection  # of its samples
    geometry: dict[int, Geometry]  # of each channel by its index
    dn: dict[int, np.ndarray]  # (samples,) of each channel, DN
    # (samples,) of each channel; None where nothing clips in any
    saturated: dict[int, np.ndarray | None]

    def samples(self, channel: int, form: Form) -> Samples:
        """The samples of one channel, with a deviation of 1 DN."""
        observation = self.observation
        gamma = None if form.free_gamma else observation.gamma
        return Samples(
            form=form,
            geometry=self.geometry[channel],
            dn=self.dn[channel],
            deviation=np.ones_like(self.dn[channel]),
            saturated=self.saturated[channel],
            black=np.float64(observation.black),
            white=np.float64(observation.white),
            clip=np.float64(observation.clip),
            gamma=None if gamma is None else np.float64(gamma),
        )


def gather(observation: Photographs, selection: Selection, *, channels: Iterable[int]) -> Gathered:
    """Gather the values of a selection that all fits share."""
    light, pixel = selection.light, selection.pixel
    clips = bool(observation.saturated[:, light, pixel].any())
    dn = {channel: observation.dn[channel, light, pixel] for channel in channels}
    falloff = observation.falloff[light, pixel]
    normals, wi = observation.normals[pixel], observation.wi[light, pixel]
    cosine = np.einsum("sc,sc->s", normals, wi)
    shared = in_plane(cosine, normals @ VIEW, wi @ VIEW, falloff)
    return Gathered(
        observation=observation,
        selection=selection,
        geometry={
            c: replace(shared, irradiance=observation.intensity[c, light] * falloff) for c in dn
        },
        dn=dn,
        saturated={c: values >= observation.clip if clips else None for c, values in dn.items()},
    )


def make_samples(
    observation: Photographs, channel: int, form: Form, selection: Selection
) -> Samples:
    """The selected samples of one channel, with a deviation of 1 DN."""
    found = gather(observation, selection, channels=(channel,))
    return found.samples(channel, form)


def of_some_pixels(
    observation: Photographs, selection: Selection, step: int
) -> tuple[Photographs, Selection]:
    """Return an observation of every `step`-th pixel, and its part of a selection."""
    some = slice(None, None, step)
    fewer = replace(
        observation,
        normals=observation.normals[some],
        rows=observation.rows[some],
        columns=observation.columns[some],
        **{
            name: getattr(observation, name)[:, some]
            for name in ("wi", "cosine", "mirror_angle", "falloff")
        },
        dn=observation.dn[..., some],
    )
    kept = selection.pixel % step == 0
    return fewer, Selection(selection.light[kept], selection.pixel[kept] // step)
