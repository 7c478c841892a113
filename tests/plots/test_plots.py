"""Tests that plots of results show the numbers that they are given."""

import dataclasses
import re
from itertools import combinations, pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxvision as jv
from jaxvision import plots
from jaxvision.accuracy import Curve, Knob, Trial, plot
from jaxvision.accuracy.records import Order, Reference
from jaxvision.errors import InputError
from jaxvision.plots.inline import figure_strips, figure_svg

RNG = np.random.default_rng(4)
GRID = np.linspace(400e-9, 700e-9, 7)


def test_a_picture_shows_its_codes_and_marks_undefined_pixels():
    codes = RNG.integers(0, 256, (5, 4, 3), dtype=np.uint8)
    shown = plots.picture(codes).images[0].get_array()
    np.testing.assert_allclose(shown, codes / 255, rtol=1e-6)
    radiance = np.array([[0.0, 1.0], [np.nan, 4.0]])
    shown = np.asarray(plots.picture(radiance).images[0].get_array())
    np.testing.assert_allclose(shown[1, 0], (1, 0, 1))
    assert shown[1, 1, 0] == 1


def test_false_colour_has_a_scale_in_its_unit():
    depth = np.array([[0.1, 1.0], [np.nan, 10.0]])
    axes = plots.false_colour(depth, unit="m", label="depth", logarithmic=True)
    image = axes.images[0]
    assert image.colorbar.ax.get_ylabel() == "depth [m]"
    np.testing.assert_allclose(image.norm(depth[0]), [0, 0.5], atol=1e-12)
    assert image.cmap.get_bad().tolist() == [1, 0, 1, 1]
    flat = plots.false_colour(np.full((2, 2), 3.0))  # a single value has a colour, too
    assert np.isfinite(flat.images[0].norm(3.0))


def test_a_logarithmic_histogram_names_omitted_values():
    values = np.geomspace(1e-3, 1e3, 400, dtype=np.float32).reshape(20, 20)
    assert "below" not in plots.histogram(values).get_xlabel()
    values[0, :3] = 0, -1, np.nan
    axes = plots.histogram(values)
    said = "\n2 values at or below 0 not drawn\n1 value not finite and not drawn"
    assert axes.get_xlabel().endswith(said)
    assert axes.patches[0].get_data().values.sum() == 397


def test_points_without_a_logarithm_are_counted():
    x = np.arange(3.0)
    y = {"a": x, "b": np.array([1.0, -1.0, 2.0])}
    assert plots.curves(x, y, scales=("linear", "log")).get_xlabel() == (
        "\n2 points at or below 0 not drawn"
    )
    assert plots.curves(x, y).get_xlabel() == ""


def test_pictures_without_numbers_have_a_scale():
    dark = np.array([[np.nan, 0.25], [np.inf, 0.5]])
    figure = plots.pictures({"dark": dark, "none": np.full((2, 2), np.nan)}, limits=None)
    shown = [image.get_clim() for axes in figure.axes for image in axes.images]
    assert shown[:2] == [(0, 0.5), (0, 1)]


def test_a_band_that_a_material_lacks_is_refused():
    coloured = {"grey": jv.Lambert([0.3]), "red": jv.Lambert([0.3, 0.1, 0.1])}
    assert plots.lobe(coloured, band=2).lines
    for materials, band in ((coloured, 3), (jv.Lambert([0.3]), 1), (coloured, -1)):
        with pytest.raises(InputError, match=f"band {band} is outside those"):
            plots.lobe(materials, band=band)


def test_a_histogram_counts_what_numpy_counts():
    codes = RNG.integers(0, 256, (40, 50), dtype=np.uint8)
    steps = plots.histogram(codes).patches[0].get_data()
    np.testing.assert_array_equal(steps.values, np.histogram(codes, np.arange(257))[0])


@pytest.mark.parametrize(
    ("values", "names"),
    [
        (GRID * 1e9, []),
        (RNG.uniform(size=(7, 3)), ["red", "green", "blue"]),
        ({"lamp": GRID, "sky": 2 * GRID}, ["lamp", "sky"]),
    ],
)
def test_spectra_are_over_nanometres(values, names):
    axes = plots.spectrum(GRID, values, unit="1", label="power")
    wanted = values.values() if isinstance(values, dict) else values.reshape(7, -1).T
    for line, one in zip(axes.lines, wanted, strict=True):
        np.testing.assert_allclose(line.get_xdata(), [400, 450, 500, 550, 600, 650, 700])
        np.testing.assert_array_equal(line.get_ydata(), one)
    legend = axes.get_legend()
    assert names == ([] if legend is None else [text.get_text() for text in legend.get_texts()])


