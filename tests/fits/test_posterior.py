"""Tests Laplace's approximation and emcee against a Gaussian in closed form and a skewed density by
quadrature, short chains, and continuation after a kill."""

import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from fitting.inference import blocks
from fitting.inference.emcee_run import Emcee, group_options
from fitting.inference.estimates import gaussian_estimate
from fitting.inference.importance import laplace_where_it_holds
from fitting.inference.parameters import Parameter
from fitting.inference.posterior import estimates, laplace, sample
from fitting.inference.trust import convergence_in_words
from jaxvision.errors import InputError

COVARIANCE = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.3], [0.0, 0.3, 2.0]])
PRECISION = jnp.asarray(np.linalg.inv(COVARIANCE))
SPACE = (
    Parameter("offset", symbol="o", unit="DN"),
    Parameter("gain", symbol="K", unit="DN/e-", transform="log"),
    Parameter("dark", symbol="d", unit="e-"),
)
ORIGIN = jnp.zeros(3)
SHORT = {"walkers": 32, "block": 100}
SEED = 5


def gaussian(vector, precision):
    return -vector @ precision @ vector / 2


def heavy_tailed(vector, precision):
    return -2 * jnp.log1p(vector @ precision @ vector / 4)


def one_sided(vector, precision):
    """Return the log density of a number with only a lower bound."""
    return -precision @ jnp.square(jnp.minimum(vector, 0)) / 2


def flat(vector, args):
    return args * vector[0] ** 2


def test_laplace_is_exact_for_a_gaussian():
    posterior = laplace(gaussian, SPACE, ORIGIN, PRECISION)
    np.testing.assert_allclose(posterior.covariance, COVARIANCE, atol=1e-12)
    offset, gain, _ = estimates(posterior)
    np.testing.assert_allclose(offset.interval_95, stats.norm.interval(0.95), rtol=1e-9)
    np.testing.assert_allclose(offset.interval_68, stats.norm.interval(0.68), rtol=1e-9)
    np.testing.assert_allclose(gain.interval_95, stats.lognorm(1.0).interval(0.95), rtol=1e-9)
    assert gain.value == 1.0
    assert gain.unit == "DN/e-"


def test_laplace_draws_have_the_covariance_they_claim():
    posterior = laplace(gaussian, SPACE, ORIGIN, PRECISION, draws=40_000, seed=1)
    vectors = posterior.samples.copy()
    vectors[:, 1] = np.log(vectors[:, 1])
    # 5 standard errors of a covariance from 40 000 draws with variances up to 2
    np.testing.assert_allclose(np.cov(vectors.T), COVARIANCE, atol=5 * 2.8 / 200)
    one, other = (laplace(gaussian, SPACE, ORIGIN, PRECISION, seed=seed) for seed in (0, 1))
    assert (one.draws != other.draws).all()


def test_a_given_covariance_replaces():
    given = laplace(gaussian, SPACE, ORIGIN, PRECISION, covariance=np.eye(3))
    np.testing.assert_array_equal(given.covariance, np.eye(3))


def test_laplace_refuses_an_unidentifiable_direction_in_words():
    with pytest.raises(InputError, match="say nothing about gain and dark"):
        laplace(flat, SPACE, ORIGIN, jnp.asarray(-1.0))


def chain_of(options, *, density=gaussian, precision=PRECISION, seed=SEED, after=None):
    return sample(
        *(density, SPACE, ORIGIN, COVARIANCE, precision), options=options, seed=seed, after=after
    )


@pytest.fixture(scope="module")
def sampled():
    """Return a chain that was not interrupted."""
    return chain_of(Emcee(**SHORT, steps=20_000))


def test_emcee_finds_the_gaussian(sampled):
    assert sampled.steps >= 50 * sampled.tau.max()
    vectors = sampled.samples.copy()
    vectors[:, 1] = np.log(vectors[:, 1])
    independent = len(vectors) / sampled.tau.max()
    error = 5 / np.sqrt(independent)
    np.testing.assert_allclose(vectors.mean(0), 0, atol=error * np.sqrt(2))
    np.testing.assert_allclose(np.cov(vectors.T), COVARIANCE, atol=error * 2.8)
    assert "independent draws" in convergence_in_words(sampled)


def test_the_same_seed_gives_the_same_chain_and_another_another(sampled):
    again, different = (chain_of(Emcee(**SHORT, steps=100), seed=s) for s in (SEED, 6))
    assert (sampled.seed, different.seed) == (SEED, 6)
    first, same, other = (run.blocks[0]["chain"] for run in (sampled, again, different))
    np.testing.assert_array_equal(same, first)
    assert (other != first).all()


