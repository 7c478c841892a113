"""Tests of several knobs together, of their tables and pages, on a problem with known errors, and
of the commands on a scene of a few pixels."""

import json
import re
from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest
from clocks import Clock
from commands import called
from scene_texts import BALL

from jaxvision.accuracy import Knob, Problem, combined, curve, page, plot
from jaxvision.accuracy.scene_settings import Chosen
from jaxvision.accuracy.scenes import base_of, entry_of, knobs_of, scene_problem
from jaxvision.accuracy.several import Together, all_together, check_combination, combine_and_check
from jaxvision.accuracy.tables import choice_in_words, json_sheet, notes, rows
from jaxvision.cli import app
from jaxvision.errors import InputError
from jaxvision.files.scenes import read_scene

SIZE = 400
DRAWS = Knob("n", "draws", "", (4, 16, 64, 256), (1024, 4096), -0.5, random=True, whole=True)
DEPTH = Knob("d", "pieces", "", (2, 3, 4, 6, 8), (16, 24), law="geometric", whole=True)


def means(clock, first=0):
    """Return means of n draws with a random error of 1 / sqrt(n) and a bias of 2^-d, at a cost of n
    d."""

    def prepare(settings):
        n, d = settings["n"], settings["d"]

        def compute(seed):
            clock.now += 1e-4 * n * d
            noise = np.random.default_rng((first + seed, n)).standard_normal(SIZE)
            return (1 - 2.0**-d) + n**-0.5 * noise

        return compute

    return Problem("means", prepare, settings={"n": 16, "d": 4}, level=1.0)


def measured(first=0):
    clock = Clock()
    problem = means(clock, first)
    return problem, [curve(problem, knob, clock=clock, metrics=("rms",)) for knob in (DRAWS, DEPTH)]


def test_a_combination_is_the_cheapest_by_its_own_law():
    """Its cost is within 1.6 times the least n d with 4^-d + 1 / n <= tolerance^2, because settings
    are far apart."""
    problem, curves = measured()
    best = combined(curves, problem.settings, tolerance=0.05)
    least = min(n * d for d in DEPTH.settings for n in range(4, 4000) if 4.0**-d + 1 / n <= 0.05**2)
    assert best.settings["n"] * best.settings["d"] <= 1.6 * least
    np.testing.assert_allclose(
        best.seconds, 1e-4 * best.settings["n"] * best.settings["d"], rtol=0.1
    )


def test_the_most_accurate_combination_in_a_time():
    problem, curves = measured()
    best = combined(curves, problem.settings, seconds=0.1)
    assert 1e-4 * best.settings["n"] * best.settings["d"] <= 0.11
    assert best.error < 0.12
    with pytest.raises(InputError, match=r"No settings reach 1e-09 s"):
        combined(curves, problem.settings, seconds=1e-9)
    with pytest.raises(InputError, match=r"the nearest are known to be within"):
        combined(curves, problem.settings, tolerance=1e-6)


def test_the_check_finds_the_error_of_a_combination():
    problem, curves = measured()
    best = combined(curves, problem.settings, tolerance=0.05)
    error, _ = check_combination(problem, curves, best, seconds=1e9)
    truth = np.hypot(2.0 ** -best.settings["d"], best.settings["n"] ** -0.5)
    assert truth < error < 1.3 * truth
    assert check_combination(problem, curves, best, seconds=1e-6) is None


def without_time_for(name):
    """Return curves where one knob has time only for the setting that is already compiled."""
    clock = Clock()
    plain = means(clock)

    def slow(settings):
        clock.now += 0.0 if known(settings) else 20.0
        return plain.prepare(settings)

    def known(settings):
        return settings[name] == plain.settings[name]

    problem = replace(plain, prepare=slow, compiled=known, compiling=20.0)
    shares = {knob: 5.0 if knob.name == name else 60.0 for knob in (DRAWS, DEPTH)}
    return problem, [curve(problem, k, seconds=s, clock=clock) for k, s in shares.items()]


def test_a_bias_without_time_keeps_its_setting_and_is_named():
    problem, curves = without_time_for("d")
    assert [trial.setting for trial in curves[1].trials] == [4]
    assert curves[1].taken <= 5.0
    best = combined(curves, problem.settings, tolerance=0.2)
    assert (best.settings["d"], best.unknown) == (4, ("d",))
    fresh = problem.prepare(best.settings)(10**7)
    assert np.sqrt(np.mean((fresh - (1 - 2.0**-4)) ** 2)) <= 0.2
    assert "d 4 (not known)" in rows(problem, curves)[-1][2]
    check = check_combination(problem, curves, best, seconds=1e9)
    assert check is not None
    assert check.error < 1.3 * best.settings["n"] ** -0.5
    chosen = Chosen(None, None, 0.2, 1.0, False, best.settings, best.unknown)
    assert "too short to measure d, left as in the scene" in choice_in_words(chosen)
    with pytest.raises(InputError, match="no error of knob 'd' is known; allow more time"):
        combined(curves[1:], problem.settings, tolerance=0.2)


