"""Tests photometric files written by the tests: valid ones are read correctly, and others are
refused in words."""

import numpy as np
import pytest

import jaxvision as jv
from jaxvision import lights
from jaxvision.errors import InputError
from jaxvision.files import read_luminaire

GAMMA = np.arange(0, 91, 5.0)
COSINE = 1000 * np.cos(np.radians(GAMMA))  # cd, of a uniform white panel of pi I lm


def ies(
    *,
    table=None,
    vertical=GAMMA,
    horizontal=(0,),
    system=1,
    head="IESNA:LM-63-2002\n[LUMINAIRE] panel\n",
    tilt="NONE",
    lumens=3141.6,
    multiplier=1,
    units=2,
    opening="0.6 1.2 0",
    ballast="1 1 40",
    end="\n",
    between=" ",
):
    table = np.broadcast_to(COSINE, (len(horizontal), len(vertical))) if table is None else table
    lines = [
        f"{head}TILT={tilt}",
        f"1 {lumens} {multiplier} {len(vertical)} {len(horizontal)} {system} {units} {opening}",
        ballast,
        *(between.join(f"{x:g}" for x in row) for row in (vertical, horizontal, *table)),
    ]
    return end.join("\n".join(lines).split("\n")) + end


def read(folder, text, name="lamp.ies"):
    (folder / name).write_bytes(text.encode("latin-1"))
    return read_luminaire(folder / name)


def flux(lamp):
    """Return the luminous flux of the lamp as a light of the scene, in lm."""
    light = jv.goniometric_light(lamp, [0, 0, 2])
    return 683 * float(lights.flux(light)[0])


def test_the_lumens_of_a_file_are_reproduced(tmp_path):
    """A panel of 1000 cd with a cosine distribution emits 1000 pi lm, as its file states. With
    nodes every 5 degrees, linear interpolation loses 0.1 %."""
    lamp = read(tmp_path, ies())
    assert (lamp.name, float(lamp.watts), float(lamp.lumens)) == ("panel", 40, 3141.6)
    assert flux(lamp) == pytest.approx(3141.6, rel=1e-3)
    np.testing.assert_allclose(lamp.opening, [1.2, 0.6, 0])
    light = jv.goniometric_light(lamp, [0, 0, 2])
    below = float(jv.incident(light, np.zeros(3)).irradiance[0])
    assert below == pytest.approx(1000 / 683 / 4, rel=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        {"end": "\r\n"},
        {"end": "\r"},
        {"between": ", "},
        {"head": ""},  # of 1986
        {"head": "IESNA91\n[MANUFAC] Müller\n"},
        {"head": "\ufeffIES:LM-63-2019\n".encode().decode("latin-1")},
        {"multiplier": 2, "ballast": "0.5 1 40"},
        {"lumens": -1},
        {"tilt": "INCLUDE\n1\n3\n0 90 180\n1 0.9 1"},
        {"units": 1, "opening": f"{0.6 / 0.3048} {1.2 / 0.3048} 0"},
    ],
)
def test_the_same_lamp_in_other_forms(change, tmp_path):
    lamp = read(tmp_path, ies(**change))
    assert flux(lamp) == pytest.approx(1000 * np.pi, rel=1e-3)
    np.testing.assert_allclose(lamp.opening, [1.2, 0.6, 0], rtol=1e-6)
    assert np.isnan(lamp.lumens) == (change.get("lumens") == -1)


