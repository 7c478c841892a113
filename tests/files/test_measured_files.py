"""Tests files of measured reflectance: their layout against independent writers, round trips, and
one sentence for each mistake in a file."""

import re
import struct
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import measured as oracle

from jaxvision import InputError, brdf
from jaxvision.brdf.half_difference import HalfDifferenceTable, bin_angles, half_difference
from jaxvision.brdf.measured import BRDFSamples, sample_directions
from jaxvision.files import measured as files

SHAPE = (12, 10, 8)


def reflectance(h, d, p):
    """Return a reflectance that is smooth in all angles, differs in the colours, and is symmetric
    under phi_d + pi."""
    base = 0.2 + 0.5 * np.exp(-np.square(np.tan(h * 0.9))) * (1 + 0.3 * np.cos(2 * p) * d)
    return base[..., None] * np.array([1.0, 0.6, 0.3])


def write(folder, name, data):
    path = folder / name
    path.write_bytes(data) if isinstance(data, bytes) else path.write_text(data)
    return path


def refused(reader, path, *words):
    """Return the message of a refusal, which is one sentence with the file's name and all of the
    words."""
    with pytest.raises(InputError) as caught:
        reader(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert message.endswith(".")
    assert "\n" not in message
    for word in words:
        assert word in message, message
    return message


# ------------------------------------------------ MERL


def test_merl_layout_is_the_published_one(tmp_path):
    """Each valid bin contains the value written at its angles."""
    data, valid = oracle.merl_bytes(reflectance, SHAPE)
    path = write(tmp_path, "paint.binary", data)
    table = files.read_merl(path)
    middles = np.meshgrid(*map(np.asarray, bin_angles(table)), indexing="ij")
    expected = reflectance(*middles)
    values = np.asarray(table.values)
    assert 0.5 < valid.mean() < 1
    np.testing.assert_allclose(values[valid], expected[valid], rtol=1e-14)
    assert set(values[~valid, 0]) <= set(values[valid, 0])
    zeroed = np.asarray(files.read_merl(path, invalid="zero").values)
    assert (zeroed[~valid] == 0).all()
    np.testing.assert_array_equal(zeroed[valid], values[valid])


def test_a_marked_bin_takes_the_nearest_around_the_circle(tmp_path):
    stored = np.full((3, 1, 1, 8), -1.0)
    stored[:, 0, 0, 7], stored[:, 0, 0, 4] = 1500, 3000
    path = write(tmp_path, "few.binary", struct.pack("<3i", 1, 1, 8) + stored.tobytes())
    red = np.asarray(files.read_merl(path).values)[0, 0, :, 0]
    np.testing.assert_allclose(red[[0, 1, 3, 5, 7]], [1, 1, 2, 2, 1])


def test_a_bin_marked_in_one_colour_was_not_measured(tmp_path):
    stored = np.full((3, 1, 1, 4), 1500.0)
    stored[:, 0, 0, 1], stored[1, 0, 0, 2] = 3000, -1.0
    path = write(tmp_path, "one.binary", struct.pack("<3i", 1, 1, 4) + stored.tobytes())
    zeroed = np.asarray(files.read_merl(path, invalid="zero").values)[0, 0]
    np.testing.assert_allclose(zeroed[:, 1], 1.15 * np.array([1, 2, 0, 1]))
    np.testing.assert_array_equal(zeroed[2], 0)
    assert (np.asarray(files.read_merl(path).values) > 0).all()


@pytest.mark.slow
def test_a_full_size_merl_file_gives_the_published_lookup(tmp_path):
    """With 90 x 90 x 180 bins, nearest-bin values equal the published reader's, and linear ones are
    near the tabulated function."""
    data, _ = oracle.merl_bytes(reflectance)
    table = files.read_measured(write(tmp_path, "full.binary", data))
    assert isinstance(table, HalfDifferenceTable)
    assert table.values.shape == (90, 90, 180, 3)
    rng = np.random.default_rng(2)
    wi, wo = oracle.directions(rng, 200, highest=1.4), oracle.directions(rng, 200, highest=1.4)
    angles = [oracle.half_difference(*pair) for pair in zip(wi, wo, strict=True)]
    nearest = HalfDifferenceTable(table.values, interpolation="nearest")
    evaluate = jax.jit(jax.vmap(brdf.evaluate, (None, 0, 0)))
    expected = np.array([np.asarray(table.values)[oracle.merl_bin(a)] for a in angles])
    np.testing.assert_array_equal(evaluate(nearest, wi, wo), expected)
    theta_h, _, theta_d, phi_d = np.array(angles).T
    everywhere = reflectance(*np.meshgrid(*map(np.asarray, bin_angles(table)), indexing="ij"))
    curvature = sum(np.abs(np.diff(everywhere, 2, axis=k)).max() for k in range(3))
    error = np.abs(evaluate(table, wi, wo) - reflectance(theta_h, theta_d, phi_d))
    assert error.max() < curvature / 8  # the bound of linear interpolation
    assert curvature < 0.01


def test_merl_round_trip(tmp_path):
    values = np.random.default_rng(1).uniform(0, 5, (*SHAPE, 3))
    files.write_merl(tmp_path / "a.binary", HalfDifferenceTable(jnp.asarray(values)))
    np.testing.assert_allclose(files.read_merl(tmp_path / "a.binary").values, values, rtol=1e-15)
    grey = HalfDifferenceTable(jnp.ones((*SHAPE, 1)))
    with pytest.raises(InputError, match="holds 3 bands, got 1"):
        files.write_merl(tmp_path / "b.binary", grey)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.binary"]


def test_a_merl_head_in_another_order_is_named(tmp_path, monkeypatch):
    """The header gives 180 x 90 x 90 bins instead of 90 x 90 x 180. The test uses fewer bins."""
    monkeypatch.setattr(files.merl, "OF_DATABASE", SHAPE)
    data, _ = oracle.merl_bytes(reflectance, SHAPE)
    turned = struct.pack("<3i", *SHAPE[::-1]) + data[12:]
    with pytest.warns(UserWarning, match="correct the head"):
        files.read_merl(write(tmp_path, "1", turned))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        files.read_merl(write(tmp_path, "2", data))
    assert not any("correct the head" in str(w.message) for w in said)


def test_wrong_merl_files_are_named(tmp_path):
    data, _ = oracle.merl_bytes(reflectance, SHAPE)
    swapped, _ = oracle.merl_bytes(reflectance, SHAPE, order=">")
    values = np.frombuffer(data[12:], "<f8").copy()
    values[3] = np.nan
    refused(files.read_merl, tmp_path / "absent.binary", "no such file")
    refused(files.read_merl, write(tmp_path, "1", b"abc"), "too short")
    refused(files.read_merl, write(tmp_path, "2", swapped), "big-endian")
    refused(files.read_merl, write(tmp_path, "3", data[:-8]), "cut short", str(len(data)))
    refused(files.read_merl, write(tmp_path, "4", data + b"12345678"), "damaged")
    refused(files.read_merl, write(tmp_path, "5", data[:12] + values.tobytes()), "1 values are not")
    refused(files.read_merl, write(tmp_path, "6", b"P6 640 480 255 " * 9), "is not a MERL file")
    empty = data[:12] + np.full(3 * np.prod(SHAPE), -1.0).tobytes()
    refused(files.read_merl, write(tmp_path, "7", empty), "not measured")
    refused(files.read_measured, write(tmp_path, "a.txt", data), "'.txt'", ".bsdf")


# ------------------------------------------------ Cornell

CORNELL = """# a comment
# num wls
3

400 410
420   # the wavelengths may take several lines
# theta i, phi i, theta s, phi_s, spectral sample values

0.5 0.0 0.6 3.0 0.1 0.2 0.3
0.7 0.1 0.0 -1.0 0.4 0.5 0.6
"""


def test_cornell_columns(tmp_path):
    samples = files.read_measured(write(tmp_path, "paint.brdf", CORNELL))
    assert isinstance(samples, BRDFSamples)
    np.testing.assert_allclose(samples.wavelengths, [400e-9, 410e-9, 420e-9], rtol=1e-15)
    np.testing.assert_array_equal(samples.theta_i, [0.5, 0.7])
    np.testing.assert_array_equal(samples.phi_i, [0.0, 0.1])
    np.testing.assert_array_equal(samples.theta_o, [0.6, 0.0])
    np.testing.assert_array_equal(samples.phi_o, [3.0, -1.0])
    np.testing.assert_array_equal(samples.values, [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])


def test_cornell_round_trip(tmp_path):
    rng = np.random.default_rng(4)
    angles = rng.uniform(0, 1.5, (4, 6))
    samples = BRDFSamples(*angles, rng.random((6, 3)), np.array([450e-9, 550e-9, 650e-9]))
    files.write_cornell(tmp_path / "a.brdf", samples, description="Two\nlines")
    again = files.read_cornell(tmp_path / "a.brdf")
    for name in ("theta_i", "phi_i", "theta_o", "phi_o", "values"):
        np.testing.assert_array_equal(getattr(again, name), getattr(samples, name))
    np.testing.assert_allclose(again.wavelengths, samples.wavelengths, rtol=1e-12)
    assert (tmp_path / "a.brdf").read_text().startswith("# Two\n# lines\n")
    with pytest.raises(InputError, match="needs wavelengths"):
        files.write_cornell(tmp_path / "b.brdf", BRDFSamples(*angles, rng.random((6, 3))))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("0.4 0.5 0.6", "0.4 0.5", ("line 10", "6 columns", "make 7")),
        ("0.4 0.5 0.6", "0.4 0.5 0.6 0.7", ("line 10", "8 columns")),
        ("0.4 0.5 0.6", "0.4 nan 0.6", ("line 10", "not a finite number")),
        ("0.4 0.5 0.6", "0.4 0,5 0.6", ("line 10", "not a row of numbers")),
        ("0.7 0.1", "40 0.1", ("line 10", "degrees")),
        ("0.5 0.0", "-0.5 0.0", ("line 9", "pi / 2")),
        ("0.6 3.0", "0.6 180", ("line 9", "azimuths 0 and 180", "degrees")),
        ("0.7 0.1", "0.7 -90", ("line 10", "azimuths -90 and -1", "degrees")),
        ("3\n", "3.5\n", ("count of wavelengths",)),
        ("3\n", "4\n", ("4 increasing wavelengths",)),
        ("400 410", "410 400", ("increasing wavelengths",)),
        (CORNELL[CORNELL.index("0.5") :], "", ("no samples",)),
        (CORNELL, "# nothing", ("count of wavelengths",)),
    ],
)
def test_wrong_cornell_files_are_named(tmp_path, old, new, words):
    assert old in CORNELL
    refused(files.read_cornell, write(tmp_path, "x.brdf", CORNELL.replace(old, new, 1)), *words)


