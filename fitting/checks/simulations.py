"""Many simulated fits, stored 20 at a time, so that an interrupted check can be continued."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.stats import t
from threadpoolctl import threadpool_limits

from jaxvision.errors import InputError
from jaxvision.files.images import replaced_on_success
from jaxvision.tasks import PROGRAMS, map_ordered

from ..inference.parameters import names, unconstrained_numbers
from ..inference.posterior import Posterior

BLOCK = 20  # fits between two writings
SAME = 1e-3  # difference up to which two positions count as the same fit

Simulate = Callable[[int], Float[np.ndarray, " parameters"]]


def simulated(
    simulate: Simulate,
    count: int,
    *,
    parameters: int,
    kept: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Float[np.ndarray, "simulations parameters"]:
    """Return the cumulative probabilities of the true values in the posteriors of many simulated
    fits. The fits run on the workers of `jaxvision.cluster` if there are any."""
    rows = np.empty((0, parameters))
    with threadpool_limits(1, user_api="blas"):  # systems are too small for threads
        if kept is not None and (found := _read_results(kept)) is not None:
            own = found.ndim == 2 and found.shape[1] == parameters and found.dtype == rows.dtype
            own = own and not np.any((found < 0) | (found > 1))
            some = sorted({0, len(found) // 2, len(found) - 1}) if own and len(found) else []
            again = np.reshape([_places((simulate, parameters), n) for n in some], (-1, parameters))
            if not own or not np.allclose(found[some], again, atol=SAME, equal_nan=True):
                raise InputError(
                    f"{kept}: holds fits of another problem, seed or version; name another file "
                    "(or folder), or remove it."
                )
            rows = found
        for row in map_ordered(
            _places, (simulate, parameters), range(len(rows), count), memory=PROGRAMS
        ):
            rows = np.vstack([rows, row])
            progress(len(rows), count)
            if kept is not None and (len(rows) % BLOCK == 0 or len(rows) == count):
                with replaced_on_success(kept) as partial, partial.open("wb") as stream:
                    np.save(stream, rows)
    rows = rows[:count]
    if count and np.isnan(rows).all():
        try:
            simulate(0)
        except InputError as error:
            raise InputError(f"none of {count} fits gave an interval; the first: {error}") from None
    return rows


def _read_results(file: Path) -> np.ndarray | None:
    """Read the results of an earlier run; None if there are none."""
    if not file.exists():
        return None
    if not file.is_file():
        raise InputError(f"{file}: is a folder; name a file.")
    with file.open("rb") as stream:
        if not stream.read(1):
            return None
        stream.seek(0)
        try:
            return np.load(stream, allow_pickle=False)
        except Exception:  # a damaged header can raise any exception
            raise InputError(
                f"{file}: holds no kept fits, or damaged ones, and was not changed; remove it, or "
                "name another file."
            ) from None


def _places(shared: tuple[Simulate, int], seed: int) -> Float[np.ndarray, " parameters"]:
    simulate, parameters = shared
    try:
        return simulate(seed)
    except InputError:
        return np.full(parameters, np.nan)


def places_in(posterior: Posterior, truth: Mapping[str, float]) -> dict[str, float]:
    """Return the cumulative probability of the true value in each parameter's posterior. This
    probability is computed from the same distribution as the printed intervals: the draws, or
    Laplace's Gaussian or Student's t."""
    labels = names(posterior.space)
    known = [(i, name) for i, name in enumerate(labels) if name in truth]
    if posterior.sampled:
        draws = posterior.samples
        return {name: float(np.mean(draws[:, i] < truth[name])) for i, name in known}
    space = tuple(posterior.space[i] for i, _ in known)
    wanted = unconstrained_numbers(space, np.array([truth[name] for _, name in known], float))
    at = [i for i, _ in known]
    miss = wanted - posterior.unconstrained_mode[at]
    freedom = np.inf if posterior.freedom is None else posterior.freedom[at]
    chance = t.cdf(miss / np.sqrt(np.diagonal(posterior.covariance)[at]), freedom)
    return {name: float(u) for (_, name), u in zip(known, chance, strict=True)}