def test_a_lobe_peaks_at_the_mirror_direction():
    """Phong's value there is k_s (n + 2) / (2 pi)."""
    shiny = jv.NormalisedPhong([0.0, 0.0], [0.5, 0.25], 40.0)
    axes = plots.lobe({"shiny": shiny}, incidence=np.radians(45), band=1)
    angle, radius = axes.lines[0].get_data()
    assert np.degrees(angle[radius.argmax()]) == pytest.approx(45, abs=0.6)
    expected = 0.25 * 42 / (2 * np.pi) * np.maximum(np.cos(angle - np.pi / 4), 0) ** 40
    np.testing.assert_allclose(radius, expected, atol=1e-5)
    assert [text.get_text() for text in axes.texts] == ["$f_r$ [sr$^{-1}$]"]
    relative = plots.lobe(shiny, shape_only=True).lines[0].get_ydata()
    assert relative.max() == 1


def test_the_components_of_a_lobe_sum_to_it():
    """By the closed form k_d + k_s cos^n, each term alone and the sum are drawn."""
    materials = {"paint": jv.PhongBRDF([0.2], [0.5], 20.0), "chalk": jv.Lambert([0.3])}
    axes = plots.lobe(materials, incidence=0.6, components=True)
    lines = {line.get_label(): line.get_data() for line in axes.lines[:-1]}
    assert list(lines) == ["paint", "chalk", "paint, diffuse", "paint, specular"]
    terms = {"diffuse": 0.2, "specular": lambda x: 0.5 * np.maximum(np.cos(x - 0.6), 0) ** 20}
    np.testing.assert_allclose(lines["paint, diffuse"][1], terms["diffuse"], rtol=1e-5)
    angle, radius = lines["paint, specular"]
    np.testing.assert_allclose(radius, terms["specular"](angle), atol=1e-5)
    angle, radius = lines["paint"]
    np.testing.assert_allclose(radius, terms["diffuse"] + terms["specular"](angle), atol=1e-5)
    assert axes.get_legend() is not None


def test_a_lobe_on_cartesian_axes_is_over_degrees():
    """The curve is the closed form, and the sum has an entry in the legend."""
    axes = plots.lobe(
        jv.PhongBRDF([0.2], [0.5], 20.0), incidence=0.6, components=True, axes=Figure().gca()
    )
    angle, sums = axes.lines[0].get_data()
    expected = 0.2 + 0.5 * np.maximum(np.cos(np.radians(angle) - 0.6), 0) ** 20
    np.testing.assert_allclose(sums, expected, atol=1e-5)
    assert axes.lines[-1].get_xdata()[0] == pytest.approx(-np.degrees(0.6))
    assert axes.get_xlabel() == "angle from the normal [degrees]"
    names = [text.get_text() for text in axes.get_legend().get_texts()]
    assert names == ["sum", "diffuse", "specular"]


def test_a_lobe_of_any_width_shows_its_height():
    """cos^n is 1 in the mirror direction, and lines between points are within 1 %."""
    shiny = {f"{n:g}": jv.PhongBRDF([0.0], [1.0], n) for n in (1e2, 1e3, 1e4, 1e5, 1e6)}
    axes = plots.lobe(shiny, incidence=np.pi / 6)
    for n, line in zip(map(float, shiny), axes.lines, strict=False):
        angle, radius = line.get_data()
        assert radius.max() == pytest.approx(1, abs=1e-6)
        middle = (angle[1:] + angle[:-1]) / 2
        expected = np.maximum(np.cos(middle - np.pi / 6), 0) ** n
        np.testing.assert_allclose((radius[1:] + radius[:-1]) / 2, expected, atol=0.01)
    retro = np.exp(-((np.linspace(0, 1.5, 151)[:, None] - np.linspace(0, 1.5, 151)) ** 2) / 1e-5)
    values = np.stack([retro, 0 * retro], axis=-1)[..., None]  # towards the light, and away
    card = jv.IsotropicTable(np.linspace(0, 1.5, 151), np.linspace(0, 1.5, 151), [0, np.pi], values)
    line = plots.lobe(card, incidence=0.5).lines[0]
    assert line.get_ydata().max() == pytest.approx(1, abs=1e-3)
    assert line.get_xdata()[line.get_ydata().argmax()] == pytest.approx(-0.5, abs=1e-3)


def test_a_curve_has_its_band_and_its_truth():
    x = np.linspace(0, 1, 4)
    axes = plots.curve(x, x, band=(x - 1, x + 2), truth=2 * x, names=("code", "light"))
    found, true = axes.lines
    np.testing.assert_array_equal(found.get_ydata(), x)
    np.testing.assert_array_equal(true.get_ydata(), 2 * x)
    extent = axes.collections[0].get_paths()[0].get_extents()
    assert (extent.y0, extent.y1) == (-1, 3)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("code", "light")


