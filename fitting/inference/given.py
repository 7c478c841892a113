"""Check a user's numbers: integers, widths and ranges. Each error is one sentence."""

from collections.abc import Callable, Mapping
from numbers import Number
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Float, Int

from jaxvision.core.plain_arrays import plain_array
from jaxvision.errors import InputError

from .on_host import to_host

CENSORED_T = "Student's t of data with ends is StudentT(scale, low=..., high=...)"
ASYMMETRY = 1e-5  # of the largest entry of a covariance: rounding of float32
LARGEST_SEED = 2**32 - 1  # largest seed that every random generator accepts


def plain_numbers(what: str, value: Any) -> Any:
    """Return an argument as an array of real numbers, or raise an error that names the argument."""
    plain = plain_array(what, value)
    if not hasattr(plain, "dtype"):
        try:
            plain = np.asarray(plain)
        except ValueError as error:
            raise InputError(
                f"{what} has parts of unequal length; give an array, NaN where numbers are missing."
            ) from error
    if plain.dtype.kind in "OSU":
        parts = np.asarray(plain, object)
        held = [
            part
            for part in parts.ravel()
            if not isinstance(part, Number) and (part is not None or not parts.ndim)
        ]
        if held:
            raise InputError(f"{what} holds {held[0]!r:.40}, which is no number; give numbers.")
        plain = plain.astype(complex if np.iscomplexobj(plain.tolist()) else float)
    refuse_complex(what, plain)
    return plain


def refuse_complex(what: str, plain: Any) -> None:
    """Refuse complex numbers, because a cast would drop the imaginary part."""
    if np.iscomplexobj(plain):
        raise InputError(
            f"{what} holds complex numbers, and real ones are wanted; give their real and "
            "imaginary parts along an axis of two, or the modulus."
        )


def is_concrete(tree: Any) -> bool:
    """Return whether no number of a tree is a tracer of a JAX transformation."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def require_whole(
    what: str, value: Any, *, least: int = 1, most: int | None = None, of: str = ""
) -> None:
    """Refuse values that are not integers from `least` to `most` (None for no maximum)."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if whole and value >= least and (most is None or value <= most):
        return
    ends = f"of at least {least}" if most is None else f"from {least} to {most}"
    ends = f"of {of}, at least {least}" if of else ends
    raise InputError(f"{what} = {value!r}: give a whole number {ends}.")


def require_kind(what: str, value: Any, kind: type, *, source: str = "") -> None:
    """Refuse a value that is not of the given type."""
    if not isinstance(value, kind):
        named = f"the class {value.__name__}" if isinstance(value, type) else type(value).__name__
        hint = f"; {source} gives one" if source else ""
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        raise InputError(f"{what} must be {article} {kind.__name__}, got {named}{hint}.")


def require_progress(value: Any) -> None:
    """Refuse an object that cannot receive the progress of a chain."""
    if not (value is None or callable(value)):
        raise InputError(f"progress = {value!r}: give a function of (steps done, steps in all).")


def require_seed(value: Any) -> None:
    """Refuse a value that cannot seed a random generator."""
    require_whole("seed", value, least=0, most=LARGEST_SEED)


def number_or_name(what: str) -> Callable[[Any], Any]:
    """Return a likelihood field's converter: numbers to arrays, names of parameters unchanged."""

    def convert(value: Any) -> Any:
        if isinstance(value, str) and value:
            return value
        try:
            plain = plain_array(what, value)
            refuse_complex(what, plain)
            return jnp.asarray(plain, jnp.result_type(float))
        except InputError:
            raise
        except (TypeError, ValueError) as error:
            plain = value is None or isinstance(value, str | list | tuple)
            got = repr(value) if plain else f"a {type(value).__name__}"
            hint = f"; {CENSORED_T}" if hasattr(value, "log_density") else ""
            raise InputError(
                f"{what} is a number, an array or the name of a parameter, got {got}{hint}."
            ) from error

    return convert


def end_or_name(what: str) -> Callable[[Any], Any]:
    """Return a converter like that of `number_or_name`, for a bound that may be None."""
    convert = number_or_name(what)
    return lambda value: None if value is None else convert(value)


def require_positive(what: str, value: Any) -> None:
    """Refuse a width that is not positive. A parameter's name or a traced value is not checked."""
    if isinstance(value, str) or not is_concrete(value):
        return
    values = to_host(value)
    wrong = values[~((values > 0) & (values < np.inf))]
    if wrong.size:
        raise InputError(f"{what} must be positive and finite, got {wrong.flat[0]:g}.")


def require_covariance(what: str, matrix: Float[np.ndarray, "n n"]) -> None:
    """Refuse a matrix that is not finite, symmetric and positive semi-definite up to rounding."""
    wrong, least = "", ASYMMETRY * float(np.abs(matrix).max(initial=0))
    if not np.isfinite(matrix).all():
        wrong = "holds numbers that are not finite"
    elif np.abs(matrix - matrix.T).max(initial=0) > least:
        wrong = "is not symmetric"
    elif (size := float(np.linalg.eigvalsh(matrix).min(initial=0))) < -least:
        wrong = f"has a negative variance along some direction (least eigenvalue {size:.3g})"
    if wrong:
        raise InputError(
            f"{what} {wrong}; a covariance is finite, symmetric and positive semi-definite."
        )


def require_ascending(what: str, low: Any, high: Any) -> None:
    """Refuse an empty interval; None, a name or a traced value is not checked."""
    ends = {"low": low, "high": high}
    known = {
        name: to_host(end)
        for name, end in ends.items()
        if not (end is None or isinstance(end, str)) and is_concrete(end)
    }
    for name, end in known.items():
        if np.isnan(end).any():
            raise InputError(f"{what}: {name} is NaN; give a number, or None for no such end.")
    if len(known) < len(ends):
        return
    try:
        least, most = np.broadcast_arrays(*known.values())
    except ValueError as error:
        raise InputError(
            f"{what}: low and high have the shapes {known['low'].shape} and "
            f"{known['high'].shape}; give each as one number or in the data's shape."
        ) from error
    if (wrong := least >= most).any():
        raise InputError(
            f"{what}: low = {least[wrong].flat[0]:g} must lie below high = {most[wrong].flat[0]:g}."
        )


def whole_labels(labels: Any) -> dict[str, Any] | Int[np.ndarray, "..."]:
    """Return the labels of groups as integers."""
    if isinstance(labels, Mapping):
        if not labels:
            raise InputError("Clustered: give at least one level of labels.")
        return {str(name): whole_labels(one) for name, one in labels.items()}
    given = to_host(plain_array("labels", labels))
    if given.dtype.kind not in "iuf" or (given != np.round(given)).any():
        raise InputError(
            "Clustered: labels are whole numbers, the group of each datum; "
            "numpy.unique(names, return_inverse=True)[1] numbers other names."
        )
    return given.astype(np.int64)
