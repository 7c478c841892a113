"""What materials and skies send at most, by angles and by integrals in NumPy."""

import numpy as np
import pytest
from oracles.direct_light import oren_nayar, picture, reflected

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


@pytest.mark.parametrize("form", ["qualitative", "full"])
@pytest.mark.parametrize("sigma", [0.0, 0.003, 0.1, 0.5])
def test_rough_bodies_stay_below_their_bound_down_to_the_horizon(sigma, form):
    """Toward the horizon f_r grows as the cosine falls, so that no bound on f_r alone holds."""
    material, rng = jv.OrenNayar([0.2], sigma, form=form), np.random.default_rng(0)
    polar = np.pi / 2 * (1 - rng.random((2, 20_000)) ** 3)
    wi, wo = (directions(p, 2 * np.pi * rng.random(p.size)) for p in polar)
    own, cosine = suprema(material), wi[:, 2]
    f = oren_nayar(material, np.broadcast_to(UP, wi.shape), wi, wo)[:, 0]
    share = (1 - own.grazing) * cosine + own.grazing
    assert np.all(f * cosine <= own.body[0] * share * (1 + 1e-9))
    allowed = own.plain * share + own.body[0] * own.grazing
    assert np.all(np.abs(f - 0.2) * cosine <= allowed * (1 + 1e-9) + 1e-15)
    assert (sigma == 0) == (np.max(allowed) == 0)


@pytest.mark.parametrize("material", FAMILIES)
def test_a_lobe_sends_no_more_than_its_size(material):
    """Its integral over an even sky, by nodes close about the mirror direction."""
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
    """A pixel that meets nothing shows all skies."""
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
