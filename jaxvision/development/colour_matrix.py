"""Matrices that convert a camera's RGB to the RGB of a colour space, fitted to spectra.

Sensitivities are not linear combinations of the colour matching functions (no camera meets Luther's
condition), so a matrix converts camera RGB to colours only approximately. The best matrix depends
on the light and on the objects. Colours are linear and relative; 1 is white.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..colour_spaces import adapt, xyz_to_rgb
from ..core._arguments import takes_numbers
from ..core._shown import Shown
from ..core._types import Spectrum, as_float, check_direction, check_fields, check_range, is_known
from ..spectra import Responses, Wavelengths, reflectance_to_xyz, spectrum_to_camera
from .white_balancing import neutral_gains


class CameraColour(Shown):
    """The conversion of a camera's RGB to a picture's RGB, for one illuminant.

    Attributes:
        gains: (3,) of white balance, no unit.
        matrix: (3, 3), no unit, from balanced camera RGB to linear RGB.
    """

    gains: Float[Array, "3"] = eqx.field(converter=as_float)
    matrix: Float[Array, "3 3"] = eqx.field(converter=as_float)

    def __check_init__(self) -> None:
        check_fields(self)


@takes_numbers
def fit_colour_matrix(
    camera: Float[Array, "patches 3"],
    wanted: Float[Array, "patches 3"],
    *,
    white: tuple[Float[Array, "3"], Float[Array, "3"]] | None = None,
    weights: Float[Array, " patches"] | None = None,
) -> Float[Array, "3 3"]:
    """Return the matrix M that minimises the sum of weights |M camera - wanted|^2.

    Args:
        camera: (patches, 3) relative, at least three patches, or two with `white`; they must span
            three dimensions.
        wanted: (patches, 3) relative.
        white: a camera colour (3,), not black, and the colour (3,) to which it must map exactly;
            None for no such constraint. The colours must then span two dimensions besides `white`.
        weights: (patches,) no unit, at least 0; None for equal weights.

    Returns:
        (3, 3) no unit.

    Raises:
        ValueError: for too few patches, unequal shapes, weights below 0, a black `white`, and
            colours that are not finite or, weighted, do not span the dimensions.

    Source: Finlayson and Drew, "White-point preserving color correction", CIC 1997, for `white`.

    Example:
        A camera that sees half of the red.

        >>> wanted = jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
        >>> matrix = jv.fit_colour_matrix(wanted * jnp.array([[0.5, 1.0, 1.0]]), wanted)
        >>> [round(float(x), 4) for x in jnp.diag(matrix)]
        [2.0, 1.0, 1.0]
    """
    least = 3 if white is None else 2
    if camera.shape != wanted.shape or camera.shape[0] < least:
        raise ValueError(
            f"camera and wanted must be (patches, 3) with at least {least} patches, got shapes "
            f"{camera.shape} and {wanted.shape}."
        )
    for name, colours in (("camera", camera), ("wanted", wanted)):
        check_range(name, colours, -jnp.inf)
    if weights is not None:
        check_range("fit_colour_matrix: weights", weights, 0)
        root = jnp.sqrt(weights)[:, None]
        camera, wanted = root * camera, root * wanted
    if white is None:
        _check_rank(camera, "camera must span 3 dimensions, but its colours do not")
        return _least_squares(camera, wanted).T
    seen, sought = white
    check_direction("fit_colour_matrix: the camera's white", seen)
    # every M with M seen = sought is `through` plus Z times the two directions perpendicular to
    # `seen`
    through = jnp.outer(sought, seen) / jnp.vdot(seen, seen)
    across = _perpendicular_pair(seen)
    beside = jnp.concatenate([camera, _size(camera) / _size(seen) * seen[None]])
    _check_rank(beside, "camera must span 2 dimensions beside white, but its colours do not")
    rest = _least_squares(camera @ across, wanted - camera @ through.T)
    return through + rest.T @ across.T


@takes_numbers
def camera_colour(
    sensitivities: Responses,
    illuminant: Wavelengths,
    reflectances: Spectrum,
    wavelengths: Wavelengths,
    observer: Responses,
    white: Float[Array, "3"],
    *,
    space: str = "sRGB",
    keep_white: bool = True,
) -> CameraColour:
    """Fit the white-balance gains of a camera under an illuminant, and the matrix from balanced to
    linear RGB.

    The matrix minimises the squared errors of the reflectances' colours in linear RGB.

    Args:
        sensitivities: (bands, 3) of the camera, relative.
        illuminant: (bands,) relative power per wavelength.
        reflectances: (patches, bands) no unit.
        wavelengths: (bands,) m.
        observer: (bands, 3) colour matching functions. All of these come from `colour_data`.
        white: (3,) relative XYZ of the white of `space`, Y = 1; colours under the light are adapted
            to it (Bradford).
        space: a name of `colour_data.rgb_to_xyz_matrix`.
        keep_white: whether perfect white maps exactly to white.

    Returns:
        The gains (3,) and the matrix (3, 3), no unit.

    Raises:
        ValueError: for fewer than three patches, two with `keep_white`.

    Example:
        A camera that sees as the standard observer does, from white (1, 1, 1) to linear sRGB.

        >>> grid = jv.colour_spaces.wavelength_grid(first=400e-9, last=700e-9, step=10e-9)
        >>> eye, light = jv.colour_spaces.observer(grid), jv.colour_spaces.illuminant("D65", grid)
        >>> white = jv.colour_spaces.white_point("D65")
        >>> found = jv.camera_colour(eye, light, jnp.eye(4, 31), grid, eye, white)
        >>> [round(float(x), 2) for x in found.matrix[0]]  # 3.2405 x 0.9505 first
        [3.08, -1.54, -0.54]
    """
    perfect = jnp.ones_like(reflectances[:1])
    lit = jnp.concatenate([reflectances, perfect])
    raw = spectrum_to_camera(lit * illuminant[None], wavelengths, sensitivities)
    gains = neutral_gains(raw[-1:])
    balanced = raw * gains[None] / jnp.max(raw[-1])
    xyz = reflectance_to_xyz(lit, wavelengths, observer, illuminant)
    rgb = xyz_to_rgb(adapt(xyz, xyz[-1], white), space=space)
    ends = (balanced[-1], rgb[-1]) if keep_white else None
    return CameraColour(gains, fit_colour_matrix(balanced[:-1], rgb[:-1], white=ends))


def _check_rank(colours: Float[Array, "patches n"], problem: str) -> None:
    """Raise `ValueError` for known colours that span less than all dimensions."""
    if is_known(colours) and np.linalg.matrix_rank(np.asarray(colours)) < colours.shape[1]:
        raise ValueError(f"{problem}; add patches, or raise weights that are 0.")


def _size(colours: Float[Array, "..."]) -> Float[Array, ""]:
    return jnp.sqrt(jnp.sum(colours**2))


def _least_squares(
    a: Float[Array, "rows unknowns"], b: Float[Array, "rows 3"]
) -> Float[Array, "unknowns 3"]:
    import lineax as lx

    operator, solver = lx.MatrixLinearOperator(a), lx.QR()
    return jax.vmap(
        lambda column: lx.linear_solve(operator, column, solver).value, in_axes=1, out_axes=1
    )(b)


def _perpendicular_pair(v: Float[Array, "3"]) -> Float[Array, "3 2"]:
    """Return two orthonormal vectors perpendicular to v, as columns, from the Householder
    reflection that maps v to the first axis.
    """
    length = jnp.sqrt(jnp.vdot(v, v))
    axis = jnp.zeros_like(v).at[0].set(jnp.where(v[0] < 0, -length, length))
    mirror = v + axis
    return (jnp.eye(3, dtype=v.dtype) - 2 * jnp.outer(mirror, mirror) / jnp.vdot(mirror, mirror))[
        :, 1:
    ]
