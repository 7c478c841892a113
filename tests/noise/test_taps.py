"""Tests cameras of several amplifiers or a colour mosaic: amplifiers that the rig does not state
are found, calibrated separately, and written as one camera that predicts and corrects."""

from contextlib import nullcontext
from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxvision as jv
from fitting import folders, noise
from fitting.inference.precision import double_precision
from fitting.noise.levels import linear_levels
from fitting.noise.periodic import periodic_structure, taps_of
from fitting.noise.sensor import Numbers, drawn_numbers
from fitting.noise.sites import _common_die, camera_of_taps, sensor_of_sites, tap_of, tap_sensor
from fitting.rig import Camera
from jaxvision.errors import InputError

SHAPE = (96, 96)
ROW, COLUMN = np.indices(SHAPE)
COLUMNS = COLUMN % 2
QUADRANTS = (ROW >= 48) * 2 + (COLUMN >= 48)
BAYER = ROW % 2 * 2 + COLUMN % 2
ONE = np.zeros(SHAPE, int)


def frames(seed, tap=ONE, *, light=1.0, **numbers):
    """Return (flats, darks, exposures, photons) by NumPy, with parameters of each tap or common
    ones."""
    rng, die = np.random.default_rng(seed), np.random.default_rng(7)
    known = {"gain": 0.25, "black": 64.0, "efficiency": 0.5, "read": 5.0, "bent": 0.0} | numbers
    of = {name: np.broadcast_to(value, tap.max() + 1)[tap] for name, value in known.items()}
    sensitivity = of["efficiency"] * (1 + 0.005 * die.standard_normal(tap.shape))

    def frame(photons):
        e = rng.poisson(sensitivity * photons).astype(float)
        e = e * (1 - of["bent"] * e / 1e4) + of["read"] * rng.standard_normal(tap.shape)
        return np.clip(np.round(of["black"] + of["gain"] * e), 0, 4095).astype(np.uint16)

    photons = np.linspace(500, 24_000, 12) * light
    flats = [[frame(p) for _ in range(3)] for p in photons]
    darks = [[frame(0.0) for _ in range(3)] for _ in photons]
    return flats, darks, [0.01] * 12, list(photons)


def of_each(camera, of_all):
    """Return the calibration of each site."""
    return {
        site: noise.calibrate(noise.from_frames(*of_all, camera=camera, channel=site))
        for site in camera.sites
    }


KINDS = {
    "columns": (
        {"taps": (1, 2)},
        COLUMNS,
        {"gain": [0.25, 0.2575], "black": [64, 68], "read": [5, 5.5]},
    ),
    "quadrants": (
        {"taps": "quadrants"},
        QUADRANTS,
        {"gain": [0.25, 0.2575, 0.245, 0.26], "black": [64, 68, 60, 66], "bent": 0.03},
    ),
    "mosaic": ({"pattern": "RGGB"}, BAYER, {"efficiency": [0.3, 0.5, 0.5025, 0.2]}),
}


def deviations(sensor, draws, known, taps):
    """Return the errors of each tap's parameters in standard errors of the draws."""
    found = []
    for field, name, plain in (
        ("gain", "gain", 0.25),
        ("offset", "black", 64.0),
        ("quantum_efficiency", "efficiency", 0.5),
        ("read_noise", "read", 5.0),
    ):
        true = np.broadcast_to(known.get(name, plain), taps)
        best = [float(getattr(tap_sensor(sensor, i), field)) for i in range(taps)]
        each = [
            getattr(jax.vmap(lambda one, i=i: tap_sensor(one, i))(draws), field)
            for i in range(taps)
        ]
        found.append((best - true) / np.std(each, axis=1))
    return np.array(found)


@double_precision
def check(kind, seed):
    """Return (errors, whether later frames contradict the prediction by tap), from the written file
    alone."""
    given, tap, known = KINDS[kind]
    camera = Camera(bits=12, **given)
    found = sensor_of_sites(of_each(camera, frames(seed, tap, **known)), camera)
    later = frames(10_000 + seed, tap, **known)
    missed = [
        noise.predict(
            found.best,
            noise.from_frames(*later, camera=camera, channel=site),
            draws=found.draws,
        ).main_comparison.missed
        for site in camera.sites
    ]
    return deviations(found.best, found.draws, known, len(camera.sites)), missed


