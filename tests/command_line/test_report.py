"""Tests reports: rounding by uncertainty, JSON that parses, self-contained HTML, and NetCDF that
ArviZ opens."""

import base64
import io
import json
import re
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from rich.console import Console

from fitting.inference.emcee_run import Emcee
from fitting.inference.estimates import (
    Estimate,
    find,
    gaussian_estimate,
    not_determined,
    sampled_estimate,
)
from fitting.inference.formatting import (
    format_cell,
    format_interval,
    format_number,
    format_p,
    format_value,
    format_within,
)
from fitting.inference.parameters import Parameter
from fitting.inference.posterior import laplace, sample
from fitting.noise.across_settings import findings as of_settings
from fitting.reflectance.from_files import findings as of_files
from fitting.reflectance.from_images.comparison import ModelScore, comparison_table
from fitting.report import progress
from fitting.report.chains import corner_figure
from fitting.report.console import plain_tables, print_section, section_text
from fitting.report.inputs import MOST_PICTURES, inputs_of
from fitting.report.notebook import ShownInNotebooks, section_html
from fitting.report.page import as_html, as_json, write_report
from fitting.report.section import Picture, Section, Table, describing_nothing
from fitting.report.sentences import Finding, evaluate_findings, said_once
from fitting.report.sheet import sheet
from fitting.rig import Rig
from jaxvision.errors import InputError
from jaxvision.files.images import write_image

X = Parameter("x", symbol="x", unit="1")
SPACE = (
    Parameter("gain", symbol="K", unit="DN/e-"),
    Parameter("read_noise", symbol="σ", unit="e-"),
)


def gaussian(vector, args):
    return -(vector @ vector) / (2 * args)


def figure():
    drawn = Figure(figsize=(2, 2))
    drawn.subplots().plot([0, 1])
    return drawn


@pytest.fixture(scope="module")
def section():
    args = jnp.asarray(0.01)
    posterior = laplace(gaussian, SPACE, jnp.zeros(2), args)
    return Section(
        kind="noise",
        title="Photon transfer",
        estimates=(
            gaussian_estimate(
                Parameter("gain", symbol="K", unit="DN/e-"), 0.2807692, 0.00042, method="EMVA 1288"
            ),
            not_determined(
                Parameter("dsnu", symbol="DSNU", unit="e-"),
                "no <spatial> statistics",
                method="EMVA 1288",
            ),
        ),
        findings=("The camera is not exactly linear & says so.",),
        pictures=(Picture("ptc", "Photon transfer", "Variance against mean.", figure),),
        tables=(Table("Models", ("model", "rms"), (("lambert", 0.123456), ("phong", None))),),
        posteriors={"": posterior},
        settings={"bits": 12, "bad": np.nan},
    )


def test_sentences_are_printed_where_their_conditions_are_met():
    table = [
        Finding("bool", lambda x: np.bool_(x > 0), "Positive."),
        Finding("number", lambda x: {"x": x} if x > 1 else None, "{x:.1f} is above one."),
        Finding("several", lambda x: ({"i": i} for i in range(x)), "Number {i}."),
    ]
    assert evaluate_findings(table, 0) == ()
    assert evaluate_findings(table, 2) == (
        "Positive.",
        "2.0 is above one.",
        "Number 0.",
        "Number 1.",
    )


@pytest.mark.parametrize(
    "table", [of_settings.FINDINGS, of_files.FINDINGS, of_files.OVER_MATERIALS, of_files.VERDICT]
)
def test_every_sentence_of_a_table_has_a_key_of_its_own(table):
    assert len({row.key for row in table}) == len(table)
    assert all(row.sentence.endswith((".", "}")) for row in table)


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (0.2807692, 0.00042, "0.28077 ± 0.00042"),
        (30957.123, 321.7, "30960 ± 320"),
        (1.0, 0.0996, "1.000 ± 0.100"),
        (-2.5e-9, 1.2e-10, "-2.50e-09 ± 1.2e-10"),
        (5.0, 0.0, "5 ± 0"),
        (5.0, float("nan"), "5 ± nan"),
        (0.13750288, 8.2e-7, "0.13750288 ± 0.00000082"),
    ],
)
def test_values_are_rounded_to_their_uncertainty(value, error, expected):
    assert format_value(Estimate("x", "x", "1", value, error)) == expected