def test_a_binary_file_is_no_cornell_file(tmp_path):
    refused(files.read_cornell, write(tmp_path, "x.brdf", b"3\n\xff\xfe"), "not a text file")


@pytest.mark.slow
def test_scattered_samples_become_a_table():
    """The samples are of a known lobe at Cornell's angles."""
    theta = np.radians(np.arange(10, 81, 10.0))
    axes = np.meshgrid(theta, np.radians(np.arange(0, 80, 8.0)), np.linspace(0, np.pi, 19))
    theta_i, theta_o, phi = (axis.ravel() for axis in axes)

    def paint(wi, wo):
        angles = jax.vmap(half_difference)(wi, wo)
        lobe = jnp.exp(-jnp.square(jnp.tan(angles.theta_h) / 0.3))
        return (0.1 + 0.5 * lobe * (1 + jnp.square(angles.theta_d)))[:, None]

    blank = BRDFSamples(theta_i, 0 * phi, theta_o, phi, np.zeros((phi.size, 1)), [5e-7])
    directions = sample_directions(blank)
    samples = BRDFSamples(theta_i, 0 * phi, theta_o, phi, paint(*directions), [5e-7])
    table = files.table_of_samples(samples, shape=(40, 16, 8))
    evaluate = jax.jit(jax.vmap(brdf.evaluate, (None, 0, 0)))
    np.testing.assert_allclose(evaluate(table, *directions), samples.values, rtol=0.08)
    np.testing.assert_array_equal(table.wavelengths, [5e-7])
    rng = np.random.default_rng(6)
    wi, wo = (jnp.asarray(oracle.directions(rng, phi.size, highest=1.35)) for _ in range(2))
    found = evaluate(table, wi, wo)
    error = found / paint(wi, wo) - 1
    assert jnp.sqrt(jnp.mean(jnp.square(error))) < 0.02
    flip = np.array([[1.0, -1.0, 1.0]])
    np.testing.assert_allclose(evaluate(table, wo, wi), found, rtol=1e-9)
    np.testing.assert_allclose(evaluate(table, wi * flip, wo * flip), found, rtol=1e-9)


