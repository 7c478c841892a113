"""Findings of several channels, said once."""

import re
from collections.abc import Sequence

from .colours import OF_CHANNEL

_LABELLED = re.compile(r"([\w ]{1,24}): (.+)", re.DOTALL)
_CHANNEL = re.compile(rf"(?<!\w)(?:{'|'.join(OF_CHANNEL)})$")
_NUMBER = re.compile(r"(?<![\w.])[-+−]?\d[\d.,]*(?:e[-+]?\d+)?(?<![.,])")


def said_once(findings: Sequence[str]) -> tuple[str, ...]:
    """Sentences that differ in the channel before their colon and in numbers alone, as one.

    Args:
        findings: such as "red: 290 samples are saturated." and "blue: 12 samples are saturated."

    Returns:
        The findings in the order of their first mention, such as "Red / blue: 290 / 12 samples are
        saturated."
    """
    groups: dict[str, list[tuple[str, str]]] = {}
    for finding in findings:
        labelled = _LABELLED.fullmatch(finding)
        label, text = labelled.groups() if labelled else ("", finding)
        frame = _NUMBER.sub("\0", text) if label else finding
        groups.setdefault(frame, []).append((label, text))
    return tuple(_joined(group) for group in groups.values())


def _joined(group: list[tuple[str, str]]) -> str:
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
