"""The Cornell box: published geometry, in metres, and its colours as linear RGB.

Geometry: Cornell University Program of Computer Graphics, "Cornell Box Data" (2005), millimetres
there. The published faces are quadrilaterals that differ from parallelograms by up to 6.4 mm
(three walls are twisted). Here every face is the parallelogram of its first corner and the two
beside it, and the room is the closed box of the ceiling's size, so that a ray cannot leave through
a gap. Colours and lamp: Mitsuba's "cbox", the measured spectra as RGB.
"""

import numpy as np

WIDTH, HEIGHT, DEPTH = 0.556, 0.5488, 0.5592
BELOW_CEILING = 0.0005  # m, distance of the lamp from the ceiling
WHITE = (0.885809, 0.698859, 0.666422)
GREEN = (0.105421, 0.37798, 0.076425)
RED = (0.570068, 0.0430135, 0.0443706)
RADIANCE = (18.387, 13.9873, 6.75357)  # of the lamp
EYE, TARGET, UP = (0.278, 0.273, -0.8), (0.278, 0.273, 0.0), (0.0, 1.0, 0.0)
FOCAL_LENGTH, FILM = 0.035, 0.025

# first corner and its two neighbours, counterclockwise as seen from the visible side
_ROOM = (
    ((0, 0, 0), (0, 0, DEPTH), (WIDTH, 0, 0)),  # floor
    ((0, HEIGHT, 0), (WIDTH, 0, 0), (0, 0, DEPTH)),  # ceiling
    ((0, 0, DEPTH), (0, HEIGHT, 0), (WIDTH, 0, 0)),  # back
    ((0, 0, 0), (0, HEIGHT, 0), (0, 0, DEPTH)),  # right
    ((WIDTH, 0, 0), (0, 0, DEPTH), (0, HEIGHT, 0)),  # left
)
_ROOM_COLOURS = (WHITE, WHITE, WHITE, GREEN, RED)
# (x, z) of the top's first corner and of its two neighbours, and the height
_SHORT = ((0.130, 0.065), (0.082, 0.225), (0.290, 0.114), 0.165)
_TALL = ((0.423, 0.247), (0.265, 0.296), (0.472, 0.406), 0.330)


def _block(first, beside, other, height):
    """Return four sides and a top as (corner, edge_u, edge_v), with fronts outside."""
    u, v = np.subtract(beside, first), np.subtract(other, first)
    base = np.array([first[0], 0, first[1]])
    along, across = np.array([u[0], 0, u[1]]), np.array([v[0], 0, v[1]])
    if np.cross(along, across)[1] < 0:
        along, across = across, along
    up = np.array([0, height, 0])
    return [
        (base + up, along, across),
        (base, along, up),
        (base + along, across, up),
        (base + along + across, -along, up),
        (base + across, -across, up),
    ]


FACES = [tuple(np.array(x, float) for x in face) for face in _ROOM]
FACES += [face for block in (_SHORT, _TALL) for face in _block(*block)]
ALBEDOS = np.array([*_ROOM_COLOURS, *[WHITE] * 10])
LAMP = (
    np.array([0.213, HEIGHT - BELOW_CEILING, 0.227]),
    np.array([0.130, 0, 0]),
    np.array([0, 0, 0.105]),
)


def scene(*, emissive_surface=False):
    """Return the box as a `Scene` of Lambertian surfaces. The lamp is a `RectangleLight` or a black
    surface with emission."""
    from jaxvision import Lambert, RectangleLight, Scene, Surface
    from jaxvision.scene import Quad

    surfaces = [
        Surface(Quad(*face), Lambert(albedo / np.pi))
        for face, albedo in zip(FACES, ALBEDOS, strict=True)
    ]
    if emissive_surface:
        lamp = Surface(Quad(*LAMP), Lambert(np.zeros(3)), emission=np.array(RADIANCE))
        return Scene([*surfaces, lamp], [])
    return Scene(surfaces, [RectangleLight(*LAMP, np.array(RADIANCE))])


def view(side):
    """Return the published camera with `side` x `side` pixels."""
    import jax.numpy as jnp

    from jaxvision import Pinhole, look_at

    rotation = look_at(jnp.asarray(EYE), jnp.asarray(TARGET), jnp.asarray(UP))
    return Pinhole(EYE, rotation, FOCAL_LENGTH, FILM / side, resolution=(side, side))
