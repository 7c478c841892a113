"""Write the report of a calibration of lights, and the rig with them."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..inference.estimates import gaussian_estimate
from ..inference.parameters import Parameter
from ..report.figures import empty_panels
from ..report.section import Picture, Section, Table
from .file import HEADS, Lights, write_lights

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILE = "lights.npz"
ENLARGED = 5.0  # half axis of the ellipses in the picture, in standard deviations


def section(lights: Lights, *, root: str = ".", camera: str = "bits = 8") -> Section:
    """Report lights: outline, table, findings, picture, and the rig with `lights.npz`.

    Args:
        lights: from the calibration.
        root: folder of the images, relative to that of the rig.
        camera: lines of the rig's `[camera]`.

    Returns:
        The section.
    """
    parameters = [Parameter(name, unit="px") for name in ("column", "row", "radius")]
    return Section(
        kind="lights",
        title="Lights",
        estimates=tuple(
            gaussian_estimate(
                what, value, sd, group=f"ball {i}" if len(lights.outlines) > 1 else ""
            )
            for i, (values, sds) in enumerate(zip(lights.outlines, lights.outline_sds, strict=True))
            for what, value, sd in zip(parameters, values, sds, strict=True)
        ),
        findings=(f"{lights.heading()}.", *lights.findings),
        tables=(
            Table(
                "Positions (m)" if lights.near else "Directions",
                HEADS,
                tuple(lights.rows()),
                "Standard deviations along each axis "
                + ("of a position." if lights.near else "across a direction."),
            ),
        ),
        pictures=(
            Picture(
                "lights",
                "Where the lights are",
                "From the camera: the centre is toward it, and the circle is at 90 degrees to it. "
                f"Ellipses are {ENLARGED:.0f} standard deviations; the part that they share "
                "rotates all lights by the same angle.",
                partial(lights_figure, lights),
            ),
        ),
        records={"rig": partial(_write_rig, lights, root, camera)},
    )


def lights_figure(lights: Lights) -> "Figure":
    """Draw directions on the hemisphere toward the camera, with enlarged error ellipses."""
    from matplotlib.patches import Ellipse

    figure, axes = empty_panels((5.2, 5.2))
    axes.add_patch(Ellipse((0, 0), 2, 2, fill=False, color="0.7"))
    scale = np.linalg.norm(lights.places, axis=1)
    for i, place in enumerate(lights.places):
        x, y = place[:2] / scale[i]
        sizes, ways = np.linalg.eigh(lights.covariance[i, :2, i, :2] / scale[i] ** 2)
        width, height = 2 * ENLARGED * np.sqrt(np.maximum(sizes, 0))
        turn = np.degrees(np.arctan2(ways[1, 0], ways[0, 0]))
        axes.add_patch(Ellipse((x, y), width, height, angle=turn, alpha=0.35))
        axes.plot(x, y, "k.", markersize=4)
        axes.annotate(f"{i}", (x, y), xytext=(4, 4), textcoords="offset points", fontsize=8)
    axes.set(xlim=(-1.05, 1.05), ylim=(-1.05, 1.05), aspect="equal", xlabel="x", ylabel="y")
    return figure


def _write_rig(lights: Lights, root: str, camera: str, path: Path) -> None:
    write_lights(lights, path.with_name(FILE))
    known = np.isfinite(lights.intensities)
    entries = [
        f"""
[[light]]
file = "{file}"
{"position" if lights.near else "direction"} = [{", ".join(f"{x:.6f}" for x in place)}]
"""
        + (f"intensity = {strength:.6g}\nintensity_sd = {sd:.3g}\n" if is_known else "")
        for file, place, strength, sd, is_known in zip(
            lights.files,
            lights.places,
            lights.intensities,
            np.maximum(lights.intensity_sd, 1e-6),
            known,
            strict=True,
        )
    ]
    path.write_text(
        "# The lights of a ball. For the object under the same lights, set root to the folder of\n"
        "# its images and add [geometry]; the files have the names of the ball's.\n"
        f'root = "{root}"\ncovariance = "{FILE}"\n\n[camera]\n{camera}\n' + "".join(entries),
        encoding="utf-8",
    )
