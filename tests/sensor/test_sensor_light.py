"""Tests light and charge between pixels: aperture, filters, crosstalk, smear, shutter, CCD,
temperature.

The references are naive NumPy loops, closed forms and conservation of charge."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxvision import scene as s
from jaxvision.core._types import as_dtype
from jaxvision.sensor import (
    aperture_mtf,
    bloomed,
    collect,
    dark_rate,
    digitise,
    drifted,
    exposed,
    exposure_slots,
    light_share,
    mean_photoelectrons,
    pixel_means,
    raw_image,
    set_iso,
    smeared,
    transferred,
)
from jaxvision.sensor.colour_filters import bayer

RNG = np.random.default_rng(8)
IMAGE = RNG.uniform(10, 1000, size=(7, 5, 2))

# ------------------------------------------------ the pixel's aperture


@pytest.mark.parametrize("fill", [1 / 16, 1 / 4, 1.0])
@pytest.mark.parametrize("frequency", [0.1, 0.4, 0.7])
def test_contrast_of_a_grating_is_a_sinc(fill, frequency):
    """The aperture is a whole number of cells wide, and each cell has the grating's own mean, so
    sampling is exact."""
    n, pixels = 16, 100
    x = (np.arange(n * pixels) + 0.5) / n
    aperture = s.PixelAperture(fill, oversampling=n)
    waves = [np.cos(2 * np.pi * frequency * x), np.sin(2 * np.pi * frequency * x)]
    fine = np.broadcast_to(np.stack(waves, axis=-1), (n, n * pixels, 2)) * np.sinc(frequency / n)
    got = np.asarray(jax.jit(pixel_means)(jnp.asarray(fine), aperture))[0]
    middle = np.arange(pixels) + 0.5
    angle = 2 * np.pi * frequency * middle
    factor = np.sinc(np.sqrt(fill) * frequency)
    np.testing.assert_allclose(aperture_mtf(aperture, jnp.asarray(frequency)), factor, rtol=1e-12)
    np.testing.assert_allclose(
        got, factor * np.stack([np.cos(angle), np.sin(angle)], -1), atol=1e-12
    )


def test_a_zone_plate_aliases_less_with_a_larger_fill_factor():
    """At up to 0.9 cycles per pixel, frequencies beyond Nyquist alias, attenuated by the sinc."""
    n, pixels = 8, 64
    x = (np.arange(n * pixels) + 0.5) / n
    radius = x[:, None] ** 2 + x[None] ** 2
    plate = jnp.asarray(0.5 + 0.5 * np.cos(np.pi * 0.9 / pixels * radius))[..., None]
    beyond = np.hypot(*np.indices((pixels, pixels)) + 0.5) * 0.9 / pixels > 0.6
    contrast = []
    for fill in (0.01, 0.5, 1.0):
        aperture = s.PixelAperture(fill, oversampling=n)
        picture = np.asarray(pixel_means(plate, aperture))[..., 0]
        contrast.append(picture[beyond].std())
    assert contrast[0] > 1.3 * contrast[1] > 1.3 * 1.3 * contrast[2]


def test_a_microlens_widens_the_aperture_and_light_is_proportional():
    assert float(light_share(s.PixelAperture(0.4))) == pytest.approx(0.4)
    with_lens = s.PixelAperture(0.4, microlens=0.5)
    np.testing.assert_allclose(light_share(with_lens), 0.7)
    flat = jnp.full((6, 6, 1), 3.0)
    np.testing.assert_allclose(pixel_means(flat, s.PixelAperture(0.3, oversampling=3)), 3.0)
    sensor = s.Sensor(pixel_aperture=with_lens)
    np.testing.assert_allclose(mean_photoelectrons(sensor, flat), 2.1)


def test_a_picture_without_a_whole_number_of_pixels_is_refused():
    with pytest.raises(ValueError, match="multiple of 4 rows and columns"):
        pixel_means(jnp.ones((8, 6, 1)), s.PixelAperture(1.0, oversampling=4))


# ------------------------------------------------ filters


@pytest.mark.sweep
@pytest.mark.parametrize("phase", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_each_pixel_counts_the_light_through_its_filter(phase):
    transmission = np.array([[0.5, 0.1], [0.2, 0.3], [0.05, 0.4]])
    colours = s.ColourFilter(transmission, pattern=bayer(phase))
    sensor = s.Sensor(colour_filter=colours, infrared_cut=[1.0, 0.5], exposure_time=2.0)
    got = np.asarray(mean_photoelectrons(sensor, jnp.asarray(IMAGE)))
    assert got.shape == (7, 5, 1)
    for i, j in np.ndindex(7, 5):
        colour = "RGB".index(phase[2 * (i % 2) + j % 2])
        expected = 2 * IMAGE[i, j] * [1, 0.5] @ transmission[colour]
        np.testing.assert_allclose(got[i, j, 0], expected, rtol=1e-12)


def test_a_monochrome_sensor_is_a_pattern_of_one():
    sensor = s.Sensor(colour_filter=s.ColourFilter([[0.5, 0.25]], pattern=((0,),)))
    got = mean_photoelectrons(sensor, jnp.asarray(IMAGE))
    np.testing.assert_allclose(got[..., 0], IMAGE @ [0.5, 0.25])


def test_patterns_that_do_not_tile_are_refused():
    for pattern in (((0, 1), (1,)), ((0, 2),), (), ((0, 1), (1, 2))):
        with pytest.raises(ValueError, match=r"ColourFilter\.pattern"):
            s.ColourFilter([[0.5, 0.2]] * 2, pattern=pattern)


def test_a_larger_chip_gathers_more_light_at_equal_field_of_view():
    """Pitch and focal length are doubled at the same f-number."""
    electrons = []
    for pitch in (3e-6, 6e-6):
        conversion = s.PhotonConversion(5.5e-7, pitch**2)
        electrons.append(mean_photoelectrons(s.Sensor(photon_conversion=conversion), jnp.ones(1)))
    np.testing.assert_allclose(electrons[1], 4 * electrons[0], rtol=1e-14)


# ------------------------------------------------ neighbours


def test_crosstalk_equals_a_loop_and_conserves_charge():
    share = 0.07
    expected = np.zeros_like(IMAGE)
    for i, j in np.ndindex(7, 5):
        expected[i, j] += (1 - 4 * share) * IMAGE[i, j]
        for di, dj in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            to = min(max(i + di, 0), 6), min(max(j + dj, 0), 4)
            expected[to] += share * IMAGE[i, j]
    got = drifted(jnp.asarray(IMAGE), jnp.asarray(share))
    np.testing.assert_allclose(got, expected, rtol=1e-12)
    np.testing.assert_allclose(got.sum(), IMAGE.sum(), rtol=1e-13)


def test_smear_adds_the_rest_of_the_column():
    got = np.asarray(smeared(jnp.asarray(IMAGE), jnp.asarray(0.01)))
    for i, j in np.ndindex(7, 5):
        others = IMAGE[:, j].sum(axis=0) - IMAGE[i, j]
        np.testing.assert_allclose(got[i, j], IMAGE[i, j] + 0.01 * others, rtol=1e-12)


# ------------------------------------------------ CCD


def overflow(column, well, spill):
    """Move electron parcels down and then up, one well after the other."""
    level = np.minimum(column, well)
    half = spill * np.maximum(column - well, 0) / 2
    for step in (1, -1):
        for start in range(len(column)):
            parcel, place = half[start], start + step
            while 0 <= place < len(column) and parcel > 0:
                taken = min(parcel, well - level[place])
                level[place] += taken
                parcel = spill * (parcel - taken)
                place += step
    return level


@pytest.mark.parametrize("spill", [1.0, 0.6, 0.0])
def test_blooming_equals_parcels_moved_by_hand(spill):
    well = 100.0
    columns = np.zeros((30, 4))
    columns[12, 0] = 730.0
    columns[[3, 4, 20], 1] = [450.0, 120.0, 900.0]
    columns[:, 2] = RNG.uniform(0, 120, 30)
    columns[[0, 29], 3] = 800.0
    expected = np.stack([overflow(column, well, spill) for column in columns.T], axis=1)
    got = np.asarray(
        bloomed(jnp.asarray(columns[..., None]), jnp.asarray(well), jnp.asarray(spill))
    )
    np.testing.assert_allclose(got[..., 0], expected, rtol=1e-12, atol=1e-9)
    assert got.max() <= well
    if spill == 1:  # electrons leave at the ends only
        np.testing.assert_allclose(got[:, 0].sum(), 730)
        np.testing.assert_array_equal(np.flatnonzero(got[:, 0, 0] > 0), np.arange(8, 17))
    if spill == 0:
        np.testing.assert_allclose(got[..., 0], np.minimum(columns, well))


def clocked(column, inefficiency):
    """Return the charge read out, one clock cycle after the other, where each packet leaves a share
    behind."""
    wells, read = column.copy(), []
    for _ in column:
        kept = inefficiency * wells
        moved = wells - kept
        read.append(moved[0])
        wells = kept + np.append(moved[1:], 0.0)
    return np.array(read)


@pytest.mark.parametrize("inefficiency", [0.0, 1e-4, 0.02])
def test_charge_transfer_against_a_clocked_register(inefficiency):
    image = RNG.uniform(10, 1000, size=(40, 6, 1))
    transfer = s.ChargeTransfer(inefficiency, serial_inefficiency=0.01, trail=20)
    columns = np.stack([clocked(column, inefficiency) for column in image[..., 0].T], axis=1)
    expected = np.stack([clocked(row, 0.01) for row in columns])
    got = jax.jit(transferred)(jnp.asarray(image), transfer)
    np.testing.assert_allclose(got[..., 0], expected, rtol=1e-9)


@pytest.mark.slow
def test_a_trail_that_is_too_short_ends_in_its_last_pixel():
    """The remainder of the negative binomial, by SciPy, is in the last pixel, so no charge is
    lost."""
    for inefficiency, rtol in ((0.01, 1e-9), (1e-3, 1e-7)):
        point = jnp.zeros((1100, 1, 1)).at[1000].set(1.0)
        got = np.asarray(transferred(point, s.ChargeTransfer(inefficiency)))[1000:, 0, 0]
        law = stats.nbinom(1001, 1 - inefficiency)
        np.testing.assert_allclose(got[:8], law.pmf(np.arange(8)), rtol=1e-9)
        np.testing.assert_allclose(got[8], law.sf(7), rtol=rtol)
        assert (got[9:] == 0).all()


@pytest.mark.slow
def test_a_trail_longer_than_the_column_leaves_it():
    """Charge that is deferred beyond the last row is read after the frame."""
    got = transferred(jnp.ones((2, 1, 1)), s.ChargeTransfer(0.1, trail=8))[:, 0, 0]
    np.testing.assert_allclose(got, [0.9, 0.81 + 0.9 * 0.1], rtol=1e-12)


@pytest.mark.sweep
@pytest.mark.parametrize(
    "noise", [s.PoissonShotNoise(), s.FastPoissonShotNoise(), s.GaussianShotNoise()]
)
def test_traced_nan_stays_nan(noise):
    sensor = s.Sensor(shot_noise=noise, gain=0.5, bits=8)
    got = jax.jit(raw_image)(jax.random.key(0), sensor, jnp.asarray([jnp.nan, 10.0]))
    assert np.isnan(got[0])
    assert np.isfinite(got[1])


@pytest.mark.slow
def test_a_full_well_blooms_before_it_is_transferred():
    sensor = s.Sensor(full_well=100.0, blooming=1.0, charge_transfer=s.ChargeTransfer(1e-3))
    image = jnp.zeros((20, 1, 1)).at[10].set(500.0)
    expected = transferred(
        bloomed(image, sensor.full_well, sensor.blooming), sensor.charge_transfer
    )
    np.testing.assert_array_equal(collect(None, sensor, image), expected)


# ------------------------------------------------ shutter


@pytest.mark.slow
def test_a_moving_edge_is_blurred_over_its_path():
    """An edge moves at 20 pixels per second for half a second."""
    x = jnp.arange(40.0)

    def picture(time):
        edge = jnp.clip(x + 0.5 - (10 + 20 * time), 0, 1)
        return jnp.broadcast_to(edge[None, :, None], (3, 40, 1))

    half = jnp.asarray(0.5)
    got = np.asarray(exposed(None, half, picture, rows=3, slots=200))[1, :, 0]
    ramp = np.diff(got)
    np.testing.assert_allclose(ramp.sum(), 1, rtol=1e-12)
    place = np.arange(39) + 0.5
    spread = (ramp @ place**2) - (ramp @ place) ** 2
    np.testing.assert_allclose(np.sqrt(12 * spread), np.sqrt(10**2 + 1), rtol=1e-2)
    np.testing.assert_allclose(ramp[12:18], 0.1, rtol=1e-2)


@pytest.mark.slow
def test_a_rolling_shutter_skews_moving_edges():
    """At 20 pixels per second and 5 ms per row, each row sees the edge 0.1 pixels further."""
    x = jnp.arange(40.0)

    def picture(time):
        edge = jax.nn.sigmoid((10 + 20 * time - x) / 2)
        return jnp.broadcast_to(edge[None, :, None], (16, 40, 1))

    shutter = s.RollingShutter(0.005)
    got = np.asarray(exposed(shutter, jnp.asarray(0.01), picture, rows=16, slots=180))[..., 0]
    place = got.sum(axis=1)
    np.testing.assert_allclose(np.diff(place), 0.1, rtol=1e-2)
    still = np.asarray(exposed(None, jnp.asarray(0.01), picture, rows=16, slots=4))[..., 0]
    np.testing.assert_allclose(still, np.broadcast_to(still[:1], still.shape))


@pytest.mark.sweep
@pytest.mark.parametrize("line_time", [None, 1e-3, 0.3])
def test_slots_divide_each_rows_exposure(line_time):
    shutter = None if line_time is None else s.RollingShutter(line_time)
    times, weights = exposure_slots(shutter, jnp.asarray(0.2), rows=9, slots=7)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)
    assert (weights >= 0).all()
    # The scene is seen in the middle of each slot. If slots are longer than an exposure, the first
    # and the last are near those of the first and the last row.
    readout = (line_time or 0) * 8
    length = max((0.2 + readout) / 7, readout / 6)
    middle = np.arange(9) * (line_time or 0) + 0.1
    first = (0.2 + readout) / 2 - 3 * length
    np.testing.assert_allclose(times, first + length * np.arange(7), rtol=1e-6)
    np.testing.assert_allclose(weights @ times, middle, rtol=1e-6)


@pytest.mark.sweep("2.0-7", "45.0-7")
@pytest.mark.parametrize("slots", [2, 3, 4, 7])
@pytest.mark.parametrize("exposure", [2.0, pytest.param(12.0, marks=pytest.mark.slow), 45.0])
def test_a_linear_ramp_is_averaged_exactly_for_any_slots(slots, exposure):
    """Rows are 10 s apart, and the mean of t over a row's exposure is its middle."""
    shutter, time = s.RollingShutter(10.0), jnp.asarray(exposure)
    seen = exposed(shutter, time, lambda t: t * jnp.ones((4, 1, 1)), rows=4, slots=slots)
    np.testing.assert_allclose(seen[:, 0, 0], 10 * np.arange(4) + exposure / 2, rtol=1e-6)