@pytest.mark.parametrize(
    "kind", ["columns", *(pytest.param(k, marks=pytest.mark.slow) for k in ("quadrants", "mosaic"))]
)
@pytest.mark.slow
def test_one_sensor_has_the_parameters_of_each_tap_and_predicts_it(kind):
    far, missed = check(kind, 1)
    assert np.abs(far).max() < 4
    assert not any(missed)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_of_taps_cover_their_parameters(kind):
    found = [check(kind, seed) for seed in range(30)]
    far = np.array([one[0] for one in found])
    missed = sum(bool(own) for one in found for own in one[1])
    print(kind, far.std(axis=0).round(2).tolist(), missed)
    assert 0.92 <= (np.abs(far) < 1.96).mean() <= 0.98
    assert missed <= 0.05 * len(found) * far.shape[2]


@pytest.mark.slow
@double_precision
def test_common_parameters_of_taps_equal_dense_conditioning():
    """Two taps share the offset of the light. The reference is the Gaussian of both, conditioned on
    equality."""
    camera = Camera(bits=12, taps=(1, 2))
    plain = drawn_numbers(next(iter(of_each(camera, frames(3, COLUMNS)).values())))
    rng = np.random.default_rng(0)
    labels = ("system_gain", "black_level", "responsivity", "read_noise", "light_offset")
    about = replace(plain.about, labels=labels)
    means = np.array([[0.25, 64, 0.125, 5, 3.0], [0.26, 68, 0.13, 5, 4.0]])
    mixed = rng.standard_normal((2, 5, 5)) * [[0.01], [0.1], [0.01], [0.1], [0.5]]
    drawn = [
        np.concatenate([mean[None], mean + rng.standard_normal((4000, 5)) @ mix.T])
        for mean, mix in zip(means, mixed, strict=True)
    ]
    found, _ = _common_die([Numbers(about, one, {}) for one in drawn])
    whole = np.zeros((10, 10))
    for i in (0, 1):
        whole[5 * i : 5 * i + 5, 5 * i : 5 * i + 5] = np.cov(drawn[i][1:], rowvar=False)
    differ = np.zeros(10)
    differ[4], differ[9] = 1, -1
    moves = whole @ differ / (differ @ whole @ differ)
    wanted = means.ravel() - moves * (differ @ means.ravel())
    np.testing.assert_allclose([one.natural[0] for one in found], wanted.reshape(2, 5), rtol=1e-9)
    spread = whole - np.outer(moves, differ @ whole)
    each = np.concatenate([one.natural[1:] for one in found], axis=1)
    np.testing.assert_allclose(each.std(axis=0), np.sqrt(np.diagonal(spread)), rtol=0.05)


SITES = ("red", "green 1", "green 2", "blue")
EFFICIENCIES = [0.3, 0.5, 0.55, 0.2]


def mosaic_sensor(pattern, names):
    return jv.Sensor(
        shot_noise=jv.PoissonShotNoise(),
        quantum_efficiency=0.5,
        read_noise=5.0,
        prnu=0.005,
        gain=0.25,
        offset=64.0,
        bits=12,
        taps=jv.Taps(pattern, quantum_efficiency=np.divide(EFFICIENCIES, 0.5), names=names),
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("phase", "shift"),
    [
        *(pytest.param(*x, marks=pytest.mark.slow) for x in [("RGGB", (0, 0)), ("GRBG", (0, 1))]),
        ("BGGR", (1, 1)),
        pytest.param("GBRG", (1, 0), marks=pytest.mark.slow),
    ],
)
def test_frames_of_another_phase_are_predicted_by_colour(phase, shift):
    """A frame that starts one row or column later has the same pixels at other positions."""
    tile = ((0, 1), (2, 3))
    flats, darks, exposures, photons = frames(
        11, np.roll(BAYER, shift, (0, 1)), efficiency=EFFICIENCIES
    )
    sensor, camera = mosaic_sensor(tile, SITES), Camera(bits=12, pattern=phase)
    for site in camera.sites:
        measured = noise.from_frames(flats, darks, exposures, photons, camera=camera, channel=site)
        judged = noise.predict(sensor, measured).main_comparison
        np.testing.assert_allclose(judged.measured[0], judged.found.values[0], rtol=0.002)


