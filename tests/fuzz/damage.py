"""Damage files by changing, removing, doubling and moving bytes, lines and numbers."""

import re

import numpy as np

NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
NUMBERS = (
    b"0 -0.0 1 -1 2 3000000000 99999999999999999999999 1e-16 1e-28 1e30 1e39 1e308 1e309 -1e39 "
    b"nan inf -inf 0.5 1e-45 255 256 65536 2147483647 4294967296"
).split()
# what follows `=` or `:` in TOML, JSON and XML, and replacements for it
VALUE = re.compile(rb"""(?<=[=:]) *("[^"\n]*"|\[[^\]\n]*\]|[^\s,\]}>"]+)""")
VALUES = (
    b'"" "nan" "-1" "0" "text" "1,2" true false [] [1] [nan,0,1] [0,0,0] [[1,2],[3]] {} null '
    b'1979-05-27 0x7fffffffffffffff [1e30,1e30,1e30] [-1,-1,-1] [0.5,0.5,0.5,0.5] "1e39" 7'
).split()
BYTES = (0x00, 0xFF, 0x7F, 0x80, 0x0A, 0x20, 0x22, 0x5B)


def damaged(content: bytes, rng: np.random.Generator, *, text: bool, most: int = 4) -> bytes:
    """Return `content` after one to `most` changes."""
    for _ in range(rng.integers(1, most + 1)):
        change = rng.choice(TEXT_CHANGES if text and rng.uniform() < 0.8 else BYTE_CHANGES)
        content = change(content, rng)
    return content


def _byte(content, rng):
    if not content:
        return bytes([rng.integers(256)])
    place = rng.integers(min(len(content), 400) if rng.uniform() < 0.7 else len(content))
    value = rng.choice(BYTES) if rng.uniform() < 0.5 else rng.integers(256)
    return content[:place] + bytes([value]) + content[place + 1 :]


def _cut(content, rng):
    return content[: rng.integers(len(content) + 1)]


def _slice(content, rng):
    start, end = np.sort(rng.integers(len(content) + 1, size=2))
    return content[:start] + content[min(end, start + 40) :]


def _doubled(content, rng):
    start, end = np.sort(rng.integers(len(content) + 1, size=2))
    return content[:end] + content[start : min(end, start + 40)] + content[end:]


def _noise(content, rng):
    place = rng.integers(len(content) + 1)
    return content[:place] + rng.bytes(rng.integers(1, 9)) + content[place:]


def _number(content, rng):
    found = list(NUMBER.finditer(content))
    if not found:
        return content
    one = found[rng.integers(len(found))]
    return content[: one.start()] + NUMBERS[rng.integers(len(NUMBERS))] + content[one.end() :]


def _scaled(content, rng):
    """Replace a number by one of another size, in the range that files contain."""
    found = list(NUMBER.finditer(content))
    if not found:
        return content
    one = found[rng.integers(len(found))]
    new = b"%.6g" % (float(one.group()) * 10 ** rng.uniform(-2, 2) * rng.choice((1, 1, 1, -1)))
    return content[: one.start()] + new + content[one.end() :]


def _value(content, rng):
    """Replace a value by another, or by that of another key."""
    found = list(VALUE.finditer(content))
    if not found:
        return content
    one, other = (found[k] for k in rng.integers(len(found), size=2))
    new = VALUES[rng.integers(len(VALUES))] if rng.uniform() < 0.6 else other.group(1)
    return content[: one.start(1)] + new + content[one.end(1) :]


def _line(content, rng):
    lines = content.split(b"\n")
    i, j = rng.integers(len(lines), size=2)
    match rng.integers(4):
        case 0:
            del lines[i]
        case 1:
            lines.insert(i, lines[j])
        case 2:
            lines[i], lines[j] = lines[j], lines[i]
        case _:
            words = lines[i].split(b" ")
            del words[rng.integers(len(words))]
            lines[i] = b" ".join(words)
    return b"\n".join(lines)


BYTE_CHANGES = (_byte, _byte, _cut, _slice, _doubled, _noise)
TEXT_CHANGES = (_number, _scaled, _value, _value, _line, _byte)
