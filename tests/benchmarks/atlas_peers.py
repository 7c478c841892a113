"""Points of other programs in the atlas: their error and time on the same problem."""

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import jax.numpy as jnp
import numpy as np
from turns import in_turns

from fitting import fit
from fitting.accuracy import KNOBS as FIT_KNOBS
from fitting.accuracy.chains import ENDS, Density, chain_knobs
from fitting.accuracy.examples import sine
from fitting.inference.parameters import to_natural, to_unconstrained
from fitting.inference.problem import log_density
from fitting.response.curve import fit_response_curve
from jaxvision.accuracy import Curve, Knob, Problem
from jaxvision.accuracy.examples.pictures import SIGMA, picture

sys.path.insert(0, str(Path(__file__).parents[1]))
from oracles.stacks import exposure_stack, log_exposures, srgb

TIMES = 2.0 ** np.arange(-4, 5)
SIDE = 128  # pixels of the stack
CODES = np.arange(20, 236)
ROUNDS = 5


@dataclass(frozen=True)
class Peer:
    """One setting of another program.

    Attributes:
        name: name of the program and its setting.
        error: relative error, as for jaxvision.
        seconds: s, without compilation."""

    name: str
    error: float
    seconds: float


def _points(
    rivals: dict[str, Callable[[], np.ndarray]], exact: np.ndarray, level: float, cut: int = 0
) -> Iterator[Peer]:
    """Yield the points of programs that run in alternation. `cut` is the width in pixels of the
    edge that is not compared, because programs continue pictures differently."""
    results = {name: run() for name, run in rivals.items()}
    _, seconds = in_turns(rivals, rounds=ROUNDS)
    inside = (slice(cut, -cut or None),) * 2 if cut else ...
    for name, found in results.items():
        error = np.sqrt(np.mean((np.asarray(found)[inside] - exact[inside]) ** 2)) / level
        yield Peer(name, max(float(error), 1e-17), seconds[name])


def _exact(problem: Problem, found: Curve) -> np.ndarray:
    setting = {found.knob.name: found.knob.reference[-1]}
    return np.asarray(problem.prepare(setting)(0), np.float64)


def of_method(problem: Problem, found: Curve) -> Iterator[Peer]:
    from scipy import ndimage

    kernel = np.random.default_rng(0).uniform(size=(15, 15))
    kernel, image = kernel / kernel.sum(), picture()
    rivals = {"scipy": lambda: ndimage.correlate(image, kernel[..., None])}
    try:
        import cv2

        rivals["OpenCV"] = lambda: cv2.filter2D(image, -1, kernel)
    except ImportError:
        pass
    exact = _exact(problem, found)
    yield from _points(rivals, exact, float(np.sqrt(np.mean(exact**2))), cut=8)


def of_cut(problem: Problem, found: Curve) -> Iterator[Peer]:
    from scipy import ndimage

    image = picture()

    def scipy_cut(cut: float) -> Callable[[], np.ndarray]:
        return lambda: ndimage.gaussian_filter(image, (SIGMA, SIGMA, 0), truncate=cut)

    rivals = {f"scipy {cut}": scipy_cut(cut) for cut in (2.0, 4.0)}
    try:
        import cv2

        rivals["OpenCV"] = lambda: cv2.GaussianBlur(image, (0, 0), SIGMA)
    except ImportError:
        pass
    exact = _exact(problem, found)
    yield from _points(rivals, exact, float(np.sqrt(np.mean(exact**2))), cut=19)


def _stack() -> tuple[list[np.ndarray], np.ndarray]:
    rng = np.random.default_rng(0)
    channels = [
        exposure_stack(srgb, TIMES, rng, pixels=SIDE**2, full_well=40_000.0)[1] for _ in range(3)
    ]
    images = np.stack(channels, axis=-1).reshape(len(TIMES), SIDE, SIDE, 3).astype(np.uint8)
    return channels, images


def _levelled(g: np.ndarray) -> np.ndarray:
    return g - np.median(g)


def stack_problem() -> tuple[Problem, Knob]:
    """Return the problem of three response curves of a stack with known true curves: log exposures
    of codes 20 to 235."""
    channels, _ = _stack()

    def prepare(settings):
        wanted = int(settings["pixels"] * SIDE**2)

        def compute(seed: int) -> np.ndarray:
            chosen = np.random.default_rng(seed).permutation(SIDE**2)[:wanted]
            curves = [fit_response_curve(codes[:, chosen], TIMES, bits=8) for codes in channels]
            return _levelled(np.interp(CODES, curves[0].codes, curves[0].log_exposure))

        return compute

    truth = _levelled(log_exposures(srgb, CODES))
    knob = Knob("pixels", "of 16 384", "pixels", (0.03, 0.1, 0.3, 1.0), (), random=True)
    return Problem("sRGB curves of a stack, in ln", prepare, exact=truth, level=1.0), knob


