"""Tests bounds on the light from materials and skies, by angles and by integrals in NumPy."""

import numpy as np
import pytest
from oracles.direct_light import eon, oren_nayar, picture, reflected

import jaxvision as jv
from jaxvision import effects
from jaxvision.effects.radiance import scene_stage
from jaxvision.effects.reflection import reflection_of
from jaxvision.effects.stages import Ends

UP = np.array([0.0, 0, 1])
NARROW = 40.0, 200.0  # exponents
FAMILIES = [
    *(kind([0.0], [1.0], n) for kind in (jv.Phong, jv.NormalisedPhong, jv.Blinn) for n in NARROW),
    *(
        kind([0.0], [1.0], n)
        for kind in (jv.PhongBRDF, jv.BlinnBRDF, jv.NormalisedBlinn)
        for n in NARROW
    ),
    *(
        kind([0.0], [1.0], c)
        for kind in (jv.GaussianLobe, jv.GaussianLobeBRDF)
        for c in (5.0, 20.0)
    ),
    *(jv.TorranceSparrow([0.0], [1.0], a) for a in (0.2, 0.5)),
]


def directions(polar, azimuth):
    polar, azimuth = np.broadcast_arrays(polar, azimuth)
    x, y = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth)
    return np.stack([x, y, np.cos(polar)], -1).reshape(-1, 3)


def suprema(material):
    return reflection_of(Ends(material, material))


@pytest.mark.parametrize("form", ["qualitative", "full", "eon"])
@pytest.mark.parametrize("sigma", [0.0, 0.003, 0.1, 0.5, 1.0])
def test_rough_bodies_stay_below_their_bound_down_to_the_horizon(sigma, form):
    """Towards the horizon f_r grows as the cosine falls, so a bound on f_r alone cannot hold."""
    rng = np.random.default_rng(0)
    material = jv.EON([0.2], sigma) if form == "eon" else jv.OrenNayar([0.2], sigma, form=form)
    by_angles = eon if form == "eon" else oren_nayar
    polar = np.pi / 2 * (1 - rng.random((2, 20_000)) ** 3)
    wi, wo = (directions(p, 2 * np.pi * rng.random(p.size)) for p in polar)
    own, cosine = suprema(material), wi[:, 2]
    f = by_angles(material, np.broadcast_to(UP, wi.shape), wi, wo)[:, 0]
    share = (1 - own.grazing) * cosine + own.grazing
    assert np.all(f * cosine <= own.body[0] * share * (1 + 1e-9))
    allowed = own.plain * share + own.body[0] * own.grazing
    assert np.all(np.abs(f - 0.2) * cosine <= allowed * (1 + 1e-9) + 1e-15)
    assert (sigma == 0) == (np.max(allowed) == 0)


@pytest.mark.parametrize("material", FAMILIES)
def test_a_lobe_reflects_at_most_its_size(material):
    """The integral over a uniform sky uses nodes concentrated around the mirror direction."""
    steps = 240
    off, turn = np.pi * ((np.arange(steps) + 0.5) / steps) ** 2, 2 * np.pi * np.arange(48) / 48
    weight = (
        np.repeat(np.sin(off) * 2 * np.pi * (np.arange(steps) + 0.5) / steps**2, 48)
        / 48
        * 2
        * np.pi
    )
    for tilt in (0.0, 0.7, 1.2):
        mirror, seen = directions(tilt, np.pi)[0], directions(tilt, 0.0)
        across = np.array([np.cos(tilt), 0, np.sin(tilt)])
        local = directions(off[:, None], turn)
        wi = local @ np.stack([across, np.cross(mirror, across), mirror])
        f = reflected(material, np.broadcast_to(UP, wi.shape), wi, np.repeat(seen, len(wi), 0))
        lobe = suprema(material).lobe
        assert lobe is not None
        assert weight @ f[:, 0] <= lobe.size * (1 + 1e-3)