def test_taps_with_other_names_than_the_frames_are_refused():
    measured = {
        stated: noise.from_frames(*frames(11, BAYER), camera=Camera(bits=12, **dict([stated])))
        for stated in (("pattern", "RGGB"), ("taps", (2, 2)))
    }
    of_mosaic, tap_map = measured.values()
    colours = mosaic_sensor(((0, 1), (2, 3)), SITES)
    plain = mosaic_sensor(((0, 1), (2, 3)), None)
    with pytest.raises(InputError, match=r"state camera\.taps = \[2, 2\] of the frames"):
        noise.predict(plain, of_mosaic)
    with pytest.raises(InputError, match=r'state camera\.pattern = "RGGB" of the frames'):
        noise.predict(colours, tap_map)
    assert noise.predict(plain, tap_map).main_comparison
    assert camera_of_taps(jv.Taps("GRBG", offset=[0.0, 1.0, 2.0])).pattern == "GRBG"


@pytest.mark.parametrize(
    "stated",
    [{"pattern": "GBRG"}, {"pattern": "BGGR", "taps": (1, 4)}, {"taps": (3, 1)}]
    + [{"taps": part} for part in ("left and right", "top and bottom", "quadrants")]
    + [{"taps": part, "pattern": "GRBG"} for part in ("top and bottom", "quadrants")],
)
def test_taps_of_a_file_equal_the_rigs(stated):
    camera = Camera(bits=16, **stated)
    tile = np.arange(len(camera.sites)).reshape(camera.layout).tolist()
    taps = jv.Taps(
        tuple(map(tuple, tile)),
        names=camera.sites,
        stretched=camera.has_tap_regions,
        cell=camera.cell if camera.has_tap_regions else (1, 1),
    )
    assert camera_of_taps(taps) == camera
    assert [tap_of(taps, site, camera.pattern) for site in camera.sites] == [
        *range(len(camera.sites))
    ]


def structure(seed, tap=ONE, **numbers):
    measured = noise.from_frames(*frames(seed, tap, **numbers), camera=Camera(bits=12))
    return periodic_structure(measured, linear_levels(measured))


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("tap", "numbers", "taps"),
    [
        (COLUMNS, {"gain": [0.25, 0.2575], "black": [64, 68]}, (1, 2)),
        (QUADRANTS, {"gain": [0.25, 0.27, 0.25, 0.27], "black": [64, 64, 68, 68]}, "quadrants"),
        (QUADRANTS % 2, {"black": [64, 68]}, "left and right"),
        (BAYER, {"efficiency": [0.3, 0.5, 0.5025, 0.2]}, (2, 2)),
        (QUADRANTS, {"black": [64, 66, 61, 69]}, "quadrants"),
        (COLUMNS, {"read": [5, 6]}, (1, 2)),
        (QUADRANTS // 2, {"read": [5, 8]}, "top and bottom"),
    ],
    ids=[
        "columns",
        "quadrants",
        "halves by black",
        "mosaic",
        "quadrants whose halves agree",
        "columns by read noise",
        "halves by read noise",
    ],
)
def test_unequal_taps_that_the_rig_does_not_state_are_found(tap, numbers, taps):
    # For seed 1012, a period of 6 columns explains columns that differ in gain, too.
    assert taps_of(structure(1012, tap, **numbers)) == taps


@pytest.mark.slow
def test_cameras_of_equal_taps_cause_no_false_alarm():
    alarms = []
    for seed in range(60):
        rng = np.random.default_rng(500 + seed)
        gain, read = rng.uniform(0.1, 0.4), rng.uniform(2, 8)
        if found := structure(seed, gain=gain, read=read, light=0.25 / gain):
            alarms.append((seed, found))
    assert alarms == []