def test_a_checkpoint_of_another_run_is_refused(tmp_path):
    options = Emcee(**SHORT, steps=100, checkpoint=tmp_path)
    begun = chain_of(options)
    others = ({"precision": 2 * PRECISION}, {"seed": SEED + 1}, {"density": heavy_tailed})
    for other in others:
        with pytest.raises(InputError, match=r"holds the chain of another run .* delete"):
            chain_of(options, **other)
        with pytest.raises(InputError, match="go on from is the chain of another run"):
            chain_of(Emcee(**SHORT, steps=100), after=begun, **other)


def test_a_damaged_or_missing_block_is_named(tmp_path):
    """Without the check, a chain would continue from the last block without the missing one."""
    block = {"chain": np.arange(3.0), "fingerprint": np.array("this run")}
    for number in range(3):
        blocks.store(tmp_path, number, block)
    assert len(blocks.resume_blocks(tmp_path, (), "this run")) == 3
    second = tmp_path / "block-00001.npz"
    whole = second.read_bytes()
    for content in (whole[:-30], whole.replace(b"chain", b"chaim"), whole.replace(b"@", b"A"), b""):
        second.write_bytes(content)
        with pytest.raises(InputError, match=r"block-00001\.npz: a damaged block; delete it"):
            blocks.resume_blocks(tmp_path, (), "this run")
    second.unlink()
    with pytest.raises(InputError, match=r"block-00001\.npz: missing; delete the blocks behind"):
        blocks.resume_blocks(tmp_path, (), "this run")


def test_a_short_chain_is_kept_and_says_how_many_steps_are_missing():
    def run(steps, block, **more):
        return chain_of(Emcee(walkers=32, block=block, steps=steps), seed=2, **more)

    stuck = run(3, 3)
    assert stuck.draws.shape == (32, 2, 3)
    assert "not moved in 3 steps" in convergence_in_words(stuck)
    short = run(60, 60)
    assert np.isfinite(estimates(short)[0].interval_95).all()
    assert f"about {short.missing_steps} more steps are missing" in convergence_in_words(short)
    whole = run(short.steps + short.missing_steps, 60, after=short)
    assert whole.steps > 60
    assert whole.missing_steps == 0
    assert "missing" not in convergence_in_words(whole)


def test_a_hopeless_chain_is_stopped_at_a_quarter():
    for gives_up, steps in ((True, 20), (False, 80)):
        options = Emcee(walkers=32, block=20, steps=80, gives_up=gives_up)
        given_up = chain_of(options)
        assert given_up.steps == steps
        assert given_up.missing_steps > 80


@pytest.mark.sweep
@pytest.mark.parametrize("kept", ["memory", "checkpoint"])
def test_a_continued_chain_equals_an_uninterrupted_one(tmp_path, sampled, kept):
    """The chain stopped within a block: 150 is not a multiple of 100."""
    folder = tmp_path if kept == "checkpoint" else None
    short = chain_of(Emcee(**SHORT, steps=150, checkpoint=folder))
    assert short.missing_steps
    whole = chain_of(Emcee(**SHORT, checkpoint=folder), after=None if folder else short)
    for name in ("draws", "log_density", "tau"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(sampled, name))
    assert (whole.steps, whole.acceptance) == (sampled.steps, sampled.acceptance)


def test_a_chain_in_memory_fills_a_checkpoint(tmp_path):
    short = chain_of(Emcee(**SHORT, steps=200))
    chain_of(Emcee(**SHORT, steps=300, checkpoint=tmp_path), after=short)
    assert len(list(tmp_path.glob("*.npz"))) == 3


@pytest.mark.slow
def test_a_density_has_one_fingerprint_in_every_process(capsys):
    """It depends on the formula and its constants, but not on addresses and the order of sets."""
    program = (
        "import jax, jax.numpy as jnp, numpy as np\n"
        "from fitting.inference.blocks import fingerprint\n"
        "for factor in (2.0, 3.0, np.array([2.0]), np.array([3.0])):\n"
        "    density = lambda v, a: -jnp.sum(jax.nn.relu(v @ v) * factor)\n"
        "    print(fingerprint(density, jnp.zeros(2), np.eye(2), None, 3, package='emcee'))"
    )
    other = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout
    exec(program, {"__name__": "__main__"})
    assert capsys.readouterr().out == other
    assert len(set(other.split())) == 4