@pytest.mark.slow
def test_the_error_of_a_parabola_falls_with_the_square_of_the_slots():
    """The mean of t^2 over begin .. end is (end^3 - begin^3) / 3 / (end - begin)."""
    shutter, begin = s.RollingShutter(10.0), 10 * np.arange(4)
    true = ((begin + 2.0) ** 3 - begin**3) / 6

    def error(slots):
        seen = exposed(
            shutter, jnp.asarray(2.0), lambda t: t**2 * jnp.ones((4, 1, 1)), rows=4, slots=slots
        )
        return np.abs(seen[:, 0, 0] - true).max()

    assert error(48) < error(6) / 7**2


# ------------------------------------------------ temperature


def test_dark_current_over_temperature():
    """The rate doubles every 8 K, or follows Arrhenius' law: at 0.56 eV by a factor of 2.08 from
    293 to 303 K."""
    doubling = s.DoublingDarkCurrent(10.0, 309.0, 293.0, 8.0)
    np.testing.assert_allclose(dark_rate(doubling), 40.0, rtol=1e-12)
    law = s.ArrheniusDarkCurrent(10.0, 303.0, 293.0, 0.56)
    kelvin = 1.602176634e-19 / 1.380649e-23
    np.testing.assert_allclose(
        dark_rate(law), 10 * np.exp(0.56 * kelvin * (1 / 293 - 1 / 303)), rtol=1e-11
    )
    assert 2.0 < float(dark_rate(law)) / 10 < 2.2
    sensor = s.Sensor(dark_current=doubling, exposure_time=0.5)
    np.testing.assert_allclose(raw_image(None, sensor, jnp.zeros((2, 1))), 20.0)