def written_rig(folder, of_all, first, iso=None):
    """Write `of_all`, of one gain or of several, whose ISO speeds are then given."""
    lines = [f"camera = {{{first}}}"]
    for speed, (flats, darks, _, photons) in zip(
        iso or [0], of_all if iso else [of_all], strict=True
    ):
        for kind, levels in (("flat", flats), ("dark", darks)):
            for i, level in enumerate(levels):
                names = [f"{kind}_{speed}_{i}_{j}.npy" for j in range(len(level))]
                for name, frame in zip(names, level, strict=True):
                    np.save(folder / name, frame)
                lines += [f"[[{kind}]]", f"files = {names}", "exposure = 0.01"]
                lines += [f"photons = {photons[i]}"] * (kind == "flat")
                lines += [f"iso = {speed}"] * bool(iso)
    (folder / "rig.toml").write_text("\n".join(lines))


def step(label):
    return nullcontext(lambda done, total: None)


@pytest.mark.slow
def test_the_command_calibrates_unstated_taps_separately_and_writes_one_camera(tmp_path):
    _, tap, known = KINDS["columns"]
    written_rig(tmp_path, frames(4, tap, **known), "bits = 12")
    sections, _ = folders.noise(tmp_path, step, lambda kind, progress: {"sampling": None})
    assert [one.kind for one in sections] == ["noise", "noise_tap_0_1"]
    assert "differ in" in sections[0].findings[0]
    assert "were calibrated separately; give camera.taps = [1, 2]" in sections[0].findings[0]
    assert [[*one.records] for one in sections] == [["sensor"], []]
    sections[0].records["sensor"](tmp_path / "sensor.toml")
    sensor = jv.read_sensor(tmp_path / "sensor.toml")
    draws = jv.read_sensor(tmp_path / "sensor.toml", draws=200)
    assert np.abs(deviations(sensor, draws, known, 2)).max() < 4
    later = noise.from_frames(*frames(5, tap, **known), camera=Camera(bits=12))
    with pytest.raises(InputError, match="has 2 taps, but the frames are not split into them"):
        noise.predict(tmp_path / "sensor.toml", later)
    for stated in ("", ", taps = [1, 2]"):
        written_rig(tmp_path, frames(6, tap, **known), f"bits = 12{stated}")
        compared, _ = folders.predict(str(tmp_path / "sensor.toml"), tmp_path, step)
        assert [one.title.rpartition(": ")[2] for one in compared] == ["tap 0,0", "tap 0,1"]
        told = [sentence for one in compared for sentence in one.findings]
        assert not any("missed" in sentence for sentence in told)
        assert ("camera.taps = [1, 2] of" in told[0]) == (not stated)


@pytest.mark.slow
def test_each_of_several_gains_has_one_camera_of_all_taps(tmp_path):
    _, tap, known = KINDS["columns"]
    double = known | {"gain": [0.5, 0.515]}
    both = [frames(8, tap, **known), frames(9, tap, light=0.5, **double)]
    written_rig(tmp_path, both, "bits = 12, taps = [1, 2]", iso=[100, 200])
    sampled = {"sampling": None, "seed": 0}
    first, *others = folders.noise(tmp_path, step, lambda kind, progress: sampled)[0]
    assert first.kind == "noise"
    assert [*first.records] == ["sensor_iso_100", "sensor_iso_200"]
    assert not any(one.records for one in others)
    kinds = [first.kind, *(one.kind for one in others)]
    assert len({*kinds}) == len(kinds) == 6
    for name, numbers in (("sensor_iso_100", known), ("sensor_iso_200", double)):
        file = tmp_path / f"{name}.toml"
        first.records[name](file)
        far = deviations(jv.read_sensor(file), jv.read_sensor(file, draws=200), numbers, 2)
        assert np.abs(far[[0, 2, 3]]).max() < 4  # all draws have the best fit's black level
        camera = Camera(bits=12, taps=(1, 2))
        light = 1.0 if numbers is known else 0.5
        for site in camera.sites:
            later = frames(20, tap, light=light, **numbers)
            measured = noise.from_frames(*later, camera=camera, channel=site)
            assert "variances" not in noise.predict(file, measured).main_comparison.missed


