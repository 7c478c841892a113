"""Findings of a report, as a table of sentences with the conditions under which they are stated.
Equal findings on several channels are combined to one sentence."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from .figures import OF_CHANNEL

Numbers = Mapping[str, Any]

_LABELLED = re.compile(r"([\w ]{1,24}): (.+)", re.DOTALL)
_CHANNEL = re.compile(rf"(?<!\w)(?:{'|'.join(OF_CHANNEL)})$")
_NUMBER = re.compile(r"(?<![\w.])[-+−]?\d[\d.,]*(?:e[-+]?\d+)?(?<![.,])")


class Finding(NamedTuple):
    """A sentence of a report with its condition."""

    key: str  # name of the finding
    # function of a calibration that returns whether the sentence is stated, or the numbers of the
    # sentence by name. For a list of such results, the sentence is stated once for each. For None
    # or an empty list, the sentence is not stated.
    condition: Callable[[Any], bool | Numbers | Iterable[Numbers] | None]
    sentence: str  # format string of the sentence, into which the numbers are inserted


def quoted(key: str, sentences: Callable[[Any], Iterable[str]]) -> Finding:
    """Make a finding whose complete sentences a function of the calibration returns."""
    return Finding(key, lambda c: [{"sentence": one} for one in sentences(c)], "{sentence}")


def evaluate_findings(table: Iterable[Finding], calibration: Any) -> tuple[str, ...]:
    """Return the sentences of those findings in a table whose conditions a calibration meets."""
    found = []
    for row in table:
        numbers = row.condition(calibration)
        every: Iterable[Numbers]
        if isinstance(numbers, bool | np.bool_) or numbers is None:
            every = [{}] if numbers else []
        elif isinstance(numbers, Mapping):
            every = [cast(Numbers, numbers)]
        else:
            every = numbers
        found += [row.sentence.format_map(one) for one in every]
    return tuple(found)


def said_once(findings: Sequence[str]) -> tuple[str, ...]:
    """Combine sentences that differ only in numbers and in the channel before their colon."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for finding in findings:
        labelled = _LABELLED.fullmatch(finding)
        label, text = labelled.groups() if labelled else ("", finding)
        frame = _NUMBER.sub("\0", text) if label else finding
        groups.setdefault(frame, []).append((label, text))
    return tuple(_join(group) for group in groups.values())


def _join(group: list[tuple[str, str]]) -> str:
    label, text = group[0]
    if not label:
        return text
    if _CHANNEL.search(label):  # not the name of a file or of a parameter
        label = label[0].upper() + label[1:]
    columns = [_NUMBER.findall(text) for _, text in group]
    numbers = iter(
        own[0] if len(set(own)) == 1 else " / ".join(own) for own in zip(*columns, strict=True)
    )
    labels = " / ".join((label, *(other for other, _ in group[1:])))
    return f"{labels}: {_NUMBER.sub(lambda _: next(numbers), text)}"