def test_old_files_have_a_further_factor_and_round_openings_a_minus(tmp_path):
    old = read(tmp_path, ies(head="IESNA91\n", ballast="1 0.5 40", opening="-0.2 -0.2 0"))
    assert flux(old) == pytest.approx(500 * np.pi, rel=1e-3)
    assert old.opening[0] * old.opening[1] == pytest.approx(np.pi * 0.1**2, rel=1e-6)
    of_1995 = read(tmp_path, ies(opening="-0.2 0 0"))
    np.testing.assert_allclose(of_1995.opening, [0.1 * np.sqrt(np.pi)] * 2 + [0], rtol=1e-6)
    new = read(tmp_path, ies(ballast="1 0.5 40"))
    assert flux(new) == pytest.approx(1000 * np.pi, rel=1e-3)


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("planes", "mirrors"),
    [
        ([0, 30, 90], lambda c: [c, -c, 180 - c, 180 + c]),
        ([0, 30, 90, 180], lambda c: [c, -c]),
        ([90, 120, 200, 270], lambda c: [c, 180 - c]),
        ([0, 30, 90, 180, 300, 360], lambda c: [c]),
        (list(range(0, 360, 30)), lambda c: [c]),  # the last plane left out
    ],
)
def test_symmetric_planes_are_filled_in(planes, mirrors, tmp_path):
    rng = np.random.default_rng(0)
    table = rng.uniform(100, 900, (len(planes), 3))
    table[:, 0] = 500  # one direction
    if planes[-1] == 360:
        table[-1] = table[0]
    lamp = read(tmp_path, ies(table=table, vertical=[0, 45, 90], horizontal=planes, lumens=-1))
    light = jv.goniometric_light(lamp, [0, 0, 0])
    for plane, row in zip(planes, table, strict=True):
        for c in np.radians(mirrors(plane)):
            w = [np.sin(np.pi / 4) * np.cos(c), np.sin(np.pi / 4) * np.sin(c), -np.cos(np.pi / 4)]
            got = float(lights.relative_intensity(light, w))
            assert got == pytest.approx(row[1], rel=1e-4)


@pytest.mark.parametrize("system", [2, 3])
def test_types_a_and_b_are_mirrored_from_zero(system, tmp_path):
    angles = [0, 20, 90]
    table = np.random.default_rng(1).uniform(100, 900, (3, 3))
    lamp = read(tmp_path, ies(table=table, vertical=angles, horizontal=angles, system=system))
    assert lamp.system == "?CBA"[system]
    np.testing.assert_allclose(np.degrees(lamp.horizontal), [-90, -20, 0, 20, 90], atol=1e-4)
    np.testing.assert_allclose(lamp.candela[-1], table[[2, 1, 0, 1, 2], -1], rtol=1e-5)


def eulumdat(symmetry, planes, table, *, lumens=2000.0, factor=1.0, sets=1, ratio=100, end="\r\n"):
    count = len(planes)
    lines = ["maker", 1, symmetry, count, 0, len(GAMMA), 5, "r", "floor lamp", "n", "f", "d"]
    lines += [600, 300, 80, 500, 200, 0, 0, 0, 0, 100, ratio, factor, 0, sets]
    lamps = [[1] * sets, ["LED"] * sets, [lumens, 9.0][:sets], ["830"] * sets, [80] * sets]
    lines += [x for of_kind in (*lamps, [18] * sets) for x in of_kind] + [0] * 10
    lines += [*planes, *GAMMA, *np.ravel(table)]
    return end.join(str(x).replace(".", ",") if isinstance(x, float) else str(x) for x in lines)


@pytest.mark.parametrize(
    ("symmetry", "first", "kept"), [(0, 0, 8), (1, 0, 1), (2, 0, 5), (3, 6, 5), (4, 0, 3)]
)
@pytest.mark.parametrize("sets", [1, 2])
def test_eulumdat(symmetry, first, kept, sets, tmp_path):
    """The values are cd per 1000 lm of the lamps, with decimal commas."""
    planes = np.arange(0, 360, 45)
    table = np.broadcast_to(np.cos(np.radians(GAMMA)) * 1000 / np.pi, (kept, len(GAMMA))).copy()
    tall = table / (1 + 0.1 * np.arange(kept)[:, None])
    lamp = read(tmp_path, eulumdat(symmetry, planes, table, sets=sets), "lamp.ldt")
    assert flux(lamp) == pytest.approx(2000, rel=1e-3)
    np.testing.assert_allclose(lamp.opening, [0.2, 0.5, 0])
    assert (lamp.name, float(lamp.watts)) == ("floor lamp", 18)
    lamp = read(tmp_path, eulumdat(symmetry, planes, tall, ratio=0), "lamp.ldt")
    own = np.degrees(np.asarray(lamp.horizontal))
    for k in range(kept):
        plane = planes[(first + k) % 8]
        at = np.flatnonzero(np.abs(own - plane) < 0.01)[0]
        assert lamp.candela[0, at] == pytest.approx(2 * tall[k, 0], rel=1e-5)


