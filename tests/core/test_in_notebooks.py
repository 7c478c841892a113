"""Tests what records show in a notebook: their numbers, escaped, and pictures for records of
pictures."""

import base64
import io
import re
from html import unescape

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest

import fitting
import jaxvision as jv
from fitting.checks.coverage import coverage
from fitting.checks.problem import Check
from fitting.fits.bands import Bands
from fitting.fits.budget import Budget, Share
from fitting.fits.map import FitMap
from fitting.inference.design import Candidate, Plan
from fitting.reflectance import photometric_stereo
from jaxvision.core.in_notebooks import record_html
from jaxvision.files.scenes import read_scene
from jaxvision.transport import Traced

ODD = "<script>&a</script>"  # a name that contains markup
ESCAPED = "&lt;script&gt;&amp;a&lt;/script&gt;"


def cells(record):
    """Return the rows of text in the table of a record, and check that its markup is closed."""
    html = record._repr_html_()
    assert html.count("<tr>") == html.count("</tr>")
    assert html.count("<div") == html.count("</div>")
    rows = re.findall("<tr>(.*?)</tr>", html)
    return [[unescape(c) for c in re.findall("<t[hd][^>]*>(.*?)</t[hd]>", row)] for row in rows]


def picture(record):
    """Return the record's picture, (h, w, 3)."""
    (found,) = re.findall('src="data:image/png;base64,([^"]+)"', record._repr_html_())
    return plt.imread(io.BytesIO(base64.b64decode(found)))[..., :3]


def test_all_text_is_escaped():
    html = record_html([ODD], [[ODD]], title=ODD, summary=ODD, notes=[ODD])
    assert html.count(ESCAPED) == 5
    assert "<script>" not in html


def test_an_estimate_shows_value_unit_and_intervals():
    number = fitting.Estimate(
        "dark_current", "I", "e-/s", 2.5, 0.1, (2.4, 2.6), (2.3, 2.7), method=ODD, group="red"
    )
    assert cells(number) == [
        ["of", "", "by", "value ± s.e.", "unit", "68 %", "95 %"],
        ["red", "dark current", ODD, "2.50 ± 0.10", "e-/s", "[2.40, 2.60]", "[2.30, 2.70]"],
    ]
    assert ESCAPED in number._repr_html_()
    missing = fitting.Estimate("gain", "K", "1", None, reason="no flats")
    assert "Not determined: no flats." in missing._repr_html_()
    assert cells(missing)[1] == ["gain", "–", "", "", ""]


@pytest.mark.parametrize(
    ("record", "row"),
    [
        (
            Plan(ODD, 2.0, 0.12, (Candidate(ODD, 0.01055, 0.993, 2.56),)),
            [ODD, "0.01055", "99.3 %", "2.56"],
        ),
        (Budget(ODD, 2.0, 0.12, (Share(ODD, 0.858, 0.115),)), [ODD, "85.8 %", "± 0.115"]),
    ],
)
def test_plans_and_budgets_show_what_they_print(record, row):
    head, shown = cells(record)
    assert len(head) == len(shown)
    assert shown == row
    html = record._repr_html_()
    assert f"<b>{ESCAPED} = 2.00 ± 0.12" in html
    assert "<script>" not in html
    assert all(cell in str(record) for cell in row)


def test_a_check_shows_coverage_and_what_lies_outside():
    places = np.random.default_rng(0).uniform(size=(200, 2))
    places[:, 1] *= 0.3
    check = Check(coverage(places, ("gain", ODD)), places)
    head, right, wrong = cells(check)
    assert head[:5] == ["parameter", "fits", "50 %", "68 %", "95 %"]
    assert right[:2] == ["gain", "200"]
    for row, one in ((right, check.coverage[0]), (wrong, check.coverage[1])):
        assert row[2:5] == [f"{share:.3f}" for share in one.covered]
    assert check.faults
    assert f"<li>{ESCAPED}: " in check._repr_html_()


