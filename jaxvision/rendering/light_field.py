"""Record the light that leaves a scene through a window as a light field."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32

from ..core._loops.fusion import one_program
from ..core._random import Stream
from ..lights import LightFieldLight, Rule, Window
from ..lights.light_field import light_field_ray
from ..scene import Scene
from .direct import direct_along
from .pixel_loop import map_blocks
from .shadows import DEFAULT_RULE


def render_light_field(
    scene: Scene,
    aperture: Window,
    focal: Window,
    *,
    resolution: tuple[int, int, int, int],
    rule: Rule = DEFAULT_RULE,
) -> LightFieldLight:
    """Record the light field that leaves a scene through a window.

    Args:
        scene: behind the aperture.
        aperture, focal: two parallel windows, corners in m; each ray passes through one point of
            both.
        resolution: numbers of samples (s, t, u, v), s and t on the aperture. The outermost samples
            lie on the rims of the windows. An axis with one sample has it at its start.
        rule: sampling rule for extended lights without a rule of their own; a random rule draws
            anew for each ray.

    Returns:
        The light field, radiance in W m^-2 sr^-1.

    Example:
        >>> lamp = jv.Surface(jv.Disc([0, 0, -9], [0, 0, 1], 99), jv.Lambert([0.0]), [2.0])
        >>> near, far = (jv.Window([0, 0, z], [1, 0, 0], [0, 1, 0]) for z in (0, -1))
        >>> grid = (1, 1, 2, 1)
        >>> record = jax.jit(lambda scene: jv.render_light_field(scene, near, far, resolution=grid))
        >>> record(jv.Scene(lamp, [])).radiance.ravel().tolist()
        [2.0, 2.0]
    """
    radiance = _record(scene, aperture, focal, tuple(map(int, resolution)), rule)
    return LightFieldLight(radiance, aperture, focal)


@one_program
def _record(
    scene: Scene,
    aperture: Window,
    focal: Window,
    resolution: tuple[int, ...],
    rule: Rule,
) -> Float[Array, "s t u v bands"]:
    along = direct_along(scene, rule)
    axes = [jnp.linspace(0, 1, count, dtype=aperture.corner.dtype) for count in resolution]
    places = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 4)

    def block(places: Float[Array, "n 4"], numbers: UInt32[Array, " n"]) -> Float[Array, "n bands"]:
        rays = jax.vmap(lambda place: light_field_ray(aperture, focal, place))(places)
        return along(rays, Stream(numbers, None, None))

    numbers = jnp.arange(len(places), dtype=jnp.uint32)
    return map_blocks(block, places, numbers, keep=()).reshape(*resolution, -1)
