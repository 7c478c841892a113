"""Lamps with a measured distribution of intensity, as in photometric files.

The intensity is bilinear between the nodes of two angles, and 0 beyond the outermost nodes. In the
lamp's own frame z is up, and x is the photometric horizontal. The two angles are defined by the
photometric system of planes, C, B or A:

    C   vertical: from straight down, -z; horizontal: about z, counter-clockwise from above
    B   vertical: from the plane of y and z toward x; horizontal: about x, from -z toward -y
    A   vertical: from the plane of x and y up; horizontal: about z, clockwise from above

Source: ANSI/IESNA LM-63-2002. Angles are in rad. All functions are for one direction; use
`jax.vmap` for many.
"""

from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..core._arguments import takes_numbers
from ..core._bounds import Ends, Source, numbers
from ..core._kinds import Photometry
from ..core._numerics import (
    arctan2,
    divide,
    dot,
    norm,
    normalize,
    reciprocal,
    safe_sqrt,
    unknown_at_nan,
)
from ..core._quadrature import gauss_legendre
from ..core._shown import Shown
from ..core._types import (
    AMOUNT,
    ASKEW,
    ArrayLike,
    Colour,
    Range,
    Scalar,
    as_float,
    check_choice,
    check_direction,
    check_fields,
    check_rotation,
    is_known,
)
from ..core._vector import Direction, Vec, Vector, as_array, as_vec
from ..geometry import Ray
from ..geometry.hemisphere import cross, local_frame, to_world, uniform_direction
from ..scene import Light
from ..spectra import LUMINOUS_EFFICACY
from ._emission import emitted_from_point
from ._registry import Emitted, Incident, Seen, register, register_extended
from .point import _place_bound, _toward
from .window import Window, _window_bound, hit_window, window_pdf, window_sample

System = Literal["C", "B", "A"]
_TURN = 2 * np.pi
_HALF = {"vertical": (-np.pi / 2, np.pi / 2), "horizontal": (-np.pi / 2, np.pi / 2)}
_SPAN = {
    "C": {"vertical": (0.0, np.pi), "horizontal": (-2 * _TURN, 2 * _TURN)},
    "B": _HALF,
    "A": _HALF,
}  # rad, the smallest and largest angles of each system


class GoniometricLight(Light):
    """A lamp with a measured distribution of intensity, whose size is small compared with all
    distances.

    Use `goniometric_light` to make this lamp from the contents of a photometric file.

    Attributes:
        position: (3,) m.
        intensity: (bands,) W sr^-1, where the distribution is 1.
        distribution: (v, h) relative intensity, no unit, at the nodes.
        vertical: (v,) rad, increasing nodes, at least two.
        horizontal: (h,) rad, increasing nodes; a single node for a lamp that is rotationally
            symmetric. In system C the nodes span a whole turn.
        rotation: (3, 3), rows the lamp's x, y and z axes in the world, no unit.
        system: "C", "B" or "A"; static.

    Raises:
        ValueError: for angles that do not increase or lie beyond those of the system, as angles in
            degrees do; for values of the distribution below 0 or not finite; for a `rotation` that
            is not a rotation matrix.

    Example:
        >>> down = jnp.array([[1.0], [0.0]])  # bright straight down, dark at the horizon
        >>> angles = [0, np.pi / 2], [0.0]
        >>> lamp = jv.GoniometricLight([0, 0, 2], [8.0], down, *angles)
        >>> for x in (0.0, 2.0):
        ...     print(jv.incident(lamp, jnp.array([x, 0, 0])).irradiance.round(3))
        [2.]
        [0.5]
    """

    spectra = ("intensity",)
    position: Float[Array, "3"] = eqx.field(converter=as_float)
    intensity: Colour = eqx.field(converter=as_float)
    distribution: Float[Array, "v h"] = eqx.field(converter=as_float)
    vertical: Float[Array, " v"] = eqx.field(converter=as_float)
    horizontal: Float[Array, " h"] = eqx.field(converter=as_float)
    rotation: Float[Array, "3 3"] = eqx.field(converter=as_float, default_factory=lambda: np.eye(3))
    system: System = eqx.field(static=True, default="C", kw_only=True)

    def __check_init__(self) -> None:
        _check(self)
        check_rotation("GoniometricLight.rotation", self.rotation, "x, y and z")