def test_without_a_random_error_nothing_is_chosen():
    problem, curves = measured()
    trials = tuple(replace(trial, error_high=np.inf, hollow=True) for trial in curves[0].trials)
    with pytest.raises(InputError, match="no error of knob 'n' is known; allow more time"):
        combined([replace(curves[0], trials=trials, order=None), curves[1]], problem.settings,
                 tolerance=0.5)  # fmt: skip


@pytest.mark.parametrize(("beyond", "met"), [(0.0, True), (0.06, True), (5.0, False)])
def test_a_combination_that_fails_its_check_is_tightened_or_refused(beyond, met):
    """Only the seeds of the check have this error."""
    problem, curves = measured()

    def prepare(settings):
        honest = problem.prepare(settings)
        checks = range(500_000, 1_000_000)
        return lambda seed: honest(seed) + beyond * (seed in checks)

    planted = replace(problem, prepare=prepare)
    if not met:
        with pytest.raises(InputError, match=r"fresh runs of the last ones are off by"):
            combine_and_check(planted, curves, 0.1, None, seconds=1e9)
        return
    best, confirmed = combine_and_check(planted, curves, 0.1, None, seconds=1e9)
    assert confirmed
    assert np.hypot(2.0 ** -best.settings["d"] - beyond, best.settings["n"] ** -0.5) < best.error
    assert best.error <= 0.1


def test_the_table_says_settings_times_and_what_was_not_reached():
    problem, curves = measured()
    head, first, second, together = rows(problem, curves)
    assert head == ("knob", "order (fitted)", "10 %", "1 %", "0.1 %")
    assert first[0] == "n"
    assert first[1].startswith("-0.5")
    assert "(inferred)" in first[3]
    assert second[2].startswith("4 ")
    assert second[3].startswith("8 ")
    assert second[4].startswith("not reached: at best ")
    assert second[4].endswith(" %")
    assert together[0] == "all together"
    assert "n " in together[2]
    assert any("twice as fine" in note for note in notes(curves))
    sheet = json.loads(json.dumps(json_sheet(problem, curves), allow_nan=False))
    assert [knob["name"] for knob in sheet["knobs"]] == ["n", "d"]
    assert sheet["within"]["0.1 %"] is None


def beside_the_curves():
    """Return a problem whose joint error is 30 % larger than its curves predict."""
    problem, curves = measured()

    def prepare(settings):
        honest = problem.prepare(settings)
        d, n = settings["d"], settings["n"]
        return lambda seed: honest(seed) - 0.3 * np.hypot(2.0**-d, n**-0.5)

    return replace(problem, prepare=prepare), curves


def test_the_settings_of_all_knobs_together_are_run_as_one():
    problem, curves = beside_the_curves()
    found = all_together(problem, curves, seconds=1e9)
    assert [one.checked for one in found] == [True, True, False]
    assert found[2] == Together(None)
    for one, tolerance in zip(found, (0.1, 0.01), strict=False):
        assert one.combination is not None
        compute = problem.prepare({**problem.settings, **one.combination.settings})
        errors = [np.sqrt(np.mean((compute(10**7 + n) - 1) ** 2)) for n in range(40)]
        assert np.mean(np.array(errors) <= tolerance) >= 0.95
        assert one.combination.error <= tolerance
    assert "(not checked)" not in " ".join(rows(problem, curves, together=found)[-1])
    assert any("run with fresh seeds" in note for note in notes(curves, together=found))


@pytest.mark.parametrize("seconds", [0.0, 1e-6])
def test_settings_of_all_knobs_that_time_leaves_unchecked_say_so(seconds):
    problem, curves = beside_the_curves()
    found = all_together(problem, curves, seconds=seconds)
    assert not any(one.checked for one in found)
    cells = rows(problem, curves, together=found)[-1]
    assert cells[2].endswith("s (not checked)")
    sheet = json_sheet(problem, curves, together=found)
    assert sheet["within"]["10 %"]["checked"] is False
    assert sheet["within"]["0.1 %"] is None
    assert "for lack of time, unchecked" in sheet["notes"][-1]
    assert "(not checked)" in page(problem, curves, command="", together=found)


def test_an_interrupt_ends_the_checks_and_keeps_what_they_found():
    problem, curves = measured()

    def prepare(settings):
        if settings["n"] > 5000:  # the settings for 1 %
            raise KeyboardInterrupt
        return problem.prepare(settings)

    found = all_together(replace(problem, prepare=prepare), curves, seconds=np.inf)
    assert [one.checked for one in found] == [True, False, False]
    assert [one.combination is None for one in found] == [False, False, True]