def a_map(shape):
    value, sd = np.linspace(1, 2, 12).reshape(shape), np.full(shape, 0.1)
    ends = np.stack([value - sd, value + sd])
    numbers = [{"height": x} for x in (value, sd, ends, ends)]
    return FitMap(
        *numbers,
        chi_square=np.ones(shape),
        dof=np.ones(shape),
        state=np.zeros(shape, np.uint8),
        units={"height": "m^2"},
        findings=(ODD,),
    )


@pytest.mark.slow
def test_a_map_shows_its_numbers_and_maps():
    shown = a_map((3, 4))
    assert cells(shown)[1] == ["height", "1.5", "[1.05, 1.95]", "0.1", "m²"]
    assert f"<li>{ESCAPED}</li>" in shown._repr_html_()
    assert "12 converged" in shown._repr_html_()
    assert np.ptp(picture(shown)) > 0.5
    assert "<img" not in a_map((12,))._repr_html_()


def test_stereo_shows_normals_and_albedo():
    lights = np.array([[0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, 0.8], [0, -0.6, 0.8]])
    plane = np.full((4, 5, 3), [0.0, 0.0, 1.0]) * np.linspace(50, 100, 5)[:, None]
    found = photometric_stereo(np.einsum("lk,hwk->lhw", lights, plane), lights)
    assert "Normals and albedo at 20 of 20 pixels" in found._repr_html_()
    assert cells(found)[1] == ["albedo", "75", "[50, 100]", "readings / irradiance"]
    assert "albedo: median 75, 90 % of pixels in [50, 100] readings / irradiance" in str(found)
    seen = picture(found)
    blue = (np.abs(seen - [0.5, 0.5, 1.0]) < 0.02).all(axis=-1)  # the surface that faces the camera
    assert blue.sum() > 1000
    dark = photometric_stereo(np.zeros((4, 4, 5)), lights)
    assert "at 0 of 20 pixels" in dark._repr_html_()
    assert "<img" not in dark._repr_html_()


def test_a_traced_image_shows_its_picture():
    light = jnp.asarray(np.random.default_rng(0).uniform(0, 1, (30, 20, 3)), jnp.float32)
    traced = Traced(light, 0 * light)
    assert [row[0] for row in cells(traced)[1:]] == ["radiance", "error"]
    white = np.quantile(light, 0.99)
    expected = jv.srgb_encode(jnp.clip(light / white, 0, 1))
    np.testing.assert_allclose(picture(traced), expected, atol=0.003)
    bands = Traced(jnp.ones((1, 6, 8, 5)), jnp.zeros((1, 6, 8, 5)))
    assert picture(bands).shape == (6, 8, 3)
    assert picture(Traced(light * jnp.nan, light)).max() == 0
    assert "<img" not in Traced(light[0, 0], light[0, 0])._repr_html_()
    shown = []
    jax.eval_shape(lambda x: shown.append(Traced(x, x)._repr_html_()), light)
    assert "<img" not in shown[0]


def test_a_scene_file_shows_what_is_in_it():
    html = read_scene("cornell_box")._repr_html_()
    assert "cornell_box.toml: 15 surfaces, 1 light, 3 bands" in html
    assert "<td>surface &quot;floor&quot;</td><td>Quad</td><td>Lambert</td>" in html


def test_bands_print_a_number_with_its_error_and_how_many_spread():
    draws = np.linspace(1.0, 2.0, 101)
    one = Bands(draws.mean(), draws.std(), np.array([1.16, 1.84]), np.array([1.025, 1.975]), draws)
    assert str(one) == "1.50 ± 0.29, 95 % in [1.025, 1.975]"
    grid = np.linspace(0, 1, 101)
    many = Bands(grid, grid / 10, np.stack([grid, grid]), np.stack([grid, grid]), grid[None])
    assert many._repr_html_() == (
        "<p>Bands of 101 numbers: 90 % of the means in [0.05, 0.95], of the s.d. in "
        "[0.005, 0.095]</p>"
    )
    none = Bands(*np.full((2, 5), np.nan), *np.full((2, 2, 5), np.nan), np.full((3, 5), np.nan))
    assert str(none) == "Bands of 5 numbers, none of them finite"