def test_curves_show_what_they_are_given():
    y = {"theory": 2 * GRID, "measured": 3 * GRID}
    axes = plots.curves(GRID, y, dots=["measured"], dashed=["theory"], scales=("log", "linear"))
    for line, one in zip(axes.lines, y.values(), strict=True):
        np.testing.assert_array_equal(line.get_xydata(), np.stack([GRID, one], axis=-1))
    assert [line.get_linestyle() for line in axes.lines] == ["--", "None"]
    assert axes.get_xscale() == "log"
    longer = plots.curves({"a": np.arange(4)}, {"a": np.arange(4) ** 2})
    np.testing.assert_array_equal(longer.lines[0].get_xdata(), np.arange(4))


def test_pictures_share_one_scale():
    grey, colour = RNG.uniform(size=(4, 6)), RNG.uniform(0, 4, size=(4, 6, 3))
    figure = plots.pictures({"grey": grey, "colour": colour}, limits=(0, 2))
    assert [axes.get_title() for axes in figure.axes] == ["grey", "colour"]
    first, second = (axes.images[0] for axes in figure.axes)
    np.testing.assert_allclose(first.norm(grey), grey / 2)
    np.testing.assert_allclose(second.get_array(), np.minimum(colour / 2, 1))
    own = plots.pictures({"a": 5 * grey, "b": grey, "c": grey}, columns=2, limits=None, unit="m")
    assert len(own.axes) == 6  # each with its own scale
    assert own.axes[0].images[0].get_clim() == (0, 5 * grey.max())


def trial(setting, seconds, error):
    return Trial(setting, error, error, error, seconds, seconds, seconds, seconds)


def test_the_line_of_settings_omits_dominated_ones():
    trials = [
        trial("fast", 1, 0.1),
        trial("beaten", 2, 0.2),
        trial("good", 4, 0.01),
        trial("exact", 9, 0.0),
    ]
    axes = plots.error_against_time(trials)
    points, line = axes.lines
    np.testing.assert_array_equal(points.get_xdata(), [1, 2, 4])
    np.testing.assert_array_equal(line.get_xdata(), [1, 4])
    assert [text.get_text() for text in axes.texts] == ["fast", "beaten", "good"]


@pytest.mark.parametrize(
    "seconds", [(1.5e-4, 1.7e-4, 2e-4, 2.1e-4), (0.22, 0.24, 0.26, 0.28), (1e-3, 1e-2, 0.1, 9.0)]
)
def test_numbers_and_names_of_a_curve_do_not_overlap(seconds):
    """The reference is the boxes in which matplotlib draws them."""
    trials = [trial(10.0**-i, s, 0.3 / 20**i) for i, s in enumerate(seconds)]
    knob = Knob("tolerance", "", "", tuple(t.setting for t in trials), ())
    floor = Reference(None, 0.0, "closed form")
    wide = Order(-7.86, -14.35, -1.37, "power", 4)
    figure = Figure(figsize=(3.6, 2.8), layout="constrained")
    axes = plot(Curve("", knob, tuple(trials), floor, wide, ()), axes=figure.add_subplot())
    assert axes.get_title() == "tolerance\norder unknown"
    figure.draw_without_rendering()
    for axis in (axes.xaxis, axes.yaxis):
        assert 2 <= len(axis.get_ticklabels()) <= 4
        boxes = [label.get_window_extent() for label in axis.get_ticklabels()]
        assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    boxes = [text.get_window_extent() for text in axes.texts]
    assert len(boxes) == 4
    assert not any(
        a.overlaps(b) for a, b in combinations([*boxes, axes.title.get_window_extent()], 2)
    )
    assert max(box.y1 for box in boxes[:-1]) <= axes.bbox.y1 + 1


def test_settings_of_several_methods_have_a_line_each():
    trials = [trial(("ours", 4), 1, 0.1), trial(("peer", 4), 2, 0.2), trial(("ours", 8), 3, 0.01)]
    ours, peer = plots.error_against_time(trials).lines
    np.testing.assert_array_equal(ours.get_xydata(), [(1, 0.1), (3, 0.01)])
    np.testing.assert_array_equal(peer.get_xydata(), [(2, 0.2)])
    assert [ours.get_label(), peer.get_label()] == ["ours", "peer"]


def test_a_corner_shows_truths_where_they_are():
    draws = {"gain": RNG.normal(2, 0.1, 800), "place": RNG.normal([1, 5], 0.2, (8, 100, 2))}
    figure = plots.corner(draws, truth={"place": [1.0, 5.0]})
    assert len(figure.axes) == 9
    labels = [axes.get_xlabel() for axes in figure.axes[6:]]
    assert labels == ["gain", "place[0]", "place[1]"]
    diagonal = figure.axes[8]
    assert [line.get_xdata()[0] for line in diagonal.lines][-1] == 5.0


