"""Tests comparisons of models by light: paired differences against simulation, and their
verdicts."""

import numpy as np
import pytest
from scipy import stats

from fitting.reflectance.from_files.errors import Errors, exceeds_signal, ratio
from fitting.reflectance.from_images.comparison import (
    ModelScore,
    difference,
    equally_good,
    relative_rms,
    surpassed_by,
    verdict,
)


def score(model, by_light, *, channel="grey", bic=0.0):
    return ModelScore(model, channel, 0.1, relative_rms(by_light), 3, 0.0, bic, 100.0, by_light)


def lights(rng, count, error):
    """Return squared errors with 30 % of variation shared between lights, for a signal of 1."""
    shared = 1 + 0.3 * rng.standard_normal(count)
    return np.stack([(error * shared) ** 2, np.ones(count)], axis=1)


def test_the_error_of_a_difference_equals_that_of_repeats():
    """Both models have similar errors in each light, which pairing removes."""
    found, values = [], []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        shared, own = 1 + 0.3 * rng.standard_normal((2, 12)), rng.standard_normal((2, 12))
        one, other = (
            np.stack([(0.1 * shared[0]) ** 2 * (1 + 0.05 * z), np.ones(12)], axis=1) for z in own
        )
        gap = difference(score("phong", one), score("blinn", other))
        assert gap.freedom == 11
        found.append(gap.error)
        values.append(gap.value)
    assert np.mean(found) == pytest.approx(np.std(values), rel=0.15)


def test_one_light_is_uninformative():
    rng = np.random.default_rng(0)
    one, other = (score(m, lights(rng, 1, e)) for m, e in (("phong", 0.1), ("lambert", 0.2)))
    assert difference(one, other).half_width == np.inf
    assert equally_good((one, other)) == ("phong",)
    assert "One light does not show" in verdict((one, other), 1)


def test_the_verdict_agrees_with_the_lights():
    rng = np.random.default_rng(1)
    best = lights(rng, 16, 0.07)
    close = best * [1 + 0.02 * rng.standard_normal((16, 1))[:, 0].mean(), 1.0]
    close[:, 0] *= 1.01 + 0.1 * rng.standard_normal(16)
    far = lights(rng, 16, 0.3)
    scores = (
        score("lambert", far, bic=90_000.0),
        score("phong", close, bic=45_743.0),
        score("torrance-sparrow", best),
    )
    assert set(equally_good(scores)) == {"phong", "torrance-sparrow"}
    told = verdict(scores, 16)
    assert "equally" not in told
    assert "Not distinguishable from it by these lights: Torrance-Sparrow (GGX) (" in told
    assert " percentage points more). With 16 lights a difference counts from 2.1 standard" in told
    assert "BIC prefers Torrance-Sparrow (GGX) by 45743" in told
    apart = verdict((scores[0], scores[2]), 16)
    assert "The next, Lambert, has" in apart
    assert " (grey), 75 % below the 30.0 % of Lambert. The next" in apart


def test_a_difference_of_few_lights_needs_more_standard_errors():
    """3.7 standard errors are insignificant for three lights: Student's t with two degrees of
    freedom."""
    best = np.stack([[0.010, 0.012, 0.011], np.ones(3)], axis=1)
    close = best * [[1.02, 1.0], [1.01, 1.0], [1.05, 1.0]]
    scores = (score("lambert", best * [9, 1]), score("phong", close), score("blinn", best))
    gap = difference(scores[1], scores[2])
    assert 2 * gap.error < gap.value < gap.half_width
    assert (
        "With 3 lights a difference counts from 4.3 standard errors on, by Student's t with 2 "
        "degrees of freedom at 95 %."
    ) in verdict(scores, 3)


def test_differences_within_solver_tolerance_do_not_count():
    """The errors differ by 1e-8 of themselves, always in one direction. The first fitted model is
    named."""
    rng = np.random.default_rng(2)
    best = lights(rng, 6, 0.02)
    rounded = best * [1 + 2e-8, 1.0] * np.linspace(1, 1 + 1e-9, 6)[:, None]
    far = lights(rng, 6, 0.3)
    scores = (score("lambert", rounded), score("phong", best), score("blinn", far))
    gap = difference(scores[0], scores[1])
    assert (gap.value, gap.error, gap.freedom) == (0.0, 0.0, 5)
    assert equally_good(scores) == ("lambert", "phong")
    told = verdict(scores, 6)
    assert "Lambert predicts best" in told
    assert "Phong (the same)." in told