# ------------------------------------------------ RGL


def rgl_fields(rng, **options):
    """Return the oracle's tables with elevations that end at pi / 2, as in a file."""
    fields = oracle.rgl_fields(rng, **options)
    theta = fields["theta_i"]
    return fields | {"theta_i": theta * np.float32(np.pi / 2 / theta[-1])}


@pytest.mark.sweep
@pytest.mark.parametrize("bands", [None, 5])
def test_rgl_fields_and_round_trip(tmp_path, bands):
    """The reference writes out the construction over the same fields."""
    fields = rgl_fields(np.random.default_rng(3), bands=bands)
    path = write(tmp_path, "m.bsdf", oracle.tensor_bytes(fields))
    material = files.read_measured(path)
    rng = np.random.default_rng(7)
    wi, wo = oracle.directions(rng, 20), oracle.directions(rng, 20)
    shading = jax.jit(jax.vmap(brdf.shading, (None, 0, 0)))
    expected = [oracle.rgl_shading(fields, *pair)[0] for pair in zip(wi, wo, strict=True)]
    np.testing.assert_allclose(shading(material, wi, wo), expected, rtol=1e-6)
    if bands:
        np.testing.assert_allclose(material.wavelengths, np.linspace(400e-9, 700e-9, 5), rtol=1e-6)
    files.write_rgl(tmp_path / "again.bsdf", material, description="µ paint")
    again = files.read_rgl(tmp_path / "again.bsdf")
    assert jax.tree.structure(again) == jax.tree.structure(material)
    for new, old in zip(jax.tree.leaves(again), jax.tree.leaves(material), strict=True):
        np.testing.assert_allclose(new, old, rtol=3e-7, atol=1e-12)