class GoniometricAreaLight(Light):
    """A lamp with a measured distribution of intensity, whose light leaves all parts of a rectangle
    evenly.

    Each part of the rectangle emits the lamp's distribution, in proportion to its area. The edges
    define the lamp's own frame: x is along `edge_u`, and -z is along edge_u x edge_v. The lamp
    emits only toward its -z side.

    Attributes:
        corner: (3,) m.
        edge_u: (3,) m, from the corner along the lamp's x.
        edge_v: (3,) m, along the other side, at a right angle to the first.
        intensity: (bands,) W sr^-1 of the whole lamp, where the distribution is 1.
        distribution, vertical, horizontal, system: as of `GoniometricLight`.

    Raises:
        ValueError: as `GoniometricLight`, and for edges of length 0 or not at a right angle.

    Example:
        >>> even = np.ones((2, 1)), [0, np.pi / 2], [0.0]
        >>> lamp = jv.GoniometricAreaLight([-1, 1, 2], [2, 0, 0], [0, -2, 0], [8.0], *even)
        >>> up, rule = jnp.array([0.0, 0.0, 1.0]), jv.Quadrature(32)
        >>> print(jv.irradiance(lamp, jnp.zeros(3), up, rule=rule).round(2))  # a point's: 2
        [1.61]
    """

    spectra = ("intensity",)
    corner: Float[Array, "3"] = eqx.field(converter=as_float)
    edge_u: Float[Array, "3"] = eqx.field(converter=as_float)
    edge_v: Float[Array, "3"] = eqx.field(converter=as_float)
    intensity: Colour = eqx.field(converter=as_float)
    distribution: Float[Array, "v h"] = eqx.field(converter=as_float)
    vertical: Float[Array, " v"] = eqx.field(converter=as_float)
    horizontal: Float[Array, " h"] = eqx.field(converter=as_float)
    system: System = eqx.field(static=True, default="C", kw_only=True)

    def __check_init__(self) -> None:
        _check(self)
        for name in ("edge_u", "edge_v"):
            check_direction(f"GoniometricAreaLight.{name}", getattr(self, name))
        if not (is_known(self.edge_u) and is_known(self.edge_v)):
            return
        u, v = np.asarray(self.edge_u, float), np.asarray(self.edge_v, float)
        cosine = float(u @ v / (np.linalg.norm(u) * np.linalg.norm(v)))
        if abs(cosine) > ASKEW:
            raise ValueError(
                "GoniometricAreaLight: edge_u and edge_v must be at a right angle, got "
                f"{np.degrees(np.arccos(cosine)):.4g} degrees."
            )


Goniometric = GoniometricLight | GoniometricAreaLight


def _check(light: Goniometric) -> None:
    check_fields(light, intensity=AMOUNT, distribution=Range(0))
    kind = type(light).__name__
    check_choice(f"{kind}.system", light.system, ("C", "B", "A"))
    if light.vertical.shape[0] < 2:
        raise ValueError(f"{kind}.vertical must have two nodes or more, got one.")
    for name in ("vertical", "horizontal"):
        nodes = getattr(light, name)
        low, high = _SPAN[light.system][name]
        if is_known(nodes) and not (
            np.all(np.asarray(nodes) >= low - 1e-4) and np.all(np.asarray(nodes) <= high + 1e-4)
        ):
            raise ValueError(
                f"{kind}.{name} must be in rad, from {low:.5g} to {high:.5g} in system "
                f"{light.system}, got {np.asarray(nodes).tolist()}."
            )
        if is_known(nodes) and np.any(np.diff(nodes) <= 0):
            raise ValueError(f"{kind}.{name} must increase.")
    turns = light.horizontal
    if light.system == "C" and turns.shape[0] > 1 and is_known(turns):
        span = float(np.ptp(np.asarray(turns)))
        if abs(span - _TURN) > 1e-4:
            raise ValueError(f"{kind}.horizontal must span a turn (6.2832 rad), got {span:g}.")