# ------------------------------------------------ bad input


BAD = {
    "gain": (lambda: s.Sensor(gain=0.0), r"Sensor\.gain must be finite, above 0, got 0\.0"),
    "bits": (lambda: s.Sensor(bits=60), r"Sensor\.bits .* at least 1 and at most 53, got 60"),
    "float32 bits": (
        lambda: s.Sensor(bits=jnp.asarray(25, jnp.float32)),
        r"Sensor\.bits .* at most 24, got 25",
    ),
    "fill factor": (lambda: s.PixelAperture(0.0), r"fill_factor .* above 0 and at most 1, got 0"),
    "fill factor 2": (lambda: s.PixelAperture(1.5), r"fill_factor .* at most 1, got 1\.5"),
    "efficiency": (lambda: s.Sensor(quantum_efficiency=[0.5, 1.2]), r"efficiency .* got 1\.2"),
    "nan": (lambda: s.Sensor(read_noise=np.nan), r"Sensor\.read_noise .* got nan"),
    "crosstalk": (lambda: s.Sensor(crosstalk=0.3), r"crosstalk .* at most 0\.25, got 0\.3"),
    "blooming": (lambda: s.Sensor(blooming=0.3), r"full_well must be given"),
    "trail": (lambda: s.ChargeTransfer(1e-5, trail=0), r"trail must be .* got 0"),
    "half a bit": (lambda: s.Sensor(bits=12.5), r"Sensor\.bits must be a whole number, got 12\.5"),
    "bits of another dtype": (
        lambda: raw_image(None, as_dtype(s.Sensor(bits=30), jnp.float32), jnp.ones(1)),
        r"Sensor\.bits .* at most 24, got 30",
    ),
    "wrong record": (
        lambda: s.Sensor(read_noise=s.PoissonShotNoise()),
        r"Sensor\.read_noise must be a record, HeavyTailedReadNoise, got a PoissonShotNoise",
    ),
    "bands": (
        lambda: raw_image(None, s.Sensor(quantum_efficiency=[0.5]), jnp.ones((4, 3))),
        r"Sensor\.quantum_efficiency must be \(\) or \(3,\), .* got shape \(1,\)",
    ),
    "cut": (
        lambda: raw_image(None, s.Sensor(infrared_cut=[0.5, 0.5]), jnp.ones((4, 3))),
        r"Sensor\.infrared_cut must be \(\) or \(3,\), .* got shape \(2,\)",
    ),
    "endless light": (
        lambda: raw_image(None, s.Sensor(), jnp.asarray([1.0, jnp.inf])),
        r"irradiance must be finite and at least 0 everywhere, got inf",
    ),
    "negative light": (
        lambda: raw_image(None, s.Sensor(), jnp.asarray([1.0, -2.0])),
        r"irradiance must be finite and at least 0 everywhere, got -2\.0",
    ),
    "no light": (
        lambda: raw_image(None, s.Sensor(), jnp.asarray([1.0, jnp.nan])),
        r"irradiance must be finite and at least 0 everywhere, got nan",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named_with_its_value_and_range(case):
    make, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        make()


def test_a_traced_sensor_is_not_checked():
    def shoot(gain, light):
        return raw_image(None, s.Sensor(gain=gain, full_well=100.0), light)

    gains = jnp.asarray([1.0, -1.0])
    light = jnp.full((2, 1), 5.0)
    np.testing.assert_allclose(jax.vmap(jax.jit(shoot))(gains, light)[:, 0], [5.0, -5.0])


def test_iso_doubles_the_numbers_and_halves_the_exposure_at_saturation():
    """By ISO 12232, saturation is reached at as many times less light as the gain is larger."""
    base = s.Sensor(gain=0.25, bits=12, offset=10.0)
    fast = set_iso(base, 800, base_iso=200)
    electrons = np.array([[[(4095 - 10) / 0.25]]])
    np.testing.assert_allclose(digitise(base, electrons), 4095)
    np.testing.assert_allclose(digitise(fast, electrons / 4), 4095)
    assert set_iso(s.Sensor(), 50).gain == 0.5