def test_symmetry_follows_from_the_span_of_azimuths(tmp_path):
    for span, symmetry in ((2 * np.pi, 1), (np.pi, 2), (np.pi / 2, 4)):
        phi = np.linspace(-np.pi, -np.pi + span, 3)
        fields = rgl_fields(np.random.default_rng(3), phi=phi)
        path = write(tmp_path, "m.bsdf", oracle.tensor_bytes(fields))
        assert files.read_rgl(path).symmetry == symmetry


@pytest.mark.parametrize("span", [2.618, 1.75 * np.pi, 0.45 * np.pi])
def test_azimuths_that_end_too_early_are_named(span, tmp_path):
    """A sixth of the half turn is missing, or the last of eight azimuths, which closes the turn."""
    fields = rgl_fields(np.random.default_rng(3), phi=np.linspace(0, span, 4))
    path = write(tmp_path, "m.bsdf", oracle.tensor_bytes(fields))
    refused(files.read_rgl, path, "phi_i", f"spans {span:.4g}"[:9], "neither a turn nor")


def test_unscaled_values_are_taken_as_they_are(tmp_path):
    fields = rgl_fields(np.random.default_rng(3)) | {"jacobian": np.array([0], np.uint8)}
    fields["rgb"] = np.full_like(fields["rgb"], 0.25)
    material = files.read_rgl(write(tmp_path, "m.bsdf", oracle.tensor_bytes(fields)))
    up = jnp.asarray([0.0, 0.0, 1.0])
    np.testing.assert_allclose(brdf.shading(material, up, up), 0.25, rtol=1e-6)