@takes_numbers
def relative_intensity(light: Goniometric, direction: Direction) -> Scalar:
    """Return the relative intensity of a lamp toward a direction in its own frame.

    Args:
        light: the lamp.
        direction: (3,) unit, away from the lamp, in its own frame.

    Returns:
        () bilinear between the nodes, 0 beyond the outermost nodes, no unit.

    Example:
        >>> lamp = jv.GoniometricLight([0, 0, 2], [8.0], [[1.0], [0.0]], [0, np.pi / 2], [0.0])
        >>> print(jv.lights.relative_intensity(lamp, [0.0, 0.8, -0.6]).round(4))  # at 53 degrees
        0.4097
    """
    vertical, horizontal = _angles(as_vec(direction), light.system)
    rows = _interpolation_nodes(light.vertical, vertical)
    if light.horizontal.shape[0] == 1:
        columns = jnp.zeros((), int), jnp.zeros((), int), 0 * vertical, True
    else:
        if light.system == "C":
            first = light.horizontal[0]
            horizontal = first + jnp.mod(horizontal - first, _TURN)
        columns = _interpolation_nodes(light.horizontal, horizontal)
    (i, j, s, above), (k, m, t, within) = rows, columns
    table = light.distribution
    upper = (1 - t) * table[i, k] + t * table[i, m]
    lower = (1 - t) * table[j, k] + t * table[j, m]
    found = jnp.where(above & within, (1 - s) * upper + s * lower, 0)
    return unknown_at_nan(found, direction)


def _angles(w: Vec, system: System) -> tuple[Scalar, Scalar]:
    """Return the angles (vertical, horizontal) of a unit direction in the lamp's frame, rad."""
    x, y, z = w
    match system:
        case "C":
            return _angle_to_axis(x, y, -z), _azimuth(y, x)
        case "B":
            return jnp.pi / 2 - _angle_to_axis(y, z, x), _azimuth(-y, -z)
        case "A":
            return jnp.pi / 2 - _angle_to_axis(x, y, z), _azimuth(-y, x)


def _angle_to_axis(a: Scalar, b: Scalar, along: Scalar) -> Scalar:
    """Return the angle to an axis of a vector with component `along` the axis and components `a`
    and `b` across it, in rad; 0 for the zero vector."""
    aside = safe_sqrt(a * a + b * b)
    defined = (aside > 0) | (along != 0)
    return arctan2(aside, jnp.where(defined, along, 1))


def _azimuth(y: Scalar, x: Scalar) -> Scalar:
    """Return the azimuth of (x, y) in rad; 0, with gradient 0, for the zero vector."""
    aside = (x != 0) | (y != 0)
    return jnp.where(aside, jnp.arctan2(jnp.where(aside, y, 0), jnp.where(aside, x, 1)), 0)


def _interpolation_nodes(
    nodes: Float[Array, " n"], x: Scalar
) -> tuple[Array, Array, Scalar, Array]:
    """Return the indices of the two nodes next to `x`, the interpolation weight of the second one,
    and whether `x` lies between the outermost nodes, up to rounding."""
    last = nodes.shape[0] - 1
    i = jnp.clip(jnp.searchsorted(nodes, x, side="right") - 1, 0, last - 1)
    share = (x - nodes[i]) / (nodes[i + 1] - nodes[i])
    slack = 8 * jnp.finfo(x.dtype).eps * jnp.pi
    return i, i + 1, jnp.clip(share, 0, 1), (x >= nodes[0] - slack) & (x <= nodes[last] + slack)


@takes_numbers
def flux(light: Goniometric) -> Colour:
    """Return the radiant flux of a lamp, by Gauss-Legendre quadrature in each interval between
    nodes.

    Args:
        light: the lamp.

    Returns:
        (bands,) W, the integral of the intensity in W sr^-1 over all directions; in lm if the
        intensity is in cd.

    Example:
        >>> even = np.ones((2, 1)), [0, np.pi], [0.0]
        >>> print(jv.lights.flux(jv.GoniometricLight([0, 0, 2], [1.0], *even)).round(4))  # 4 pi
        [12.5664]
    """
    density = jnp.sin if light.system == "C" else jnp.cos
    solid = _weights(light.vertical, density)
    around = jnp.full(1, _TURN, solid.dtype)
    if light.horizontal.shape[0] > 1:
        around = _weights(light.horizontal, jnp.ones_like)
    return light.intensity * (solid @ light.distribution @ around)