def test_sets_of_lamps_are_read_in_either_order(tmp_path):
    """The standard lists all numbers of lamps, then all types."""
    planes, table = np.arange(0, 360, 45), np.cos(np.radians(GAMMA)) * 1000 / np.pi
    lines = eulumdat(1, planes, table, sets=2).split("\r\n")
    lines[26:38] = [lines[26 + 2 * field + one] for one in (0, 1) for field in range(6)]
    lamp = read(tmp_path, "\r\n".join(lines), "lamp.ldt")
    assert (float(lamp.lumens), float(lamp.watts)) == (2000, 18)
    lines[26:38] = [*lines[27:38], "0"]
    with pytest.raises(InputError, match=r"the 2 sets of lamps .* have no numbers where"):
        read(tmp_path, "\r\n".join(lines), "lamp.ldt")


def test_the_tilt_of_a_measurement_is_named(tmp_path):
    lines = eulumdat(1, [0], np.cos(np.radians(GAMMA)) * 1000 / np.pi).split("\r\n")
    lines[24] = "15"
    with pytest.warns(UserWarning, match=r"at a tilt of 15 degrees \(line 25\), which is not used"):
        read(tmp_path, "\r\n".join(lines), "lamp.ldt")


def test_more_light_than_the_lamps_emit_is_named(tmp_path):
    with pytest.warns(UserWarning, match=r"3.14e.04 lm leave a luminaire whose lamps give 3142 lm"):
        read(tmp_path, ies(multiplier=10))
    planes, table = np.arange(0, 360, 45), np.cos(np.radians(GAMMA)) * 1000 / np.pi
    with pytest.warns(UserWarning, match=r"ratio of 85 % .*, and its intensities send 99.9 % of"):
        read(tmp_path, eulumdat(1, planes, table, ratio=85), "lamp.ldt")


def turned(last):
    """Return intensities in planes at 0 to 360 degrees, the last multiplied by a number."""
    return np.outer([1, 1, 1, 1, last], COSINE)


@pytest.mark.parametrize(
    ("text", "name", "words"),
    [
        (ies(lumens=100_000), "a.ies", r"3\d+ lm leave a luminaire whose lamps give 1e\+05 lm"),
        (ies(lumens=-1, multiplier=100), "a.ies", r"luminaire of 40 W, 7.8e\+03 lm/W"),
        (eulumdat(1, [0], COSINE / np.pi, lumens=1), "a.ldt", r"W, 0.056 lm/W"),
        (ies(opening="60 60 0"), "a.ies", "opening is 60 m wide, as if its size were in another"),
        (
            ies(table=turned(0.5), horizontal=[0, 90, 180, 270, 360]),
            "a.ies",
            "the planes at 0 and 360 degrees describe the same direction, and differ by up to 500",
        ),
        (
            ies(table=np.stack([COSINE, np.roll(COSINE, 1)]), horizontal=[0, 90]),
            "a.ies",
            "all planes at a vertical angle of 0 degrees describe the same direction",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")  # some have two faults
def test_implausible_photometric_numbers_are_named(text, name, words, tmp_path):
    """The faults are intensities per kilolumen without their lamps, kilolumens for lumens,
    millimetres for metres, and a table whose order contradicts its angles. Earlier versions read
    them silently."""
    with pytest.warns(UserWarning, match=words):
        read(tmp_path, text, name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ies().replace("1000", "1000,5"), "holds 1 numbers more .* decimal commas, write points"),
        ("nothing here", "has no line TILT="),
        (ies()[:-60], r"ends within candela values, after \d+ of 19 numbers; it is cut off"),
        (ies(vertical=GAMMA + 2.5), "vertical angles run from 2.5 to 92.5 degrees, where a lamp"),
        (ies(vertical=GAMMA[::-1]), "vertical angles must increase"),
        (ies(horizontal=(0, 45), table=np.ones((2, 19))), "horizontal angles run from 0 to 45"),
        (ies(table=-np.ones((1, 19))), "candela values run from -1 to -1 cd"),
        (ies(table=np.zeros((1, 19))), "all candela values are 0"),
        (ies(multiplier=1e9), r"candela multiplier = 1e\+09: must be from 0 to 1e\+06"),
        (ies().replace("1000", "bright"), "candela values: 'bright' is no number"),
        (ies().replace("1000", "nan"), "candela values: must be finite numbers"),
        (ies(system=4), "photometric type = 4: must be from 1 to 3"),
        (ies(tilt="LAMP.TLT"), "TILT=LAMP.TLT: only NONE and INCLUDE are read"),
        (ies(opening="600 1200 0"), "its luminous opening is 1200 m wide"),
        (
            ies().replace(" 19 1 1", " 19.5 1 1"),
            "number of vertical angles = 19.5: must be a whole",
        ),
        (ies().replace(" 19 1 1", " 190000 1 1"), "must be from 2 to 5000"),
    ],
)
def test_invalid_photometric_files_are_refused(text, words, tmp_path):
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)