def test_a_trace_has_a_row_a_number_and_a_path_a_chain():
    draws = {"gain": RNG.normal(2, 0.1, 50), "place": RNG.normal(0, 1, (20, 50, 2))}
    rows = plots.trace(draws).axes
    assert [axes.get_ylabel() for axes in rows] == ["gain", "place[0]", "place[1]"]
    assert [len(axes.lines) for axes in rows] == [1, 8, 8]
    np.testing.assert_array_equal(rows[2].lines[3].get_ydata(), draws["place"][3, :, 1])


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda: plots.false_colour(np.ones((2, 2, 3))), "one quantity"),
        (lambda: plots.false_colour(np.full((2, 2), np.nan)), "finite value"),
        (lambda: plots.false_colour(np.ones((2, 2)), limits=(2, 1)), "lower one first"),
        (lambda: plots.pictures({}), "one column"),
        (lambda: plots.pictures({"two": np.ones((2, 2, 2))}), "of three"),
        (lambda: plots.curves(GRID, {"short": np.ones(3)}), "'short'"),
        (lambda: plots.curves(GRID, {"a": GRID}, dots=["b"]), "'b'"),
        (lambda: plots.spectrum(GRID, np.ones(3)), "wavelengths"),
        (lambda: plots.lobe(jv.Lambert([0.1]), incidence=2.0), "pi / 2"),
        (lambda: plots.lobe({"chrome": jv.Mirror([0.9])}), "chrome reflects into one direction"),
        (lambda: plots.curve(GRID, np.ones(3)), "one length"),
        (lambda: plots.error_against_time([trial("exact", 1, 0.0)]), "no trial"),
        (lambda: plots.corner({}), "at least one"),
        (lambda: plots.corner({"a": np.ones(9)}), "all the same"),
        (lambda: plots.trace({}), "at least one"),
        (lambda: plots.corner({"a": RNG.normal(size=9)}, truth={"b": 1.0}), "'b'"),
    ],
)
def test_impossible_plots_are_refused(draw, words):
    with pytest.raises(InputError, match=words):
        draw()


def panels(columns, width):
    figure = Figure(figsize=(width, 2), layout="constrained")
    for i, axes in enumerate(figure.subplots(2, columns).flat):
        axes.set(xlabel=f"x {i}", ylabel=f"y {i}")
    return figure


def sizes(strips):
    found = (re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg) for svg in strips)
    return np.array([[float(number) for number in one.groups()] for one in found])


@pytest.mark.parametrize(
    ("widest", "columns"),
    [
        (300, [2, 2]),
        *(pytest.param(*x, marks=pytest.mark.slow) for x in [(600, [4]), (200, [1] * 4)]),
    ],
)
def test_a_wide_figure_is_cut_between_its_columns(widest, columns):
    strips = figure_strips(lambda: panels(4, 8), widest=widest)
    kept = [sorted(map(int, re.findall(r">x (\d)<", svg))) for svg in strips]
    ends = np.cumsum([0, *columns])
    expected = [[*range(a, b), *range(4 + a, 4 + b)] for a, b in pairwise(ends)]
    assert kept == expected
    width, height = sizes(strips).T
    np.testing.assert_allclose(width.sum(), 8 * 72, rtol=1e-4)  # together they are the whole figure
    np.testing.assert_allclose(height, 2 * 72, rtol=1e-4)
    assert np.ptp(width) < 0.2 * width.mean()
    if len(columns) == 1:
        assert strips == (figure_svg(lambda: panels(4, 8)),)


def test_a_figure_with_its_own_text_is_not_divided():
    figure = panels(4, 8)
    figure.suptitle("of all")
    assert len(figure_strips(lambda: figure, widest=200)) == 1
    assert len(figure_strips(lambda: panels(1, 8), widest=200)) == 1  # a single column


def test_the_pipeline_of_a_camera_shows_absent_stages_in_grey():
    camera = jv.read_camera("cmos")
    axes = plots.pipeline(camera)
    colours = {text.get_text(): text.get_color() for text in axes.texts}
    for field in dataclasses.fields(camera.sensor):
        is_grey = colours[field.name.replace("_", " ")] == "0.75"
        value = getattr(camera.sensor, field.name)
        assert is_grey == (value is None or (field.name == "own" and not value)), field.name
    assert {"lens", "sensor", "f number"} <= colours.keys()
    alone = {text.get_text(): text.get_color() for text in plots.pipeline(camera.sensor).texts}
    assert alone.items() <= colours.items()
    assert "lens" not in alone
    with pytest.raises(jv.InputError, match="shows a Camera or a Sensor, got Lambert"):
        plots.pipeline(jv.Lambert([0.1]))