def test_wrong_rgl_files_are_named(tmp_path):
    fields = rgl_fields(np.random.default_rng(3))
    data = oracle.tensor_bytes(fields)

    def changed(**new):
        return write(tmp_path, "x.bsdf", oracle.tensor_bytes(fields | new))

    read = files.read_rgl
    refused(read, write(tmp_path, "1.bsdf", b"P6 640 480"), "not an RGL tensor file")
    refused(read, write(tmp_path, "2.bsdf", data[:12] + b"\2\0" + data[14:]), "version (2, 0)")
    refused(read, write(tmp_path, "3.bsdf", data[:-100]), "cut short")
    refused(read, write(tmp_path, "4.bsdf", data[:40]), "cut short")
    swapped = data[:14] + struct.pack(">I", len(fields)) + data[18:]
    refused(read, write(tmp_path, "5.bsdf", swapped), "big-endian")
    some = {name: x for name, x in fields.items() if name not in ("rgb", "sigma")}
    refused(read, write(tmp_path, "6.bsdf", oracle.tensor_bytes(some)), "no field sigma, rgb")
    refused(read, changed(vndf=fields["vndf"][:, :2]), "'vndf' has shape", "4 elevations")
    refused(read, changed(rgb=fields["rgb"][:, :, :2]), "'rgb' has shape", "3 bands")
    refused(read, changed(ndf=np.full((2, 4), np.nan, np.float32)), "'ndf'", "not finite")
    refused(read, changed(theta_i=fields["theta_i"][::-1]), "'theta_i' does not increase")
    kind = data.index(b"phi_i") + len("phi_i") + 2
    refused(
        read, write(tmp_path, "7.bsdf", data[:kind] + b"\x63" + data[kind + 1 :]), "unknown type 99"
    )


def test_an_impossible_rgl_header_is_named(tmp_path):
    """The header is cut in its first words, or has impossible dimensions, including 0."""
    data = oracle.tensor_bytes(rgl_fields(np.random.default_rng(3)))
    for length in (0, 5, 12, 13):
        refused(files.read_rgl, write(tmp_path, "cut.bsdf", data[:length]), "cut short")
    place = data.index(b"phi_i") + len("phi_i")

    def announced(*shape):
        head = struct.pack("<HBQ", len(shape), 10, 0) + struct.pack(f"<{len(shape)}Q", *shape)
        return write(tmp_path, "odd.bsdf", data[:place] + head + data[place + 19 :])

    refused(files.read_rgl, announced(*[0] * 100), "'phi_i' announces 100 dimensions")
    refused(files.read_rgl, announced(*[0] * 60_000), "'phi_i' announces 60000 dimensions")
    refused(files.read_rgl, announced(0, *[2**62] * 7), "cut short")
    refused(files.read_rgl, announced(2**63 - 1), "cut short")


