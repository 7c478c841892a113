"""Tests malformed text files, nested, long or huge: each gives one short sentence."""

import json
import tracemalloc

import pytest
import tomli_w
from scene_texts import BALL
from typer.testing import CliRunner

from fitting.cli import app as fitting_app
from fitting.noise.levels_table import read_table
from fitting.rig import load_rig
from jaxvision.cli import app
from jaxvision.errors import InputError
from jaxvision.files.cameras import read_camera, read_sensor
from jaxvision.files.materials import read_material
from jaxvision.files.scenes import read_scene

DEEP = {
    "arrays": "a = " + "[" * 400 + "]" * 400,
    "few arrays": "a = " + "[" * 70 + "]" * 70,
    "tables": "a = " + "{b = " * 400 + "1" + "}" * 400,
    "dotted key": ".".join("a" * 1 for _ in range(20_000)) + " = 1",
    "quoted key": ".".join('"a"' for _ in range(20_000)) + " = 1",
    "heading": "[" + ".".join("abc" for _ in range(20_000)) + "]\nb = 1",
    "key in braces": "x = {" + ".".join("a" for _ in range(20_000)) + " = 1}",
    "long key": "k" * 60_000 + " = 1",
    "long number": "a = " + "9" * 60_000,
    "number of 3000 digits": "a = " + "9" * 3_000,
    "hexadecimal": "a = 0x" + "f" * 60_000,
    "long string": '[camera]\nkind = "' + "x" * 60_000 + '"',
    "no equals sign": "x" * 60_000,
}
READERS = [read_scene, read_camera, read_sensor, load_rig, read_material]


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.__name__)
@pytest.mark.parametrize("text", DEEP.values(), ids=DEEP.keys())
def test_toml_of_any_shape_is_one_short_sentence(tmp_path, reader, text):
    file = tmp_path / "rig.toml"
    file.write_text(text)
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            reader(tmp_path if reader is load_rig else file)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(str(caught.value)) < 1000
    assert "\n" not in str(caught.value)
    assert most < 20e6


def test_text_with_many_points_is_read(tmp_path):
    """The check of long keys must allow numbers, text and comments with many points."""
    points = ".".join("abc" for _ in range(200))
    text = f'# {points} = 1\nabout = "{points}"\n[sensor]\ngain = 0.5 # {points}\n'
    (tmp_path / "sensor.toml").write_text(text)
    assert float(read_sensor(tmp_path / "sensor.toml").gain) == 0.5


def test_a_huge_text_file_is_refused_unread(tmp_path):
    file = tmp_path / "scene.toml"
    with file.open("wb") as stream:
        stream.truncate(1 << 30)  # uses no disk space
    tracemalloc.start()
    try:
        for suffix in (".toml", ".xml", ".pbrt"):
            whole = file.rename(file.with_suffix(suffix))
            with pytest.raises(InputError, match="holds 1024 MiB, more than 16; divide it"):
                read_scene(whole)
            whole.rename(file)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 20e6


@pytest.mark.parametrize(
    "body",
    [
        "<shape>" * 3000 + "</shape>" * 3000,
        '<integer name="' + "x" * 60_000 + '" value="1.5"/>',
        '<float name="x" value="' + "1 " * 60_000 + '"/>',
        '<ref id="' + "y" * 60_000 + '"/>',
    ],
)
def test_xml_of_any_shape_is_one_short_sentence(tmp_path, body):
    (tmp_path / "scene.xml").write_text(f'<scene version="3.0.0">{body}</scene>')
    with pytest.raises(InputError) as caught:
        read_scene(tmp_path / "scene.xml")
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    "content",
    [
        '{"asset": {"version": "2.0"}, "extras": ' + "[" * 200 + "]" * 200 + "}",
        "[" * 100_000 + "]" * 100_000,
        json.dumps({"asset": {"version": "1" * 60_000}}),
        '{"asset": {"version": "2.0"}, "scene": ' + "9" * 60_000 + "}",
        '{"asset": {"version": "2.0"}, "scene": ' + "9" * 3_000 + "}",
        json.dumps({"asset": {"version": "2.0"}, "x" * 60_000: 1}),
    ],
)
def test_gltf_of_any_shape_is_one_short_sentence(tmp_path, content):
    (tmp_path / "scene.gltf").write_text(content)
    with pytest.raises(InputError) as caught:
        read_scene(tmp_path / "scene.gltf")
    assert len(str(caught.value)) < 1000


def test_entries_without_effect_are_named(tmp_path):
    """The file has a material on no surface, and keys of another integrator."""
    gold = '[material.gold]\nfamily = "lambert"\nalbedo = 0.3\n'
    file = tmp_path / "scene.toml"
    file.write_text(BALL + gold)
    with pytest.warns(UserWarning, match=r"scene\.toml: material 'gold' is on no surface\.$"):
        read_scene(file)
    file.write_text(BALL + '[render]\nintegrator = "path"\npatches = 50\nsamples = 2\n')
    with pytest.warns(UserWarning, match="patches has no effect with the integrator 'path'"):
        read_scene(file)