def test_ends_of_an_interval_have_the_digits_of_the_error():
    estimate = gaussian_estimate(X, 2.0, 0.06)
    assert format_interval(estimate, 68) == "[1.940, 2.060]"
    assert format_interval(estimate, 95) == "[1.882, 2.118]"


def test_chances_too_small_for_a_number_are_said_to_be_small():
    assert [format_p(p) for p in (1.0, 0.0123, 1e-301, 0.0)] == [
        "p = 1",
        "p = 0.012",
        "p < 1e-300",
        "p < 1e-300",
    ]


def test_numbers_without_uncertainty_and_missing_ones():
    assert format_value(Estimate("x", "x", "1", 1 / 3)) == "0.333333"
    assert format_value(not_determined(X, "why")) == "–"
    assert format_interval(not_determined(X, "why"), 68) == ""
    assert format_number(0.0, 9) == "0.000000000e+00"
    assert format_within(25847.9, 2404.0) == "25800"
    assert [format_cell(x) for x in (12624.2, 9999.96, 2e7, 0.12344)] == [
        "12620", "10000", "2e+07", "0.1234"
    ]  # fmt: skip


def test_gaussian_estimates_against_scipy_quantiles():
    plain = gaussian_estimate(X, 2.0, 0.5)
    np.testing.assert_allclose(plain.interval_95, [2 - 0.979982, 2 + 0.979982], rtol=1e-6)
    np.testing.assert_allclose(plain.interval_68, [2 - 0.497229, 2 + 0.497229], rtol=1e-6)
    positive = gaussian_estimate(X, 2.0, 3.0, log_scale=True)
    assert positive.interval_95[0] > 0
    np.testing.assert_allclose(np.prod(positive.interval_95), 4.0)


def test_sampled_estimates_are_quantiles():
    draws = np.arange(10_001) / 10_000
    estimate = sampled_estimate(X, draws, group="red")
    np.testing.assert_allclose(estimate.interval_95, (0.025, 0.975))
    np.testing.assert_allclose(estimate.interval_68, (0.16, 0.84))
    np.testing.assert_allclose(estimate.standard_error, 1 / np.sqrt(12), rtol=1e-3)


def test_find_chooses_by_method_and_group(section):
    assert find(section.estimates, "gain", method="EMVA 1288").value == 0.2807692
    with pytest.raises(KeyError, match="no estimate 'gain'"):
        find(section.estimates, "gain", group="red")


def test_methods_stand_beside_each_other_in_one_row_a_quantity():
    gain, noise = SPACE
    section = Section(
        "noise",
        "T",
        (
            gaussian_estimate(gain, 0.250, 0.004, method="EMVA 1288"),
            gaussian_estimate(gain, 0.2512, 0.002, method="likelihood"),
            gaussian_estimate(noise, 6.0, 0.1, method="EMVA 1288"),
            not_determined(noise, "too few darks", method="likelihood"),
            not_determined(X, "too few darks"),
        ),
        headings={"Noise": ("read_noise",), "Gain": ("gain",), "Absent": ("dsnu",)},
    )
    found = sheet(section)
    assert found.columns == ("EMVA 1288", "likelihood")
    assert [heading for heading, _ in found.blocks] == ["Noise", "Gain", "Of the fit"]
    (read_noise,), (k,), (x,) = (rows for _, rows in found.blocks)
    assert [cell.value for cell in k.cells] == ["0.2500 ± 0.0040", "0.2512 ± 0.0020"]
    assert k.difference == "+0.3 σ"  # 0.0012 over 0.004
    assert "+0.3 σ" in as_html([section], title="")
    assert read_noise.name == "read noise"
    assert [cell.note for cell in read_noise.cells] == [0, 1]
    assert [cell.note for cell in x.cells] == [1, 1]
    assert found.notes == ("too few darks",)