def of_stack(problem: Problem, found: Curve) -> Iterator[Peer]:
    try:
        import cv2
    except ImportError:
        return
    _, images = _stack()
    times = TIMES.astype(np.float32)

    def curve_of(calibrate) -> Callable[[], np.ndarray]:
        def run() -> np.ndarray:
            response = calibrate.process(list(images), times)[CODES, 0, 0]
            return _levelled(np.log(np.maximum(response, 1e-12)))

        return run

    rivals = {
        f"Debevec {n}": curve_of(cv2.createCalibrateDebevec(n, 10.0, False)) for n in (70, 300)
    }
    rivals["Robertson"] = curve_of(cv2.createCalibrateRobertson(30, 0.01))
    yield from _points(rivals, np.asarray(problem.exact), 1.0)


def of_samples(problem: Problem, found: Curve) -> Iterator[Peer]:
    """Yield the points of Mitsuba's Cornell box with equal depth and pixels, each from the scatter
    of its seeds about a reference of its own. Radiance is clipped at twice its 95 % quantile, as
    for jaxvision."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        return
    try:
        from mitsuba_scenes import mitsuba, mitsuba_cornell_box

        mi = mitsuba()
    except ImportError:  # or DRJIT_LIBLLVM_PATH names no library
        return
    path = {"type": "path", "max_depth": problem.settings["depth"], "rr_depth": 1000}
    scene = mitsuba_cornell_box(mi, side=128, integrator=path)

    def picture_of(samples: int, seed: int) -> np.ndarray:
        return np.asarray(mi.render(scene, spp=samples, seed=seed), np.float64)

    reference = np.mean([picture_of(1024, seed) for seed in range(100, 104)], axis=0)
    top = 2 * np.quantile(reference.max(axis=-1), 0.95)
    exact = np.minimum(reference, top)
    level = float(np.sqrt(np.mean(exact**2)))
    rivals = {f"Mitsuba {n}": lambda n=n: np.minimum(picture_of(n, 7), top) for n in (4, 16, 64)}
    yield from _points(rivals, exact, level)


def sine_problem() -> tuple[Problem, Knob]:
    """Return the problem of the interval ends of a sine of unknown frequency, by `emcee` on
    jaxvision's density."""
    density = _sine()
    turned = chain_knobs(density)["chain length"]
    knob = FIT_KNOBS["chain length"]
    return Problem("a sine by emcee", lambda s: turned(s[knob.name]), level=1.0), knob


def _sine() -> Density:
    problem = sine()
    best = fit(problem)
    about = jnp.asarray(best.optimum.vector), best.posterior.covariance
    return Density(log_density, problem.space, *about, problem)


def of_sine(problem: Problem, found: Curve) -> Iterator[Peer]:
    """Yield the points of `emcee` with its default move on a NumPy density of the same posterior,
    from the second half of the chain."""
    import emcee

    density = _sine()
    space, stated = density.space, density.args
    time, data = np.asarray(stated.inputs), np.asarray(stated.data)
    low, high = np.array([0.1, -2.0]), np.array([20.0, 2.0])
    mode = np.asarray(to_natural(space, density.mode))

    def of(natural: np.ndarray) -> float:
        if np.any((natural <= low) | (natural >= high)):
            return -np.inf
        z = (data - np.sin(2 * np.pi * natural[0] * time + natural[1])) / 0.5
        return -float(np.sum(z * z)) / 2

    def ends(steps: int, seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        sampler = emcee.EnsembleSampler(64, 2, of)
        sampler._random = np.random.RandomState(seed)
        sampler.run_mcmc(mode + 0.01 * rng.standard_normal((64, 2)), steps)
        natural = np.quantile(sampler.get_chain(discard=steps // 2, flat=True), ENDS, axis=0)
        vectors = np.asarray(to_unconstrained(space, jnp.asarray(natural)))
        return (vectors - np.asarray(density.mode)) / density.errors

    run = problem.prepare({"chain length": 1600})
    exact = np.mean([run(seed) for seed in range(100, 108)], axis=0)
    for steps in (100, 400):
        start = perf_counter()
        errors = [np.mean((ends(steps, seed) - exact) ** 2) for seed in range(3)]
        yield Peer(f"NumPy {steps}", float(np.sqrt(np.mean(errors))), (perf_counter() - start) / 3)


PEERS: dict[str, Callable[[Problem, Curve], Iterator[Peer]]] = {
    "example filter method": of_method,
    "example Gaussian cut": of_cut,
    "stack pixels": of_stack,
    "cornell_box path samples": of_samples,
    "sine chain length": of_sine,
}