def test_skies_add_where_they_are_seen():
    """A pixel without a surface shows all skies."""
    skies = [jv.lights.environment_map(np.full((3, 6, 2), 1.0) * s) for s in ([1.0, 2], [3.0, 1])]
    ball = jv.Surface(jv.Sphere([0, 0, 5], 0.1), jv.Lambert([0.1, 0.1]))
    view = jv.Pinhole([0, 0, 0], np.eye(3), 0.05, 0.01, resolution=(4, 4))
    scene = jv.Scene([ball], skies)
    brightest = picture(scene, view).max((0, 1))
    np.testing.assert_allclose(brightest, [4, 3])
    _, arriving, _ = scene_stage(Ends(scene, scene), Ends(view, view))
    assert np.all(arriving.radiance >= [4, 3])
    lamp = jv.RectangleLight([-0.1, -0.1, 4], [0, 0.2, 0], [0.2, 0, 0], [0.0, 0.0])
    behind = jv.Scene([ball], [*skies, lamp])
    hidden = next(e for e in effects.inspect(behind, view) if e.name == "lights[2]")
    assert hidden.bound >= 4


@pytest.mark.parametrize("family", [jv.Phong, jv.PhongBRDF, jv.NormalisedPhong])
@pytest.mark.parametrize(
    "exponents", [(0.0, 0.0), (0.1, 0.1), (0.5, 0.5), (0.1, 2.0), (1.0, 1.5), (1.5, 2.5)]
)
def test_the_slope_of_a_power_of_a_cosine(family, exponents):
    """The reference takes differences of cos^n over 2e5 angles, for exponents in the range. Below 1
    the slope is infinite."""
    slope = reflection_of(Ends(*(family([0.0], [1.0], n) for n in exponents))).lobe.slope
    theta = np.linspace(0, np.pi / 2, 200_001)
    with np.errstate(invalid="ignore"):
        steepest = [
            np.abs(np.diff(np.cos(theta) ** n)).max() / theta[1] for n in np.linspace(*exponents, 5)
        ]
    scale = (exponents[1] + 2) / (2 * np.pi) if family is jv.NormalisedPhong else 1.0
    if exponents[0] < 1:
        assert slope == np.inf
    else:
        assert scale * max(steepest) * (1 - 1e-6) <= slope <= scale * (max(steepest) + 1.01)


def test_a_broad_lobe_whose_edge_crosses_a_lamp():
    """The lobe is cos^n of the mirror angle with n = 0.1, and half of the lamp is beyond its
    end."""
    n, side, far = 0.1, 2.0, 100.0
    polar = np.radians(60)
    to_lamp, tilt = (
        np.array([np.sin(polar), 0, np.cos(polar)]),
        np.array([np.cos(polar), 0, -np.sin(polar)]),
    )
    u, v = side * tilt, side * np.array([0, 1.0, 0])
    u, v = (u, v) if np.cross(u, v) @ to_lamp < 0 else (v, u)
    eye = np.array([np.sin(np.radians(30)), 0, np.cos(np.radians(30))])

    def radiance(place, weight):
        r2 = (place**2).sum(-1)
        wi = place / np.sqrt(r2)[:, None]
        cos_l = (place @ -np.cross(u, v)) / np.linalg.norm(np.cross(u, v)) / np.sqrt(r2)
        cosine = np.maximum((wi * [-1, -1, 1]) @ eye, 0)
        return (np.where(cosine > 0, cosine**n, 0) * wi[:, 2] * cos_l / r2 * weight).sum()

    t = (np.arange(400) + 0.5) / 400 - 0.5
    s, t = (x.ravel()[:, None] for x in np.meshgrid(t, t))
    middle = far * to_lamp
    many = radiance(middle + s * u + t * v, 1e4 * side**2 / len(s))
    once = radiance(middle[None], 1e4 * side**2)
    floor = jv.Quad([-0.01, -0.01, 0], [0.02, 0, 0], [0, 0.02, 0])
    light = jv.RectangleLight(middle - (u + v) / 2, u, v, [1e4])
    scene = jv.Scene([jv.Surface(floor, jv.PhongBRDF([0.0], [1.0], n))], [light])
    right = np.array([0, 1.0, 0])
    view = jv.Orthographic(
        2 * eye, np.stack([right, np.cross(-eye, right), -eye]), 1e-3, resolution=(4, 4)
    )
    rows = {row.name: row for row in effects.inspect(scene, view)}
    assert abs(many - once) > 0.5 * many
    assert rows["lights[0].extent"].bound >= abs(many - once)
