"""The result of photometric stereo."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from jaxvision.core.in_notebooks import figure_png, picture_html, record_html
from jaxvision.plots import pictures

from ...inference.formatting import format_spread

HEADS = ("", "median", "90 % of pixels in", "unit")


@dataclass(frozen=True)
class Stereo:
    """Normals, albedo and their errors for each pixel. Print the record, or show it in a notebook.

    Attributes:
        normals: (h, w, 3) unit normals, in the axes of the lights; NaN where the lights that are
            used have fewer than three directions, or have directions in one plane.
        albedo: (h, w) ratio of readings to irradiance.
        normal_sd: (h, w) standard deviation of the normal's direction, rad, as the root mean square
            over two axes. A cone whose half-angle is 2.448 times this standard deviation contains
            the normal with 95 % probability. NaN where only three lights are used, because a fit to
            three readings has no residual.
        albedo_sd: (h, w) standard deviation of the albedo, in its unit; NaN where `normal_sd` is
            NaN.
        used: (h, w) number of lights that are used.
        misfit: (h, w) standard deviation of departures from Lambert's law that neighbouring lights
            share, relative to the albedo; 0 where none is found. The standard deviations of normal
            and albedo include it.
        findings: sentences on images that do not match the others, on a surface that is not
            Lambertian, on images without light, and on normals that belong to no surface in the
            axes of the image.
        materials: by label, the parameters that its pixels share, with their standard deviations.
            For a lobe the parameters are the amplitude, in the unit of the albedo times the unit of
            the model's k_s, and the shape. For a rough surface the parameter is the roughness.
            Empty for Lambert's law.
    """

    normals: Float[np.ndarray, "h w 3"]
    albedo: Float[np.ndarray, "h w"]
    normal_sd: Float[np.ndarray, "h w"]
    albedo_sd: Float[np.ndarray, "h w"]
    used: Int[np.ndarray, "h w"]
    misfit: Float[np.ndarray, "h w"]
    findings: tuple[str, ...] = ()
    materials: Mapping[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def __str__(self) -> str:
        rows = [
            f"  {name}: median {middle}, 90 % of pixels in {ends} {unit}".rstrip()
            for name, middle, ends, unit in self._rows()
        ]
        return "\n".join([self._heading(), *rows, *(f"  {finding}" for finding in self.findings)])

    def _heading(self) -> str:
        found = int(np.isfinite(self.albedo).sum())
        return f"Normals and albedo at {found} of {self.albedo.size} pixels"

    def _rows(self) -> list[tuple[str, str, str, str]]:
        maps = {
            "albedo": (self.albedo, "readings / irradiance"),
            "albedo: s.d.": (self.albedo_sd, "readings / irradiance"),
            "normal: s.d.": (self.normal_sd, "rad"),
            "lights that count": (self.used, ""),
        }
        rows = []
        for name, (values, unit) in maps.items():
            known = values[np.isfinite(values) & np.isfinite(self.albedo)]
            if known.size:
                rows.append((name, *format_spread(known), unit))
        return rows

    def _repr_html_(self) -> str:
        """Return the maps and their table as HTML for a notebook."""
        table = record_html(HEADS, self._rows(), title=self._heading(), notes=self.findings)
        known = self.albedo[np.isfinite(self.albedo)]
        if not known.size:
            return table
        white = np.percentile(known, 99) or 1.0
        shown = {"normals as colours": (1 + self.normals) / 2, "albedo": self.albedo / white}
        maps = pictures({name: np.nan_to_num(pixels) for name, pixels in shown.items()})
        return picture_html(figure_png(maps), table, meaning="normals and albedo")