def test_settings_that_were_checked_for_a_narrower_tolerance_are_not_run_again():
    """The error is a bias only, which is small even at the coarsest setting."""
    clock, runs = Clock(), []

    def prepare(settings):
        def compute(seed):
            runs.append(settings)
            clock.now += 1e-3 * settings["d"] * settings["e"]
            return np.ones(9) * (1 + 1e-5 * 2.0 ** -settings["d"] + 1e-5 * 2.0 ** -settings["e"])

        return compute

    problem = Problem("near", prepare, settings={"d": 2, "e": 2})
    curves = [curve(problem, replace(DEPTH, name=n), clock=clock, seconds=1e9) for n in "de"]
    runs.clear()
    first, *others = all_together(problem, curves, seconds=1e9)
    assert first.checked
    assert others == [first, first]
    assert len(runs) == 4  # one run of a reference, and three with fresh seeds


def test_the_page_is_self_contained_and_follows_the_readers_theme():
    """The page loads nothing from elsewhere, plots use the colour of the text, and every setting
    has a label."""
    problem, curves = measured()
    html = page(problem, curves, command="repeat <me>")
    assert html.count("<svg") == 3
    assert not re.findall(r'(?:src|href)="https?:', html)
    assert "currentColor" in html
    assert "prefers-color-scheme: dark" in html
    assert "repeat &lt;me&gt;" in html
    told = replace(curves[0], knob=replace(curves[0].knob, about="draws by NUTS"))
    assert "Draws by NUTS." in page(problem, [told], command="")
    axes = plot(curves[0])
    assert {label.get_text() for label in axes.texts} == {"4", "16", "64", "256"}
    hollow = replace(curves[0].trials[0], hollow=True)
    faces = plot(replace(curves[0], trials=(hollow,), pareto=(0,))).lines[0]
    assert faces.get_markerfacecolor() == "none"


def test_a_setting_that_equals_the_reference_stands_on_the_lower_axis():
    """It is drawn within the axis of times, next to other programs, although it is the slowest."""
    _, curves = measured()
    first, last = curves[0].trials[0], curves[0].trials[-1]
    exact = replace(last, setting="all", error=0.0, seconds=9 * last.seconds)
    axes = plot(
        replace(curves[0], trials=(first, exact), pareto=(0,)), others=[("peer", 1e-3, 1e-9)]
    )
    assert {label.get_text() for label in axes.texts} == {str(first.setting), "all: 0", "peer"}
    (mark,) = [line for line in axes.lines if line.get_xdata()[0] == exact.seconds]
    assert mark.get_ydata()[0] == axes.get_ylim()[0] < 1e-7
    assert axes.get_xlim()[1] > exact.seconds


def test_an_axis_of_one_point_has_labels_that_differ():
    _, curves = measured()
    one = replace(curves[1].trials[0], seconds=0.0321, seconds_low=0.032, seconds_high=0.0322,
                  error=4.086e-7, error_low=4.0859e-7, error_high=4.0861e-7)  # fmt: skip
    axes = plot(replace(curves[1], trials=(one,), pareto=(0,), reference=replace(
        curves[1].reference, error=0.0)))  # fmt: skip
    axes.figure.draw_without_rendering()
    for axis in (axes.xaxis, axes.yaxis):
        labels = [label.get_text() for label in axis.get_ticklabels(which="both")]
        shown = [label for label in labels if label]
        assert len(shown) > 1
        assert len(set(shown)) == len(shown)


@pytest.mark.parametrize(("seconds", "unit"), [(0.02, "ms"), (20.0, "s")])
def test_times_below_a_second_are_written_in_ms(seconds, unit):
    from matplotlib.figure import Figure

    from jaxvision.plots.legible_axes import few_ticks

    axes = Figure().add_subplot()
    axes.loglog([seconds / 10, seconds], [1.0, 100.0])
    few_ticks(axes)
    axes.figure.draw_without_rendering()
    assert axes.get_xlabel() == f"time [{unit}]"
    shown = [float(label.get_text()) for label in axes.get_xticklabels()]
    np.testing.assert_allclose(shown, axes.get_xticks() * (1e3 if unit == "ms" else 1), rtol=1e-6)
    assert len(shown) > 1


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    file = tmp_path / "ball.toml"
    file.write_text(BALL)
    return file


def run(*arguments):
    return called(app, *arguments)