def _weights(nodes: Float[Array, " n"], density) -> Float[Array, " n"]:
    """Return, for each node, the integral of a density times the piecewise linear function that is
    1 at this node and 0 at all others."""
    t, dt = (jnp.asarray(x, nodes.dtype) for x in gauss_legendre(8))
    wide = jnp.diff(nodes)
    within = density(nodes[:-1, None] + wide[:, None] * t[None, :]) * (wide[:, None] * dt[None, :])
    falling, rising = within @ (1 - t), within @ t
    return jnp.pad(falling, (0, 1)) + jnp.pad(rising, (1, 0))


# ---------------------------------------------------------------- a point


def from_goniometric_light(light: GoniometricLight, point: Vector) -> Incident:
    """Return the light that arrives from a lamp: the unit direction, the irradiance E = I / d^2 on
    a surface that faces it, (bands,) W m^-2, and the distance d, m. Here I is the intensity in that
    direction. Direction, irradiance and distance are 0 at the lamp itself."""
    direction, distance, dilution = _toward(light.position, point)
    own = Vec(*(dot(row, -as_vec(direction)) for row in map(as_vec, light.rotation)))
    share = relative_intensity(light, own)
    return Incident(direction, light.intensity * (share * dilution), distance)


def _place(light: Ends[GoniometricLight]) -> Source:
    """Return upper bounds on the light: a point light with the lamp's largest intensity in all
    directions."""
    source = _place_bound(light)
    largest = max(float(np.abs(numbers(end.distribution)).max()) for end in light)
    return source._replace(spectrum=source.spectrum * largest)


# ---------------------------------------------------------------- an opening


def _window(light: GoniometricAreaLight) -> Window:
    return Window(light.corner, light.edge_u, light.edge_v)


def _relative_intensity(light: GoniometricAreaLight, away: Vec) -> tuple[Scalar, Scalar]:
    """Return the lamp's relative intensity toward a direction, and the cosine between the direction
    and the front's normal, no unit."""
    across = cross(light.edge_u, light.edge_v)
    x, down = as_vec(normalize(light.edge_u)), as_vec(normalize(across))
    y = cross(x, down)
    local = Vec(dot(x, away), dot(y, away), -dot(down, away))
    return relative_intensity(light, local), -local.z


def _area(light: GoniometricAreaLight) -> Scalar:
    return norm(cross(light.edge_u, light.edge_v))


def _radiance_along(light: GoniometricAreaLight, ray: Ray) -> Seen:
    """Return the radiance I / (A cos(theta)) of the lamp's front along a ray, W m^-2 sr^-1, and the
    distance, m. Here I is the intensity, A the area, and theta the angle to the normal."""
    at, hit = hit_window(ray, _window(light))
    share, cosine = _relative_intensity(light, -as_vec(ray.direction))
    radiance = divide(share, _area(light) * cosine, where=hit & (cosine > 0))
    return Seen(jnp.where(hit, at.distance, jnp.inf), light.intensity * radiance)


def _sample(light: GoniometricAreaLight, point: Vector, u: Float[Array, "2"]) -> Incident:
    direction, distance, solid_angle, _ = window_sample(_window(light), point, u)
    share, cosine = _relative_intensity(light, -direction)
    per_area = divide(solid_angle * share, _area(light) * cosine, where=solid_angle > 0)
    wi = direction if not isinstance(point, Array) else as_array(direction)
    return Incident(wi, light.intensity * per_area, distance, reciprocal(solid_angle))


def _pdf(light: GoniometricAreaLight, point: Vector, wi: Direction) -> Scalar:
    return window_pdf(_window(light), point, wi)