def test_a_better_model_is_found():
    """It is found by held-out lights if they decide, else by a decisive BIC, else not at all."""
    rng = np.random.default_rng(1)
    best, own = lights(rng, 16, 0.07), 1 + 0.1 * rng.standard_normal(16)
    near, far = best * np.stack([own / own.mean(), np.ones(16)], axis=1), lights(rng, 16, 0.3)

    def surpassed(by_light, bic):
        scores = (score("phong", by_light, bic=bic), score("blinn", best))
        return surpassed_by(scores, "phong")

    model, told = surpassed(far, 0.0)
    assert model == "blinn"
    assert told.startswith("has 2")
    assert told.endswith(" percentage points more error on unseen lights than")
    assert surpassed(near, 1453.2) == ("blinn", "has a BIC larger by 1453 than")
    assert surpassed(near, 9.0) is None
    one = (score("phong", far[:1], bic=1453.2), score("blinn", best[:1]))
    assert surpassed_by(one, "phong") == ("blinn", "has a BIC larger by 1453 than")
    assert surpassed_by(one, "blinn") is None


def of(parts):
    whole = np.sqrt(np.sum(parts))
    return Errors(whole, whole, whole, np.sqrt(parts), np.stack([parts, parts], axis=1))


def test_predictions_are_paired_by_incidence():
    base = np.array([1.0, 4.0, 9.0, 30.0])
    assert ratio(of(base), of(1.3 * base), "cosine").significant
    assert not ratio(of(base), of(base * [1.3, 0.8, 1.1, 0.9]), "cosine").significant
    assert not ratio(of(base[:2]), of(9 * base[:2]), "cosine").significant
    assert not ratio(of(base), of(base), "cube-root").significant
    assert not ratio(of(base), of(base * (1 + 1e-7)), "cosine").significant


def test_the_stated_error_is_the_one_that_is_judged():
    """The ratio is three times the whole error whichever incidence is left out, although incidences
    with tiny weights favour the worse model. In the other case it is seven times, and depends on
    one incidence."""
    good = np.array([1e-6, 1e-6, 1e-6, 1e-6, 1.0, 1.2, 0.9, 1.1])
    bad = np.array([1e-8, 1e-8, 1e-8, 1e-8, 10.0, 10.5, 9.5, 9.0])
    assert ratio(of(good), of(bad), "cosine").significant
    assert ratio(of(bad), of(good), "cosine").significant
    hangs = ratio(of([1, 2, 1, 2, 1, 2, 1, 400]), of([1, 2, 1, 2, 1, 2, 1, 2]), "cosine")
    np.testing.assert_allclose(hangs.value, np.sqrt(410 / 12))
    np.testing.assert_allclose(hangs.without[[0, -1]], [np.sqrt(409 / 11), 1])
    assert not hangs.significant


def test_an_order_can_be_significant_without_its_size():
    """The ratios are the roots of 4 and of (4 * 4 + 400) / 5."""
    base = np.ones(6)
    sure = ratio(of([4, 4, 4, 4, 4, 400]), of(base), "cosine")
    np.testing.assert_allclose(sure.without[[-1, 0]], [2, np.sqrt(416 / 5)])
    np.testing.assert_allclose(sure.alone, [2, 2, 2, 2, 2, 20])
    assert not sure.significant
    assert sure.ordered
    assert sure.chance == pytest.approx(2 / 2**6)
    reverse = ratio(of(base), of([4, 4, 4, 4, 4, 400]), "cosine")
    assert reverse.ordered
    assert reverse.more_often == 6
    five = ratio(of([4, 4, 4, 4, 400]), of(base[:5]), "cosine")
    assert five.chance == pytest.approx(2 / 2**5)
    assert not five.ordered
    base = base[:5]
    hangs = ratio(of([0.5, 0.5, 0.5, 0.5, 400]), of(base), "cosine")
    assert (hangs.more_often, hangs.chance, hangs.ordered) == (1, 1, False)
    assert not ratio(of([4, 400]), of(base[:2]), "cosine").ordered
    assert not ratio(of(base + 1e-9 * np.arange(1, 6)), of(base), "cosine").ordered
    assert not ratio(of(1.04 * base), of(base), "cosine").ordered


@pytest.mark.sweep
@pytest.mark.parametrize("incidences", [5, 8, 15])
def test_equal_models_are_seldom_ordered(incidences):
    """Errors of the two models scatter equally about those of each incidence."""
    rng, found = np.random.default_rng(2), []
    for _ in range(1000):
        base = np.exp(1.5 * rng.standard_normal(incidences))
        one, other = base * np.exp(0.6 * rng.standard_normal((2, incidences)))
        pair = ratio(of(one), of(other), "cosine")
        k = int(np.sum(one > other if pair.value > 1 else one < other))
        exact = stats.binomtest(k, incidences, alternative="greater").pvalue
        assert pair.chance == pytest.approx(min(2 * exact, 1))
        found.append(pair.ordered)
    assert np.mean(found) < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 1000)


def test_errors_beyond_the_signal_need_a_relative_metric():
    assert exceeds_signal(of([0.5, 0.6]), "cosine")
    assert not exceeds_signal(of([0.5, 0.4]), "cosine")
    assert not exceeds_signal(of([0.5, 0.6]), "cube-root")
