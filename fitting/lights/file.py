"""The record of lights with their covariance, and the file `lights.npz` that a rig refers to."""

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxvision.core.in_notebooks import record_html
from jaxvision.errors import InputError

from ..inference.given import require_covariance

HEADS = ("light", "x", "y", "z", "s.d.", "intensity")


@dataclass(frozen=True)
class Lights:
    """Directions or positions of lights, and their intensities. Print the record, or show it in a
    notebook.

    Attributes:
        files: names of the lights' images.
        places: (lights, 3) unit directions toward distant lights; m from the centre of the first
            ball where `near`. Axes are x right, y up, z toward the camera.
        intensities: (lights,) relative intensities, 1 on average; NaN where unknown.
        covariance: (lights, 4, lights, 4) covariance of x, y, z and the logarithm of the intensity,
            including the errors that all lights share.
        near: whether places are positions.
        outlines: (balls, 3) column, row and radius of each ball, pixels.
        outline_sds: (balls, 3) standard deviations of the outlines, pixels.
        common: share of the variance of the places that all lights share, because it comes from the
            outlines.
        findings: sentences.
    """

    files: tuple[str, ...]
    places: Float[np.ndarray, "lights 3"]
    intensities: Float[np.ndarray, " lights"]
    covariance: Float[np.ndarray, "lights 4 lights 4"]
    near: bool
    outlines: Float[np.ndarray, "balls 3"]
    outline_sds: Float[np.ndarray, "balls 3"]
    common: float
    findings: tuple[str, ...] = ()

    @property
    def place_sd(self) -> Float[np.ndarray, " lights"]:
        """Return the standard deviation of each light's place, as rms over axes: for a direction in
        rad along two axes perpendicular to it, for a position in m along three axes.
        """
        own = np.einsum("lili->l", self.covariance[:, :3, :, :3])
        return np.sqrt(own / (3 if self.near else 2))

    @property
    def intensity_sd(self) -> Float[np.ndarray, " lights"]:
        """Return the relative standard errors of the intensities."""
        return np.sqrt(np.einsum("ll->l", self.covariance[:, 3, :, 3]))

    def rows(self) -> list[tuple[str, ...]]:
        """Return the cells of a table with one row for each light."""
        sds = [f"{sd:.2g} m" if self.near else f"{np.degrees(sd):.2g}°" for sd in self.place_sd]
        strengths = [
            "-" if np.isnan(one) else f"{one:.4g} ± {one * sd:.1g}"
            for one, sd in zip(self.intensities, self.intensity_sd, strict=True)
        ]
        places = [[f"{x:+.4f}" for x in place] for place in self.places]
        return [
            (file, *place, sd, strength)
            for file, place, sd, strength in zip(self.files, places, sds, strengths, strict=True)
        ]

    def heading(self) -> str:
        """Return one line that describes the lights."""
        kind = "Positions (m)" if self.near else "Directions"
        return (
            f"{kind} of {len(self.files)} lights; {100 * self.common:.0f} % of their variance is "
            "common to all"
        )

    def __str__(self) -> str:
        lines = [" ".join(f"{cell:>10}" for cell in row) for row in (HEADS, *self.rows())]
        return "\n".join([self.heading(), *lines, *self.findings])

    def _repr_html_(self) -> str:
        return record_html(HEADS, self.rows(), title=self.heading(), notes=self.findings)


STORED = tuple(part.name for part in fields(Lights) if part.name != "findings")


def write_lights(lights: Lights, path: str | os.PathLike[str]) -> None:
    """Write places, intensities and covariance as `.npz`.

    Args:
        lights: the lights to write.
        path: path of the file.
    """
    with Path(path).open("wb") as stream:
        parts: dict[str, Any] = {name: np.asarray(getattr(lights, name)) for name in STORED}
        np.savez(stream, **parts)


def read_lights(path: str | os.PathLike[str]) -> Lights:
    """Read lights from a file that `write_lights` wrote.

    Args:
        path: of the file.

    Returns:
        The lights, without findings.

    Raises:
        InputError: for a file that is missing or holds no lights, or whose covariance is not
            finite, symmetric and positive semi-definite.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file of lights; `jaxvision-fit lights` writes one.")
    try:
        with np.load(path, allow_pickle=False) as stored:
            parts: dict[str, Any] = {name: stored[name] for name in STORED}
            parts["files"] = tuple(str(name) for name in parts["files"])
            found = Lights(
                **parts | {"near": bool(parts["near"]), "common": float(parts["common"])}
            )
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(f"{path}: is no file of lights ({error}).") from error
    count = len(found.files)
    if found.places.shape != (count, 3) or found.covariance.shape != (count, 4, count, 4):
        raise InputError(
            f"{path}: {count} files, places {found.places.shape} and covariance "
            f"{found.covariance.shape} do not agree; write it anew."
        )
    require_covariance(f"{path}: covariance", found.covariance.reshape(4 * count, -1))
    return found