def _emit(light: GoniometricAreaLight, u: Float[Array, "4"]) -> Emitted:
    """Draw a ray from the lamp's front, uniform by area and over the hemisphere of directions. The
    flux of the ray is 2 pi I, W, where I is the intensity in its direction."""
    normal = normalize(cross(light.edge_u, light.edge_v))
    origin = as_vec(light.corner + u[0] * light.edge_u + u[1] * light.edge_v)
    direction = as_vec(to_world(local_frame(normal), uniform_direction(u[2:])))
    share, _ = _relative_intensity(light, direction)
    ray = emitted_from_point(origin, direction, _TURN * share * light.intensity)
    return Emitted(ray.ray, ray.flux, as_vec(normal))


def _opening(light: Ends[GoniometricAreaLight]) -> Source:
    """Return upper bounds on the light: a window with the lamp's largest radiance I / (A
    cos(theta)). Between two nodes, cos(theta) is at least its value at the node farther from the
    normal. In the interval that ends at 90 degrees, where I is 0, cos(theta) is at least 2 / pi
    times the angle to the horizon."""
    each = [_largest_radiance(end) for end in light]
    spectrum = np.maximum(*each)
    why = "" if np.isfinite(spectrum).all() else "its opening shines along its own plane"
    bare = Ends(*(_Bare(end.corner, end.edge_u, end.edge_v, spectrum) for end in light))
    return _window_bound(bare, bare)._replace(why=why)


class _Bare(eqx.Module):
    corner: Array
    edge_u: Array
    edge_v: Array
    radiance: Any


def _largest_radiance(light: GoniometricAreaLight) -> np.ndarray:
    u, v = numbers(light.edge_u), numbers(light.edge_v)
    table = numbers(light.distribution)
    if light.system != "C":
        return np.full(light.intensity.shape, np.inf)
    vertical, largest = numbers(light.vertical), table.max(1)
    vertical = np.where(np.abs(vertical - np.pi / 2) < 1e-6, np.pi / 2, vertical)  # of float32
    below = vertical < np.pi / 2
    at_horizon = np.interp(np.pi / 2, vertical, largest, right=0)
    if at_horizon > 1e-12 * table.max():  # more than the rounding of a cosine
        return np.full(light.intensity.shape, np.inf)
    left = np.pi / 2 - vertical[below]
    after = np.append(left[1:], 0)
    i = largest[below]
    nearer = np.maximum(i, np.append(i[1:], 0))
    bound = np.where(after > 0, nearer / np.sin(np.maximum(after, 1e-9)), np.pi / 2 * i / left)
    area = np.linalg.norm(np.cross(u, v))
    return numbers(light.intensity) * float(bound.max(initial=0)) / area


# ---------------------------------------------------------------- lamps from photometric files


class Luminaire(Shown):
    """The contents of a photometric file, as `jaxvision.files.read_luminaire` reads it.

    Attributes:
        candela: (v, h) cd, ballast factors included.
        vertical: (v,) rad.
        horizontal: (h,) rad, completed by symmetry.
        opening: (3,) m, size of the luminous opening along the lamp's x, y and z; 0 for a point.
        lumens: () lm of all light sources in the lamp, NaN if the file does not give it.
        watts: () W of electric power.
        system: "C", "B" or "A"; static.
        name: the lamp's name in the file; static.

    Example:
        >>> angles = [0, np.pi / 2], [0.0]
        >>> lamp = jv.Luminaire([[100.0], [0.0]], *angles, [0.6, 0.6, 0.0], 400.0, 5.0)
        >>> print(jv.lights.flux(jv.goniometric_light(lamp, [0, 0, 2])).round(3))  # W of light
        [0.334]
    """

    candela: Float[Array, "v h"] = eqx.field(converter=as_float)
    vertical: Float[Array, " v"] = eqx.field(converter=as_float)
    horizontal: Float[Array, " h"] = eqx.field(converter=as_float)
    opening: Float[Array, "3"] = eqx.field(converter=as_float)
    lumens: Scalar = eqx.field(converter=as_float)
    watts: Scalar = eqx.field(converter=as_float)
    system: System = eqx.field(static=True, default="C", kw_only=True)
    name: str = eqx.field(static=True, default="", kw_only=True)

    def __check_init__(self) -> None:
        check_fields(self, candela=AMOUNT)