@pytest.mark.slow
def test_the_command_measures_a_scene(scene, tmp_path):
    status, said, _ = run("accuracy", scene, "--seconds", 1e5, "--out", tmp_path / "page")
    assert status == 0
    assert re.search(r"dtype +- +float(32|64) ", said)
    sheet = json.loads((tmp_path / "page" / "accuracy.json").read_text())
    single, double = sheet["knobs"][0]["trials"]
    assert 1e-9 < single["error"] < 1e-5
    assert double["hollow"]
    assert single["norms"].keys() == {"rms", "p99", "max", "delta_e"}
    assert single["norms"]["delta_e"] < 1e-3


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["accuracy", "BALL", "--knob", "depth"], "knob 'depth' changes nothing here"),
        (["accuracy", "BALL", "--seconds", "0"], "give a time above 0"),
        (["accuracy", "BALL", "--out", "BALL"], "is a file"),
        (["render", "BALL", "--out", "x.exr", "--accuracy", "1DN"], "a share of the picture"),
        (
            ["render", "BALL", "--out", "x.exr", "--accuracy", "200%"],
            "a black picture errs by no more",
        ),
        (["render", "BALL", "--out", "x.exr", "--accuracy", "10"], "is 1000 %; write 10% or 0.1."),
        (["render", "BALL", "--out", "x.exr", "--accuracy", "300"], "give less, as in 1%"),
        (
            ["render", "BALL", "--out", "x.exr", "--accuracy", "1%", "--samples", "4"],
            "--samples and a choice of settings exclude each other",
        ),
        (
            ["render", "BALL", "--out", "x.exr", "--accuracy", "1%", "--seconds", "4"],
            "--seconds and a choice of settings exclude each other",
        ),
    ],
)
def test_wrong_commands_are_sentences(scene, arguments, sentence):
    status, _, error = run(*(str(scene) if word == "BALL" else word for word in arguments))
    assert status == 2
    assert sentence in error


LAMP = """
[[light]]
kind = "rectangle"
corner = [-0.5, -1.5, 3]
edge_u = [0, 1, 0]
edge_v = [1, 0, 0]
radiance = [5, 5, 4]

[render]
integrator = "direct"
"""


def test_a_changed_order_is_the_order_that_is_rendered_with(tmp_path):
    """A rule brings its own default order only when the rule itself is the knob that changes."""
    (tmp_path / "lamp.toml").write_text(BALL + LAMP + "order = 2")
    source = read_scene(tmp_path / "lamp.toml")
    names = knobs_of(source, source.render)
    assert {"order", "rule"} <= set(names)
    base = base_of(source.render, names)
    assert entry_of(source.render, base | {"order": 16}).order == 16
    turned = entry_of(source.render, base | {"rule": "monte_carlo"})
    assert (turned.rule, turned.order) == ("monte_carlo", 64)
    by_chance = source.render.model_copy(update={"rule": "monte_carlo", "order": 4})
    base = base_of(by_chance, knobs_of(source, by_chance))
    assert entry_of(by_chance, base | {"light samples": 16}).order == 16


@pytest.mark.slow
def test_random_errors_of_light_and_of_pixel_positions_are_measured_separately(tmp_path):
    """Each seed samples the edges of the ball at other positions within pixels. This scatter must
    not enter where rules for the light are compared."""
    (tmp_path / "lamp.toml").write_text(BALL + LAMP + "samples = 4")
    problem = scene_problem(read_scene(tmp_path / "lamp.toml"))
    apart = {}
    for rule in ("quadrature", "monte_carlo"):
        for kind, prepare in (("all", problem.prepare), ("light", problem.alone["rule"])):
            compute = prepare({**problem.settings, "rule": rule})
            apart[rule, kind] = np.sqrt(np.mean((compute(1) - compute(2)) ** 2))
    assert apart["quadrature", "light"] == 0
    assert 0 < apart["monte_carlo", "light"] < apart["quadrature", "all"]


@pytest.mark.slow
def test_render_takes_and_remembers_settings(tmp_path, monkeypatch):
    """The command renders the Cornell box (32 x 32 pixels) within 20 %, and reuses the settings
    that it stored."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    small = ("--resolution", "32,32", "--no-preview")
    status, said, _ = run(
        "render", "cornell_box", "--out", tmp_path / "a.exr", "--accuracy", "20%", *small
    )
    assert status == 0
    assert "Chosen: samples" in said
    (kept,) = (tmp_path / "cache" / "jaxvision" / "accuracy").iterdir()
    before = kept.stat().st_mtime_ns
    again = run("render", "cornell_box", "--out", tmp_path / "b.exr", "--accuracy", "20%", *small)
    assert again[1].splitlines()[0] == said.splitlines()[0]
    assert kept.stat().st_mtime_ns == before
    fine = ("--samples", 4096, "--depth", 24, "--seed", 5)
    run("render", "cornell_box", "--out", tmp_path / "fine.exr", *fine, *small)
    first, second, truth = (
        np.asarray(oiio.ImageBuf(str(tmp_path / f"{name}.exr")).get_pixels(oiio.FLOAT))
        for name in ("a", "b", "fine")
    )
    np.testing.assert_array_equal(first, second)
    assert np.sqrt(np.mean((first - truth) ** 2) / np.mean(truth**2)) <= 0.2
