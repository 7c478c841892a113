"""Plot light and its reflection: spectra over wavelength, and lobes over angle."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..brdf import evaluate, is_delta
from ..core._types import require_metres
from ..core.plain_arrays import plain_array
from ..errors import InputError
from ..scene import Material
from ._views import INK, OTHER_INKS
from .legible_axes import new_axes, tidy
from .summary import band_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def spectrum(
    wavelengths: np.ndarray,
    values: np.ndarray | Mapping[str, np.ndarray],
    *,
    unit: str = "",
    label: str = "",
    axes: "Axes | None" = None,
) -> "Axes":
    """Plot spectra over wavelength, such as spectra of light, of a reflectance or of a camera's
    sensitivity.

    Args:
        wavelengths: (bands,) m, ascending.
        values: (bands,), or (bands, spectra), or spectra of (bands,) by name; three without names
            are red, green and blue.
        unit: unit of the values.
        label: name of the quantity.
        axes: matplotlib axes to draw on; None makes new ones.

    Returns:
        The axes; wavelength in nm.

    Raises:
        InputError: for a number of values that differs from the number of wavelengths.

    Example:
        >>> grid = np.linspace(400e-9, 700e-9, 31)
        >>> axes = jv.plots.spectrum(grid, {"D65": jv.colour_spaces.illuminant("D65", grid)})
        >>> print(axes.get_xlabel(), axes.get_xlim()[1] > 690)
        wavelength [nm] True
    """
    wavelengths, values = plain_array("wavelengths", wavelengths), plain_array("values", values)
    grid = np.asarray(wavelengths, float)
    require_metres("wavelength", grid)
    if isinstance(values, Mapping):
        named = {n: np.asarray(plain_array(n, one), float) for n, one in values.items()}
    else:
        columns = np.asarray(values, float).reshape(len(values), -1)
        names = band_names(columns.shape[1])
        named = {name: columns[:, i] for i, name in enumerate(names)}
    axes = new_axes(axes)
    for i, (name, one) in enumerate(named.items()):
        if grid.ndim != 1 or one.shape != grid.shape:
            raise InputError(
                f"spectrum {name!r} has shape {one.shape} where there are {grid.shape} wavelengths."
            )
        axes.plot(grid * 1e9, one, color=INK.get(name, OTHER_INKS[i % len(OTHER_INKS)]), label=name)
    axes.set_xlabel("wavelength [nm]")
    axes.set_ylabel(f"{label} [{unit}]" if label and unit else label or unit)
    axes.margins(x=0)
    if len(named) > 1 or isinstance(values, Mapping):
        axes.legend(fontsize=8)
    tidy(axes)
    return axes


@jax.jit
def _brdf_toward(
    material: Material, light: Float[Array, "3"], viewers: Float[Array, "n 3"]
) -> Float[Array, "n bands"]:
    """Evaluate the BRDF toward each viewer, in sr^-1."""
    return jax.vmap(lambda wo: evaluate(material, light, wo))(viewers)


def lobe(
    materials: Material | Mapping[str, Material],
    *,
    incidence: float = np.pi / 4,
    band: int = 0,
    shape_only: bool = False,
    components: bool = False,
    axes: "Axes | None" = None,
) -> "Axes":
    """Plot the BRDF of materials for one direction of light, in the plane of incidence.

    The BRDF is evaluated at every degree, and more finely where the curve is steep, so that
    highlights of any width have their full height.

    Args:
        materials: one material, or several by name.
        incidence: angle of incidence from the normal, rad, below pi / 2; the light comes from the
            left, and its direction is dotted.
        band: index of the band that is drawn.
        shape_only: whether each lobe is divided by its largest value.
        components: whether to draw also, as dashed lines, the diffuse and the specular term of each
            material that has both.
        axes: matplotlib axes to draw on, polar or Cartesian; None makes new polar ones.

    Returns:
        The axes, with the mirror direction on the right: the BRDF in sr^-1, or relative, over the
        angle from the normal, which is in degrees on Cartesian axes.

    Raises:
        InputError: for an angle of incidence outside of [0, pi / 2), and for mirrors and glass,
            which have no lobe.

    Example:
        >>> axes = jv.plots.lobe({"chalk": jv.Lambert([0.3])})
        >>> angle, radius = axes.lines[0].get_data()
        >>> print(radius[[60, 90]].round(6))
        [0.3 0.3]
    """
    from matplotlib.ticker import MaxNLocator

    if not 0 <= incidence < np.pi / 2:
        raise InputError(f"incidence is an angle from 0 to below pi / 2 rad, got {incidence:g}.")
    several = materials if isinstance(materials, Mapping) else {"": materials}
    parts = _components(several) if components else {}
    first = np.linspace(-np.pi / 2, np.pi / 2, 361)[1:-1:2]  # 180 directions above the horizon
    dtype = jnp.result_type(float)
    light = jnp.asarray([-np.sin(incidence), 0, np.cos(incidence)], dtype)
    axes = new_axes(axes, polar=True)
    polar = axes.name == "polar"
    shown_ones = [*several.items(), *parts.items()]
    for name, material in shown_ones:
        if is_delta(material):
            raise InputError(
                f"{name or type(material).__name__} reflects into one direction, which is no lobe; "
                "leave it out."
            )
    counts = {
        jax.eval_shape(_brdf_toward, material, light, light[None]).shape[1]
        for _, material in shown_ones
    }
    if not 0 <= band < min(counts - {1}, default=1):
        raise InputError(f"band {band} is outside those of the materials, {sorted(counts)}.")
    for name, material in shown_ones:

        def reflect(angle: np.ndarray, material: Material = material) -> np.ndarray:
            viewers = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
            seen = _brdf_toward(material, light, jnp.asarray(viewers, dtype))
            return np.asarray(seen)[:, band if seen.shape[1] > 1 else 0]

        # a peak is near the mirror direction or the light's direction, or at a node of a table
        peaks = [np.array([incidence, -incidence])]
        peaks += [
            s * np.ravel(n)
            for n in [getattr(material, "theta_o", None)]
            if n is not None
            for s in (-1, 1)
        ]
        angle, radius = refined(reflect, first, peaks=np.concatenate(peaks))
        shown = radius / (radius.max() or 1) if shape_only else radius
        label = name or ("sum" if parts else None)
        x = angle if polar else np.degrees(angle)
        axes.plot(x, shown, "--" if name in parts else "-", label=label)
    toward = -incidence if polar else -np.degrees(incidence)
    axes.plot([toward, toward], [0, axes.get_ylim()[1]], color="0.5", ls=":", lw=1.5)
    quantity = "over largest" if shape_only else "$f_r$ [sr$^{-1}$]"
    labelled = bool(parts) or len(several) > 1 or "" not in several
    if not polar:
        axes.set(xlabel="angle from the normal [degrees]", ylabel=quantity, xlim=(-90, 90))
        axes.set_xticks(range(-90, 91, 30))
        axes.set_ylim(bottom=0)
        if labelled:
            axes.legend(fontsize=8)
        return axes
    axes.set(theta_zero_location="N", theta_direction=-1, thetamin=-90, thetamax=90)  # type: ignore[call-arg]
    axes.set_ylim(bottom=0)
    ticks = MaxNLocator(3).tick_values(*axes.get_ylim())
    axes.set_yticks([r for r in ticks if 0 < r <= axes.get_ylim()[1]])
    axes.tick_params(labelsize=8)
    axes.annotate(  # next to the numbers of the radius, which are below its other half
        quantity,
        (np.pi / 2, axes.get_ylim()[1] / 2),
        (0, -6),
        textcoords="offset points",
        ha="center",
        va="top",
        fontsize=8,
    )
    if labelled:
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, 0.12))
    return axes


def _components(materials: Mapping[str, Material]) -> dict[str, Material]:
    """Return the diffuse and the specular term of each material that has both, by name, in
    sr^-1."""
    found = {}
    for name, material in materials.items():
        if hasattr(material, "diffuse") and hasattr(material, "specular"):
            for term, other in (("diffuse", "specular"), ("specular", "diffuse")):
                without = replace(material, **{other: 0 * getattr(material, other)})  # type: ignore[call-arg]
                found[f"{name}, {term}".removeprefix(", ")] = without
    return found


FINE = 0.01  # largest difference of neighbouring points, relative to the largest value
NARROWEST = 1e-6  # smallest distance of points, relative to the range
_AT_ONCE = 128  # number of points in one call, so that one program serves all rounds
_ROUNDS = 40


def refined(
    function: Callable[[np.ndarray], np.ndarray], places: np.ndarray, *, peaks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions, (m,) ascending, and the values of a function at these positions. The
    positions are the given positions, (n,), and further positions where the function is steep.
    Narrow peaks are searched on all scales around their possible positions."""
    low, high = places[0], places[-1]
    steps = (high - low) * np.geomspace(NARROWEST, 0.05, 24)
    about = np.concatenate([peaks, *(peaks[:, None] + sign * steps for sign in (-1, 1))], axis=None)
    x = np.unique(np.concatenate([places, about[(about > low) & (about < high)]]))
    y = _evaluate_blocks(function, x)
    for _ in range(_ROUNDS):
        jumps, gaps = np.abs(np.diff(y)), np.diff(x)
        coarse = (jumps > FINE * np.abs(y).max()) & (gaps > 2 * NARROWEST * (high - low))
        if not coarse.any():
            break
        first = np.flatnonzero(coarse)
        worst = first[np.argsort(jumps[first])[::-1][:_AT_ONCE]]
        new = (x[worst] + x[worst + 1]) / 2
        order = np.argsort(x := np.concatenate([x, new]), kind="stable")
        x, y = x[order], np.concatenate([y, _evaluate_blocks(function, new)])[order]
    return x, y


def _evaluate_blocks(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    padded = np.resize(x, -(-len(x) // _AT_ONCE) * _AT_ONCE)
    return np.concatenate([function(block) for block in padded.reshape(-1, _AT_ONCE)])[: len(x)]
