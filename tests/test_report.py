"""What a reader gets: rounding by uncertainty, JSON that parses, HTML that stands alone, NetCDF
that ArviZ opens."""

import json
import warnings
from dataclasses import replace
from html.parser import HTMLParser

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure

from fitting.inference.emcee_run import SamplingOptions
from fitting.inference.estimates import (
    Estimate,
    find,
    gaussian_estimate,
    not_determined,
    sampled_estimate,
)
from fitting.inference.parameters import Parameter
from fitting.inference.posterior import laplace, sample
from fitting.report.formatting import format_interval, format_number, format_value
from fitting.report.page import as_html, as_json, write_report
from fitting.report.section import Picture, Section, Table

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


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (0.2807692, 0.00042, "0.28077 ± 0.00042"),
        (30957.123, 321.7, "30960 ± 320"),
        (1.0, 0.0996, "1.000 ± 0.100"),
        (-2.5e-9, 1.2e-10, "-2.50e-09 ± 1.2e-10"),
        (5.0, 0.0, "5 ± 0"),
        (5.0, float("nan"), "5 ± nan"),
    ],
)
def test_values_are_rounded_to_their_uncertainty(value, error, expected):
    assert format_value(Estimate("x", "x", "1", value, error)) == expected


def test_ends_of_an_interval_have_the_digits_of_the_error():
    estimate = gaussian_estimate(X, 2.0, 0.06)
    assert format_interval(estimate, 68) == "[1.940, 2.060]"
    assert format_interval(estimate, 95) == "[1.882, 2.118]"


def test_numbers_without_uncertainty_and_missing_ones():
    assert format_value(Estimate("x", "x", "1", 1 / 3)) == "0.333333"
    assert format_value(not_determined(X, "why")) == "–"
    assert format_interval(not_determined(X, "why"), 68) == ""
    assert format_number(0.0, 9) == "0.000000000e+00"


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


def test_the_page_stands_alone_and_escapes(section):
    page = Links()
    page.feed(as_html([section], title="A & B"))
    assert page.sources
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    for words in ("0.28077 ± 0.00042", "no <spatial> statistics", "linear & says so", "0.1235"):
        assert words in page.text


def test_files_of_a_report_and_chains_that_arviz_opens(section, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # its notice of a coming release
        import arviz

    args = jnp.asarray(0.01)
    options = SamplingOptions(walkers=16, block=300)
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
    """The last draws of the longer one, and NaN for what a channel does not have."""
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