@pytest.mark.parametrize(
    ("new", "words"),
    [
        ({"theta_i": np.linspace(0, 90, 4)}, ("'theta_i' runs from 0 to 90", "degrees")),
        ({"theta_i": np.linspace(-0.1, 1.5, 4)}, ("'theta_i' runs from -0.1 to 1.5",)),
        ({"phi_i": np.linspace(-180, 180, 3)}, ("'phi_i' runs from -180 to 180", "degrees")),
        ({"phi_i": np.linspace(-4, 4, 3)}, ("'phi_i' runs from -4 to 4", "one turn")),
        ({"phi_i": np.linspace(0, 2.1, 3)}, ("'phi_i' spans 2.1 rad",)),
        ({"luminance": -1.0}, ("'luminance' holds -1",)),
        ({"vndf": -1.0}, ("'vndf' holds -1",)),
        ({"luminance": 0.0}, ("'luminance' is 0 everywhere",)),
        ({"vndf": 0.0}, ("'vndf' is 0 everywhere",)),
        ({"sigma": 0.0}, ("'sigma' is 0 everywhere",)),
        ({"wavelengths": np.array([400, np.nan, 600])}, ("'wavelengths'", "finite numbers")),
    ],
)
def test_impossible_rgl_numbers_are_named(tmp_path, new, words):
    """Angles are in degrees, or values are not densities. One number fills the whole field."""
    (name, value), *_ = new.items()
    phi, bands = (value, None) if name == "phi_i" else ((0.0,), 3)
    fields = rgl_fields(np.random.default_rng(3), phi=phi, bands=bands)
    fields[name] = np.full_like(fields[name], value)
    path = write(tmp_path, "x.bsdf", oracle.tensor_bytes(fields))
    refused(files.read_rgl, path, *words)


def test_values_beyond_the_range_of_the_dtype_are_refused(tmp_path):
    """1e39 is finite in float64, but infinite in float32, the precision of the result."""
    path = write(tmp_path, "huge.brdf", "1\n500\n0.1 0 0.1 0 1e39\n")
    assert files.read_cornell(path).values[0, 0] == 1e39
    with jax.enable_x64(False):
        refused(files.read_cornell, path, "line 3", "not a finite number")


def test_a_colour_of_a_merl_file_that_ends_in_zeros_is_named(tmp_path):
    values = np.full((4, 4, 8, 3), 0.2)
    values[3, 2:, :, 2] = 0
    files.write_merl(tmp_path / "cut.binary", HalfDifferenceTable(jnp.asarray(values)))
    with pytest.warns(UserWarning, match="blue ends in zeros, 12% of its bins"):
        files.read_merl(tmp_path / "cut.binary")


@pytest.mark.sweep("12-")
@pytest.mark.parametrize(
    ("factor", "words"),
    [(1, None), (1 / 1500, r"reflects 0\.02 % of the light"), (12, r"reflects 3\.6e\+02 % of the")],
)
def test_a_merl_file_in_another_unit_is_named(factor, words, tmp_path):
    """The surface is matte with an albedo of .3, and the scale of the database is left out or
    applied twice."""
    table = jnp.full((90, 90, 180, 3), factor * 0.3 / np.pi, jnp.float32)
    files.write_merl(tmp_path / "a.binary", HalfDifferenceTable(table))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        files.read_merl(tmp_path / "a.binary")
    assert len(said) == (words is not None)
    assert re.search(words or "", " ".join(str(one.message) for one in said))


@pytest.mark.parametrize(("factor", "named"), [(1, False), (np.pi, True), (100, True)])
def test_radiance_factors_in_a_cornell_file_are_named(factor, named, tmp_path):
    """A white paint of albedo .85."""
    angles = [(a, 0.3, b, 3.0) for a in (0.2, 0.8) for b in np.linspace(0, 1.5, 60)]
    rows = [" ".join(map(str, (*four, factor * 0.85 / np.pi))) for four in angles]
    (tmp_path / "a.brdf").write_text("\n".join(["1", "550", *rows]))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        files.read_cornell(tmp_path / "a.brdf")
    assert any("radiance factors" in str(one.message) for one in said) == named