@pytest.mark.filterwarnings("default")
def test_options_without_effect_are_named(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"P5 2 2 255\n" + bytes(4))
    said = CliRunner().invoke(app, ["inspect", str(tmp_path / "a.pgm"), "--row", "1"]).output
    assert "jaxvision: --row has no effect without --out" in said


def test_toml_with_a_byte_order_mark_is_read(tmp_path):
    (tmp_path / "sensor.toml").write_text("[sensor]\ngain = 0.5\n", encoding="utf-8-sig")
    assert float(read_sensor(tmp_path / "sensor.toml").gain) == 0.5


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.__name__)
@pytest.mark.parametrize(
    ("encoding", "reason"),
    [
        ("utf-16", "is text in UTF-16 or UTF-32; save it as UTF-8"),
        ("utf-16-le", "is text in UTF-16 or UTF-32; save it as UTF-8"),
        ("utf-32-be", "is text in UTF-16 or UTF-32; save it as UTF-8"),
        ("latin-1", "line 2 holds the byte 0xb5, which is not UTF-8 but perhaps Latin-1; save it"),
    ],
)
def test_text_of_another_encoding_is_named(tmp_path, reader, encoding, reason):
    file = tmp_path / "rig.toml"
    file.write_bytes("[camera]\nname = 'µ'\n".encode(encoding))
    with pytest.raises(InputError, match=reason):
        reader(tmp_path if reader is load_rig else file)


HEADS = (
    "photons_per_pixel,exposure_ms,mean_bright_DN,var_bright_DN2,mean_dark_DN,var_dark_DN2,pixels"
)
ROWS = ["0,1,10,2,10,2,1000", "100,1,60,27,10,2,1000", "200,1,110,52,10,2,1000"]


def table(heads, rows):
    return "\n".join([heads, *rows]) + "\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            table(HEADS + ",exposure_ms", [row + ",2" for row in ROWS]),
            "has column exposure_ms more than once; delete the wrong one",
        ),
        (
            table(HEADS + ",exposure_s", [row + ",1" for row in ROWS]),
            "columns exposure_s and exposure_ms contradict each other; delete the wrong one",
        ),
        (table(HEADS, ROWS).replace(",", ";"), "between semicolons; separate them by commas"),
        (table(HEADS, ROWS).replace(",", "\t"), "between tabs; separate them by commas"),
        (table(HEADS + ",µ", [row + ",1" for row in ROWS]), "line 1 holds the byte 0xb5"),
    ],
)
def test_a_table_that_contradicts_itself_is_refused(tmp_path, text, reason):
    file = tmp_path / "levels.csv"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=reason):
        read_table(file, 12)
    agreeing = table(HEADS + ",exposure_s", [row + ",0.001" for row in ROWS])
    file.write_text(agreeing, encoding="utf-8-sig")
    assert float(read_table(file, 12).bright.exposure[0]) == pytest.approx(1e-3)


@pytest.mark.filterwarnings("default")
def test_options_of_another_integrator_are_named(tmp_path):
    (tmp_path / "scene.toml").write_text(BALL)
    words = ["--resolution", "1x1", "--no-preview", "--out", str(tmp_path / "a.exr")]
    words = ["render", str(tmp_path / "scene.toml"), "--integrator", "direct", *words]
    said = CliRunner().invoke(app, [*words, "--depth", "3"]).stderr
    assert "--depth has no effect with the integrator 'direct'" in said


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["levels.csv", "--channel", "red"], "table of one channel; leave out the channel 'red'"),
        ([".", "--bits", "8"], "the rig's camera.bits is used; leave out the bits, 8"),
        (["rig.toml", "--bits", "12"], "the rig's camera.bits is used; leave out the bits, 12"),
    ],
)
def test_options_of_another_kind_of_measurement_are_refused(tmp_path, words, reason):
    (tmp_path / "levels.csv").write_text(table(HEADS, ROWS))
    rig = {"camera": {"bits": 12}, "flat": [{"files": ["a.png"], "exposure": 1.0, "photons": 1.0}]}
    (tmp_path / "rig.toml").write_text(tomli_w.dumps(rig))
    found = CliRunner().invoke(fitting_app, ["noise", str(tmp_path / words[0]), *words[1:]])
    assert found.exit_code != 0
    assert reason in " ".join(found.stderr.split())


@pytest.mark.parametrize("words", [["joint"], ["plan", "--target", "exponent"]])
def test_an_index_for_a_model_without_one_is_refused(tmp_path, words):
    given = [words[0], str(tmp_path), *words[1:], "--index", "1.8", "--model", "phong"]
    found = CliRunner().invoke(fitting_app, given)
    assert found.exit_code == 2
    assert "--index: phong has no index of refraction; leave it out" in found.stderr