def goniometric_light(
    luminaire: Luminaire,
    position: ArrayLike,
    *,
    up: ArrayLike = (0.0, 0.0, 1.0),
    toward: ArrayLike = (1.0, 0.0, 0.0),
    colour: ArrayLike = (1.0,),
    opening: bool = False,
) -> Goniometric:
    """Place a lamp from a photometric file in the scene. Luminous flux is converted to radiant flux
    at 683 lm per W.

    Args:
        luminaire: contents of the lamp's file.
        position: (3,) m, of the middle of its luminous opening.
        up: (3,) direction of the lamp's own z axis in the world. If it points up, the light of a
            downlight goes down.
        toward: (3,) direction of the lamp's photometric horizontal, its x axis. Its component along
            `up` is ignored.
        colour: (bands,) share of its light in each band, no unit.
        opening: whether to spread its light over the rectangle of the file's luminous opening. A
            round opening becomes a square of the same area. This is the better model near the lamp.

    Returns:
        A `GoniometricLight`, or with `opening` a `GoniometricAreaLight`.

    Raises:
        ValueError: for `opening` if the file has none or the lamp also shines upward, and for axes
            on one line.

    Example:
        >>> bulb = jv.Luminaire(np.full((2, 1), 54.0), [0, np.pi], [0.0], [0, 0, 0], 679.0, 9.0)
        >>> lamp = jv.goniometric_light(bulb, [0, 0, 2], colour=[0.5, 0.3, 0.2])
        >>> print(jv.incident(lamp, jnp.zeros(3)).irradiance.round(5))  # 54 / 683 / 2^2
        [0.00988 0.00593 0.00395]
    """
    z = np.asarray(up, float)
    y = np.cross(z, np.asarray(toward, float))
    if np.linalg.norm(y) <= 1e-9 * np.linalg.norm(z):
        raise ValueError("up and toward lie on one line; give another toward.")
    axes = np.stack([np.cross(y, z), y, z])
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    intensity = np.atleast_1d(colour) / LUMINOUS_EFFICACY
    table = luminaire.candela, luminaire.vertical, luminaire.horizontal
    if not opening:
        return GoniometricLight(position, intensity, *table, axes, system=luminaire.system)
    size = np.asarray(luminaire.opening, float)
    if min(size[:2]) <= 0:
        raise ValueError("the photometric file has no luminous opening; leave out opening.")
    if luminaire.system != "C" or np.any(luminaire.candela[luminaire.vertical > np.pi / 2 + 1e-6]):
        raise ValueError("a lamp that shines upward too has no single opening; leave out opening.")
    u, v = size[0] * axes[0], -size[1] * axes[1]
    corner = np.asarray(position, float) - (u + v) / 2
    return GoniometricAreaLight(corner, u, v, intensity, *table)


def _from_file(
    *,
    file: Photometry,
    position: Float[Array, "3"],
    up: Float[Array, "3"] = (0.0, 0.0, 1.0),  # type: ignore[assignment]
    toward: Float[Array, "3"] = (1.0, 0.0, 0.0),  # type: ignore[assignment]
    colour: Colour = 1.0,  # type: ignore[assignment]
    opening: bool = False,
) -> Goniometric:
    """A lamp with the photometric data of its IES or EULUMDAT file; `opening` spreads its light
    over the luminous opening.

    Args:
        file: path of the photometric data, relative to the scene file.
        position: (3,) m, of the middle of the lamp's luminous opening.
        up: (3,) direction of the lamp's own z axis in the world.
        toward: (3,) direction of the lamp's photometric horizontal, its x axis; its component along
            `up` is ignored.
        colour: (bands,) share of the light in each band, no unit.
        opening: whether to spread the light over the rectangle of the luminous opening, which is
            the better model near the lamp.
    """
    return goniometric_light(
        file, position, up=up, toward=toward, colour=np.asarray(colour), opening=opening
    )


register(
    GoniometricLight,
    incident=from_goniometric_light,
    bound=_place,
    from_file=_from_file,
)
register_extended(
    GoniometricAreaLight,
    seen=_radiance_along,
    sample=_sample,
    pdf=_pdf,
    emitted=_emit,
    bound=_opening,
    word="",
)