def test_channels_stand_beside_each_other_and_methods_below():
    names = {"red": "Laplace", "green": "Laplace", "blue": "emcee"}
    rows = [gaussian_estimate(X, 1.0, 0.1, group=g, method=m) for g, m in names.items()]
    found = sheet(Section("brdf", "T", tuple(rows)))
    assert found.columns == ("red", "green", "blue")
    assert found.methods == "Methods: Laplace (red, green); emcee (blue)."
    assert not found.compares


def test_sentences_of_channels_are_said_once():
    found = said_once(
        (
            "red: 290 of 1578 samples are saturated; they count as 'at least 3750 DN'.",
            "red: Residuals err (chi-square 1.31); an error of 0.81 % explains them.",
            "A finding of all: 3 lights.",
            "blue: 12 of 1578 samples are saturated; they count as 'at least 3750 DN'.",
            "blue: Residuals err (chi-square 1.14); an error of 0.81 % explains them.",
            "blue: its own.",
        )
    )
    assert found == (
        "Red / blue: 290 / 12 of 1578 samples are saturated; they count as 'at least 3750 DN'.",
        "Red / blue: Residuals err (chi-square 1.31 / 1.14); an error of 0.81 % explains them.",
        "A finding of all: 3 lights.",
        "Blue: its own.",
    )


def test_inputs_are_listed_with_small_pictures(tmp_path):
    import matplotlib.image

    codes = np.arange(200 * 70, dtype=np.uint16).reshape(200, 70) % 1024
    for i in range(MOST_PICTURES + 4):
        write_image(tmp_path / f"{i}.tif", codes)
    rig = Rig.model_validate(
        {
            "folder": tmp_path,
            "camera": {"bits": 10, "black_level": 24, "gamma": 2.2},
            "exposure": [
                {"file": f"{i}.tif", "exposure": 0.125, "exposure_sd": 0.01}
                for i in range(MOST_PICTURES + 4)
            ],
        }
    )
    found = inputs_of(rig, "a response calibration")
    assert [one.files for one in found] == [(f"{i}.tif",) for i in range(MOST_PICTURES + 4)]
    assert sum(one.picture is not None for one in found) == MOST_PICTURES
    first = found[0]
    assert (first.kind, first.settings) == ("exposure", "exposure 0.125 s, exposure sd 0.01")
    assert first.bytes == (tmp_path / "0.tif").stat().st_size
    shown = matplotlib.image.imread(io.BytesIO(base64.b64decode(first.picture())), format="png")
    assert shown.shape[:2] == (67, 24)  # every third pixel of 200 x 70; the last block is shorter
    scaled = np.clip((codes - 24.0) / (1023 - 24), 0, 1)
    np.testing.assert_allclose(
        shown[5, 7, :3], (codes[15:18, 21:24].mean() - 24) / 999, atol=1 / 255
    )
    np.testing.assert_allclose(shown[66, 23, 0], scaled[198:, 69:].mean(), atol=1 / 255)


def test_images_removed_before_the_report_is_written_cost_no_result(section, tmp_path):
    write_image(tmp_path / "0.tif", np.zeros((8, 8), np.uint16))
    exposure = {"file": "0.tif", "exposure": 0.1}
    rig = Rig.model_validate({"folder": tmp_path, "camera": {"bits": 8}, "exposure": [exposure]})
    removed_after = inputs_of(rig, "a response calibration")
    (tmp_path / "0.tif").unlink()
    removed_before = inputs_of(rig, "a response calibration")
    assert removed_before[0].bytes is None
    for found, size in ((removed_after, "bytes"), (removed_before, "removed since")):
        assert found[0].picture() is None
        html = as_html([replace(section, inputs=found)], title="")
        assert size in html
        assert "0.tif" in html
        assert "<img" not in html