@pytest.mark.sweep
@pytest.mark.parametrize("pattern", [None, "RGGB"])
def test_parts_of_a_frame_are_taps(pattern):
    """The rig and the sensor's record agree, also for frames of odd sizes."""
    camera = Camera(
        bits=12,
        taps="quadrants",
        pattern=pattern,
        black_level=[1, 2, 3, 4, *[5] * 12][: 16 if pattern else 4],
    )
    if pattern is None:
        parts = ("tap top left", "tap top right", "tap bottom left", "tap bottom right")
        assert camera.sites == parts
        assert camera.at("tap bottom left").black_level == 3
    else:
        assert camera.sites[1:4:2] == ("green 1 tap top left", "green 1 tap top right")
        assert camera.at("red tap top right").black_level == 3
    tile = np.arange(len(camera.sites)).reshape(camera.layout)
    taps = jv.Taps(
        tuple(map(tuple, tile.tolist())),
        offset=np.arange(tile.size, dtype=float),
        stretched=True,
        cell=camera.cell,
    )
    own = np.array(jv.expected_signal(jv.Sensor(taps=taps), np.zeros((5, 7, 1))))[..., 0]
    for i, place in enumerate(camera.places(5, 7)):
        assert (own[place] == i).all()
        own[place] = -1
    assert (own == -1).all()
    column = np.indices((8, 12))[1]
    half = jv.Taps(((0, 1, 2, 3),), offset=[0.0, 1.0, 2.0, 3.0], stretched=True, cell=(1, 2))
    seen = np.asarray(jv.expected_signal(jv.Sensor(taps=half), np.zeros((8, 12, 1))))[..., 0]
    assert (seen == 2 * (column >= 6) + column % 2).all()


@pytest.mark.slow
@pytest.mark.parametrize("stated", ["", ', taps = "left and right"'])
def test_a_mosaic_read_out_in_halves_has_one_camera(tmp_path, stated):
    """There are eight sites. Halves that the rig does not state are found in the planes of the
    mosaic."""
    tap = (COLUMN >= 48) * 4 + BAYER
    known = {
        "gain": [0.25] * 4 + [0.265] * 4,
        "black": [64] * 4 + [70] * 4,
        "efficiency": 2 * [0.3, 0.5, 0.5025, 0.2],
    }
    written_rig(tmp_path, frames(30, tap, **known), f'bits = 12, pattern = "RGGB"{stated}')
    sections, _ = folders.noise(tmp_path, step, lambda kind, progress: {"sampling": None})
    assert len(sections) == 8
    remedy = 'calibrated separately; give camera.taps = "left and right"'
    assert any(remedy in one for one in sections[0].findings) == (not stated)
    sections[0].records["sensor"](tmp_path / "sensor.toml")
    sensor = jv.read_sensor(tmp_path / "sensor.toml")
    draws = jv.read_sensor(tmp_path / "sensor.toml", draws=200)
    order = [0, 1, 4, 5, 2, 3, 6, 7]  # of the values above, by rows of adjacent cells
    of_sites = {name: np.asarray(own)[order] for name, own in known.items()}
    assert np.abs(deviations(sensor, draws, of_sites, 8)).max() < 4
    written_rig(tmp_path, frames(31, tap, **known), "bits = 12")
    compared, _ = folders.predict(str(tmp_path / "sensor.toml"), tmp_path, step)
    assert [one.title.rpartition(": ")[2] for one in compared][2] == "red tap right"
    told = [sentence for one in compared for sentence in one.findings]
    assert not any("differ significantly" in sentence for sentence in told)
    photons = np.full((*SHAPE, 1), 8000.0)
    raw = jv.expected_signal(sensor, photons / 0.01)  # an exposure of .01 s
    # traced, as numbers without noise are warned of
    corrected = jax.jit(lambda raw: jv.sensor.correct(raw, sensor, unit="photons").image)(raw)
    np.testing.assert_allclose(corrected, photons)