def test_invalid_eulumdat_files_are_refused(tmp_path):
    whole = eulumdat(1, [0], [np.ones(len(GAMMA))])
    for text, words in (
        (whole[:60], "too few for EULUMDAT"),
        (whole[:-20], "ends within intensities"),
        (whole.replace("maker\r\n1\r\n1", "maker\r\n1\r\n7"), r"symmetry \(line 3\) = 7"),
        ("x" + "\0" * 20, "is no text"),
    ):
        with pytest.raises(InputError, match=words):
            read(tmp_path, text, "lamp.ldt")


SCENE = """
[camera]
kind = "orthographic"
position = [0, 0, 1]
target = [0, 0, 0]
up = [0, 1, 0]
width = 0.1
resolution = [4, 4]
[material.paper]
family = "lambert"
albedo = 0.8
[[surface]]
shape = "quad"
corner = [-1, -1, 0]
edge_u = [2, 0, 0]
edge_v = [0, 2, 0]
material = "paper"
"""


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("light", "expected"),
    [
        ('kind = "goniometric"\nfile = "panel.ies"\nposition = [0, 0, 2]', 1000 / 683 / 4),
        (
            'kind = "spot"\nposition = [0, 0, 2]\ndirection = [0, 0, -1]\n'
            "intensity = 8\nouter = 30",
            2,
        ),
        ('kind = "sun_disc"\ndirection = [0, 0.6, 0.8]\nirradiance = 10', 8),
    ],
)
def test_scene_files_have_lamps_as_sold_spots_and_the_sun(light, expected, tmp_path):
    """White paper directly below has the radiance 0.8 E / pi."""
    (tmp_path / "panel.ies").write_text(ies())
    (tmp_path / "scene.toml").write_text(f"{SCENE}[[light]]\n{light}\n")
    source = jv.files.read_scene(tmp_path / "scene.toml")
    picture = jv.render(source.scene, source.view, rule=jv.Quadrature(4))
    np.testing.assert_allclose(picture, 0.8 / np.pi * expected, rtol=1e-2)


def test_a_scene_file_has_a_sky(tmp_path):
    sky = 'kind = "environment"\nsky = 16\nirradiance = 10'
    (tmp_path / "scene.toml").write_text(f"{SCENE}[[light]]\n{sky}\n")
    light = jv.files.read_scene(tmp_path / "scene.toml").scene.lights[0]
    top = float(light.radiance[0].mean())
    assert top == pytest.approx(10 * 9 / (7 * np.pi), rel=1e-2)
    (tmp_path / "scene.toml").write_text(f"{SCENE}[[light]]\n{sky}\nradiance = 1\n")
    with pytest.raises(InputError, match="give either file, radiance or sky"):
        jv.files.read_scene(tmp_path / "scene.toml")