def test_json_holds_units_intervals_versions_and_no_nan(section):
    content = json.loads(as_json([section], seed=7, settings={"mcmc": False}))
    gain, dsnu = content["sections"][0]["estimates"]
    assert gain["unit"] == "DN/e-"
    assert len(gain["interval_95"]) == 2
    assert dsnu["value"] is None
    assert dsnu["reason"] == "no <spatial> statistics"
    assert content["seed"] == 7
    assert {"jaxvision", "jax", "emcee"} <= content["versions"].keys()
    assert content["sections"][0]["settings"]["bad"] is None


class Links(HTMLParser):
    def __init__(self):
        super().__init__()
        self.sources, self.text = [], ""

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data):
        self.text += data


def test_the_page_is_self_contained_and_escaped(section):
    page, html = Links(), as_html([section], title="A & B")
    page.feed(html)
    assert html.count("<svg") == 2  # the picture, and the joint uncertainty of its two parameters
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    ids = re.findall(r' id="([^"]*)"', html)
    assert set(re.findall(r'(?:href="|url\()#([^")]*)', html)) <= set(ids)
    assert "#010203" not in html  # lines follow the page's colours, dark or light
    for words in ("0.28077 ± 0.00042", "no <spatial> statistics", "linear & says so", "0.1235"):
        assert words in page.text


def test_columns_of_a_wide_picture_can_be_placed_below_each_other(section):
    """A picture whose columns belong together cannot be split."""

    def wide():
        drawn = Figure(figsize=(8, 2), layout="constrained")
        drawn.subplots(1, 2)
        return drawn

    one = Picture("two", "Two", "Two panels.", wide)
    for picture, strips in ((one, 2), (replace(one, is_whole=True), 1)):
        html = as_html([replace(section, pictures=(picture,), posteriors={})], title="")
        assert html.count("<svg") == html.count('<div style="--drawn: ') == strips
        assert '<figure class="wide"><div class="strips" style="--aspect: 4.0">' in html


def test_a_table_in_a_notebook_has_units_where_there_are_any():
    gain, gamma = (gaussian_estimate(p, 2.0, 0.1) for p in (SPACE[0], X))
    assert "<th>unit</th>" in section_html(Section("noise", "T", (gain, gamma)))
    without = section_html(Section("response", "T", (gamma,)))
    assert "unit" not in without
    assert without.count("<th>") == without.count("<td>") == 2