@pytest.mark.sweep
@pytest.mark.parametrize("parameters", [40, 11])
def test_walkers_and_moves_suit_the_dimension(parameters):
    """The density is of independent standard normal numbers. With 40 of them, 64 walkers do not
    span the space."""
    space = tuple(Parameter(f"x{i}", symbol="x", unit="1") for i in range(parameters))
    chain = sample(
        gaussian,
        space,
        jnp.zeros(parameters),
        np.eye(parameters),
        jnp.eye(parameters),
        options=Emcee(steps=100, block=100),
    )
    assert chain.draws.shape[0] == max(64, 2 * parameters + 2)
    assert 0.1 < chain.acceptance < 0.8


@pytest.mark.slow
def test_the_time_of_many_walkers_is_proportional(monkeypatch):
    """The density that proposes moves is estimated from some of the walkers, not from all."""
    seen = []

    def recorded(points, **kinds):
        seen.append(points.shape[1])
        return stats.gaussian_kde(points, **kinds)

    monkeypatch.setattr("emcee.moves.kde.gaussian_kde", recorded)
    options = Emcee(walkers=1200, steps=100, block=100, gives_up=False)
    chain = sample(gaussian, SPACE, ORIGIN, COVARIANCE, PRECISION, options=options, seed=SEED)
    assert set(seen) == {256}
    vectors = np.array(chain.draws[:, 50:])
    vectors[..., 1] = np.log(vectors[..., 1])
    found = np.cov(vectors.reshape(-1, 3).T)
    np.testing.assert_allclose(found, COVARIANCE, atol=0.15)


def nan_below_zero(vector, args):
    return jnp.where(vector[0] > 0, -vector[0] * args, jnp.nan)


@pytest.mark.slow
def test_nan_counts_as_impossible():
    space = (Parameter("x", symbol="x", unit="1"),)
    options = Emcee(walkers=16, block=400)
    chain = sample(
        nan_below_zero,
        space,
        jnp.ones(1),
        np.eye(1) * 0.01,
        jnp.asarray(1.0),
        options=options,
        seed=1,
    )
    assert chain.samples.min() > 0


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"walkers": 7}, "walkers = 7"),
        ({"steps": 10, "block": 20}, "steps = 10"),
        ({"steps": 150.5}, r"steps = 150\.5: give a whole number of at least 1"),
        ({"block": None}, "block = None: give a whole number"),
        ({"walkers": "many"}, "walkers = 'many': give a whole number"),
    ],
)
def test_unusable_options_are_refused(options, expected):
    with pytest.raises(InputError, match=expected):
        Emcee(**options)


def test_each_group_has_a_checkpoint_of_its_own():
    options = Emcee(checkpoint=Path("c"))
    assert group_options(options, "green 1").checkpoint == Path("c/green_1")
    assert group_options(None, "red") is None


def test_an_improper_posterior_is_a_sentence():
    space, precision = (Parameter("share"), Parameter("other")), jnp.asarray([1.0, 1.0])
    with pytest.raises(InputError, match=r"do not bound (share|other) on both sides"):
        sample(one_sided, space, jnp.zeros(2), np.eye(2), precision, seed=SEED)
    found = laplace_where_it_holds(one_sided, space, jnp.zeros(2), np.eye(2), precision, seed=SEED)
    assert found.method == "Laplace"
    assert "on one side only" in convergence_in_words(found)


def test_numbers_unidentified_over_their_range_have_no_value():
    gain = Parameter("gain", symbol="K", unit="DN/e-")
    for value, error in ((1e-10, 1e-4), (np.inf, 1.0), (1.0, np.nan)):
        found = gaussian_estimate(gain, value, error, log_scale=True)
        assert found.value is None
        assert "exceeds all floating-point numbers" in found.reason


def test_walkers_that_start_at_zero_density_cause_no_warning():
    """emcee would subtract infinities, because half of the walkers start below zero."""
    options = Emcee(walkers=16, steps=60, block=30)
    space = (Parameter("a"),)
    drawn = sample(
        nan_below_zero, space, jnp.asarray([0.5]), np.eye(1) * 4, 1.0, options=options, seed=0
    )
    assert drawn.log_density is not None
    assert np.isfinite(drawn.log_density).all()
    assert (drawn.samples > 0).all()


def test_walkers_in_a_plane_use_differential_moves():
    """A density estimate of walkers in a plane does not exist, and SciPy would warn."""
    options = Emcee(walkers=16, steps=20, block=10)
    line = np.full((3, 3), 1.0) + 1e-15 * np.eye(3)
    found = sample(gaussian, SPACE, ORIGIN, line, PRECISION, options=options, seed=SEED)
    assert np.isfinite(found.samples).all()