@pytest.mark.slow
def test_files_of_a_report_and_chains_that_arviz_opens(section, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # its notice of a coming release
        import arviz

    args = jnp.asarray(0.01)
    options = Emcee(walkers=16, block=300)
    chain = sample(gaussian, SPACE, jnp.zeros(2), 0.01 * np.eye(2), args, options=options)
    sections = [
        section,
        Section("brdf", "Reflectance", (), posteriors={"red": chain, "green 1": chain}),
    ]
    folder = tmp_path / "out"
    written = write_report(folder, sections, title="T", seed=1, settings={})
    assert sorted(path.name for path in written) == sorted(p.name for p in folder.iterdir())
    data = arviz.from_netcdf(folder / "brdf_chains.nc")
    drawn = data["posterior"]
    assert drawn["read_noise"].dims == ("chain", "draw", "channel")
    np.testing.assert_array_equal(drawn["read_noise"].sel(channel="green 1"), chain.draws[:, :, 1])
    np.testing.assert_array_equal(data["sample_stats"]["lp"].sel(channel="red"), chain.log_density)
    assert drawn["gain"].attrs["units"] == "DN/e-"
    table = arviz.summary(data, kind="stats", round_to="none")
    assert [*table.index] == [f"{p.name}[{c}]" for p in SPACE for c in ("red", "green 1")]
    np.testing.assert_allclose(table["mean"], np.repeat(chain.samples.mean(axis=0), 2))
    single = arviz.from_netcdf(folder / "noise_chains.nc")["posterior"]
    assert single["gain"].dims == ("chain", "draw")


def test_channels_of_unequal_chains_and_parameters_share_a_file(section, tmp_path):
    """The file has the last draws of the longer chain, and NaN for parameters that a channel does
    not have."""
    whole = section.posteriors[""]
    short = replace(
        whole,
        space=SPACE[1:],
        draws=whole.draws[:, :50, 1:],
        log_density=np.zeros((1, 50)),
        seed=3,
    )
    table = {"code": np.arange(3.0), "channel": np.array(["red", "red", "green"])}
    both = Section(
        "brdf", "R", (), posteriors={"red": whole, "green": short}, data={"curve": table}
    )
    write_report(tmp_path, [both], title="T", seed=1, settings={})
    with xarray.open_dataset(tmp_path / "brdf_chains.nc", group="posterior") as found:
        assert found.attrs["seed"].tolist() == [0, 3]
        np.testing.assert_array_equal(
            found["read_noise"].sel(channel="green"), short.draws[:, :, 0]
        )
        np.testing.assert_array_equal(found["gain"].sel(channel="red"), whole.draws[:, -50:, 0])
        assert np.isnan(found["gain"].sel(channel="green")).all()
    with xarray.open_dataset(tmp_path / "brdf_chains.nc", group="curve") as found:
        np.testing.assert_array_equal(found["code"], table["code"])
        assert found["channel"].values.tolist() == ["red", "red", "green"]
    lines = (tmp_path / "curve.csv").read_text().splitlines()
    assert lines == ["code,channel", "0.0,red", "1.0,red", "2.0,green"]


def test_a_calibration_is_printed_by_its_estimates(section):
    text = section_text(section)
    assert text.startswith(section.title)
    for estimate in section.estimates:
        assert estimate.reason in text if estimate.reason else format_value(estimate) in text
    for finding in said_once(section.findings):
        assert finding in text
    assert not any(line.endswith(" ") for line in text.splitlines())
    assert all(vars(kind).get("__repr__") is None for kind in ShownInNotebooks.__subclasses__())


def test_a_model_that_does_not_describe_the_data_has_no_numbers(section):
    """The section begins with one sentence in the terminal, the page and the results."""
    known = replace(section, records={"sensor": lambda path: None})
    told = "Phong does not describe the images: its error is 41 % of the signal."
    found = describing_nothing(known, told, {""})
    text, page = section_text(found), as_html([found], title="Report")
    assert text.startswith(told)
    assert text.count(told) == 1
    assert format_value(section.estimates[0]) not in text
    assert "(1) Not determined: the model does not describe the data" in text
    assert f"<p><b>{told}</b></p>" in page
    assert page.count(told) == 1
    assert json.loads(as_json([found], seed=0, settings={}))["sections"][0]["findings"][0] == told
    assert found.records == {}


def test_a_notebook_prints_nothing_while_it_asks_for_text(section, monkeypatch):
    """Rich would show each table before the cell shows the calibration."""
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr("rich.jupyter.display", lambda *_: pytest.fail("shown"))
    assert section_text(section).startswith(section.title)


@pytest.mark.parametrize("width", [60, 80, 110])
def test_tables_fit_the_terminal_and_no_name_is_cut(width):
    """At 80 columns, a table of eight columns is printed in two parts, each beginning with the
    names."""
    score = ModelScore("torrance-sparrow", "green", 0.02531, 0.02411, 5, 1234.5, 45743.1, 9e4, None)
    section = Section("Reflectance", (), (), tables=(comparison_table([score] * 3, 3),))
    console = Console(file=io.StringIO(), width=width)
    print_section(console, section)
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    parts = len(plain_tables(section.tables[0], width))
    assert parts == {60: 3, 80: 2, 110: 1}[width]
    printed = "\n".join(lines)
    assert "…" not in printed
    assert printed.count("Torrance-Sparrow") == 3 * parts
    assert printed.count("Models compared") == printed.count("Relative RMS over") == 1
    assert printed.count("45740") == 3


def test_a_word_longer_than_the_terminal_is_broken():
    table = Table("Files", ("file", "share"), (("a" * 90, 0.25),))
    console = Console(file=io.StringIO(), width=40)
    console.print(*plain_tables(table, 40))
    assert console.file.getvalue().count("a") == 90 + 1  # and one in the header


def test_a_section_finds_estimates_and_draws_pictures_by_name(section):
    assert section.estimate("gain") is section.estimates[0]
    assert section.estimate("dsnu", method="EMVA 1288").value is None
    with pytest.raises(KeyError, match="likelihood"):
        section.estimate("gain", method="likelihood")
    assert isinstance(section.figure("ptc"), Figure)
    with pytest.raises(InputError, match="'pct' of noise; the nearest is 'ptc'"):
        section.figure("pct")


def test_pictures_print_as_their_names(section):
    """The repr is the name, not the table that the picture draws."""
    assert repr(section.pictures[0]) == "Picture('ptc', 'Photon transfer')"


def test_draws_of_a_posterior_by_name(section):
    found = section.posteriors[""]
    assert [*found.by_name] == ["gain", "read_noise"]
    np.testing.assert_array_equal(found.by_name["read_noise"], found.draws[:, :, 1])


def test_a_long_tail_does_not_flatten_a_corner_plot():
    """An axis ends three quarters of the 95 % interval's width beyond the interval, if draws reach
    that far."""
    rng = np.random.default_rng(0)
    samples = np.stack([rng.normal(2.2, 0.01, 4000), np.exp(2 * rng.standard_normal(4000))], axis=1)
    space = (Parameter("gamma", symbol="γ"), Parameter("shutter_error", symbol="τ"))
    figure = corner_figure({"": SimpleNamespace(space=space, samples=samples)}, {})
    low, high = np.quantile(samples[:, 1], [0.025, 0.975])
    assert figure.axes[-1].get_xlim()[1] == pytest.approx(high + 0.75 * (high - low))
    assert figure.axes[0].get_xlim() == pytest.approx(np.quantile(samples[:, 0], [0.0005, 0.9995]))


def test_a_parameter_with_only_an_upper_bound_is_drawn_in_its_unit():
    """The parameter is drawn in its own unit, although other channels' parameters are in per cent
    of their medians."""
    rng = np.random.default_rng(0)
    space = (Parameter("gamma", symbol="γ"), Parameter("shutter_error", symbol="τ"))
    drawn = (rng.normal(2.2, 0.01, 4000), 1e-4 * np.exp(2 * rng.standard_normal(4000)))
    one = SimpleNamespace(space=space, samples=np.stack(drawn, axis=1))
    figure = corner_figure({"red": one, "green": one}, {})
    assert [axis.get_xlabel() for axis in figure.axes[2:]] == ["Δ$γ$\n[%]", "$τ$"]


def test_a_long_step_without_a_terminal_prints_its_progress(monkeypatch, capsys):
    """Progress is printed at the start, and then once in half a minute."""
    clock = iter([0.0, 1.0, 10.0, 45.0, 50.0, 90.0, 91.0])
    monkeypatch.setattr(progress, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    with progress.reporting() as reporter, reporter.step("fitting") as advance:
        for done in (0, 1, 2, 3, 4):
            advance(done, 5)
    assert capsys.readouterr().err.split("\n")[:4] == [
        "fitting: 0 of 5",
        "fitting: 2 of 5",
        "fitting: 4 of 5",
        "fitting: done",
    ]
