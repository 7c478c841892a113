"""Read photometric files of commercial lamps: IES LM-63 (1986 to 2019) and EULUMDAT.

- An `.ies` file may have type A, B or C, lengths in feet or metres, ballast factors, and absolute
  photometry (-1 lm). TILT may be NONE or INCLUDE. From an included table only the factor for an
  upright lamp is used.
- An `.ldt` file (EULUMDAT) may have any of the five symmetries. Only the first set of lamps is
  used.

Values that a file omits because of its stated symmetry are filled in. A round opening becomes a
square of the same area. Files with unusual line ends, commas, a byte order mark, or texts in
Latin-1, as some programs write them, are also read.
"""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..core._warnings import warn
from ..errors import InputError
from ..lights import Luminaire, flux, goniometric_light
from ..lights.goniometric import LUMINOUS_EFFICACY, System
from ._plain_content import check_size, file_at

FOOT = 0.3048  # m
MAX_ANGLES = 5000  # largest number of vertical or horizontal angles
RATIO = 0.05  # allowed deviation from a stated light output ratio, for a coarse grid of angles
MAX_OUTPUT = 1.2  # largest light output over the lamps' lumens, with a ballast's factor
MIN_OUTPUT = 0.05  # smallest light output over the lamps' lumens: snoots have more
EFFICACY = 1.0, 400.0  # lm W^-1, of any lamp: a weak filament behind glass, and beyond any LED
OPENING = 0.001, 10.0  # m, from which an opening seems to be in another unit
SAME = 0.02  # of the largest candela, between values that describe one direction
_BRIGHTEST = 1e9  # cd, the largest plausible intensity: a lighthouse has about 1e6
_SQUARE_SIDE = math.sqrt(math.pi / 4)


def read_luminaire(file: str | os.PathLike[str]) -> Luminaire:
    """Read the photometric file of a lamp.

    Args:
        file: an IES LM-63 file, or a EULUMDAT file, which ends in .ldt.

    Returns:
        The lamp's distribution of intensity, its opening and its other data.

    Raises:
        InputError: for a file of another kind, a truncated file, and angles or numbers that no lamp
            has.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import mkdtemp
        >>> file = Path(mkdtemp()) / "lamp.ies"
        >>> _ = file.write_text(
        ...     "IESNA:LM-63-2002\\n[LUMINAIRE] a downlight\\nTILT=NONE\\n"
        ...     "1 400 1 3 1 1 2 0.1 0.1 0\\n1 1 5\\n0 45 90\\n0\\n100 70 0\\n"
        ... )
        >>> lamp = jv.files.read_luminaire(file)
        >>> print(lamp.name, lamp.candela[:, 0])
        a downlight [100.  70.   0.]
    """
    path = file_at(file)
    check_size(path)
    data = path.read_bytes()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data[:64]:
        raise InputError(f"{path}: is no text; give an IES or EULUMDAT file.")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return _eulumdat(path, lines) if path.suffix.lower() == ".ldt" else _ies(path, lines)


class _Numbers:
    """Takes the numbers of a file in order, and checks them."""

    def __init__(self, path: Path, words: Sequence[str]) -> None:
        self.path, self.words, self.taken = path, words, 0

    def fail(self, why: str) -> NoReturn:
        raise InputError(f"{self.path}: {why}")

    def take(self, count: int, what: str) -> np.ndarray:
        words = self.words[self.taken : self.taken + count]
        if len(words) < count:
            self.fail(f"ends within {what}, after {len(words)} of {count} numbers; it is cut off.")
        self.taken += count
        try:
            found = np.array([float(word.replace("D", "E")) for word in words])
        except ValueError:
            wrong = next(word for word in words if not _is_number(word))
            self.fail(f"{what}: {wrong[:20]!r} is no number; correct it.")
        if not np.isfinite(found).all():
            self.fail(f"{what}: must be finite numbers; correct it.")
        return found

    def take_number(self, what: str, low: float = -math.inf, high: float = math.inf) -> float:
        value = float(self.take(1, what)[0])
        if not low <= value <= high:
            self.fail(f"{what} = {value:g}: must be from {low:g} to {high:g}; correct it.")
        return value

    def count(self, what: str, low: int, high: int = MAX_ANGLES) -> int:
        value = self.take_number(what, low, high)
        if value != round(value):
            self.fail(f"{what} = {value:g}: must be a whole number; correct it.")
        return int(value)

    def angles(self, count: int, what: str, low: float, high: float) -> np.ndarray:
        found = self.take(count, what)
        if np.any(np.diff(found) <= 0):
            self.fail(f"{what} must increase; correct them.")
        if found[0] < low or found[-1] > high:
            self.fail(
                f"{what} run from {found[0]:g} to {found[-1]:g} degrees, beyond {low:g} to "
                f"{high:g}; correct them."
            )
        return found

    def end(self) -> None:
        """Refuse a file that contains more numbers than needed. A decimal comma would split one
        number into two."""
        left = self.words[self.taken :]
        if left and _is_number(left[0]):
            self.fail(
                f"holds {len(left)} numbers more than its heads ask for; where numbers have "
                "decimal commas, write points, else correct its heads."
            )


def _is_number(word: str) -> bool:
    try:
        float(word.replace("D", "E"))
    except ValueError:
        return False
    return True


# ---------------------------------------------------------------- IES


def small_luminaire(candela: np.ndarray, vertical: np.ndarray, horizontal: np.ndarray) -> Luminaire:
    """Return a lamp without size from its intensities (vertical, horizontal), cd, at angles in
    rad."""
    return Luminaire(candela, vertical, horizontal, [0.0] * 3, np.nan, np.nan)


def _ies(path: Path, lines: list[str]) -> Luminaire:
    heads = [i for i, line in enumerate(lines) if line.strip().upper().startswith("TILT")]
    if not heads:
        raise InputError(f"{path}: has no line TILT=; it is no IES file, or its beginning is lost.")
    at = heads[0]
    tilt = lines[at].partition("=")[2].strip().upper()
    words = " ".join(lines[at + 1 :]).replace(",", " ").replace(";", " ").split()
    numbers = _Numbers(path, words)
    factor = 1.0
    if tilt == "INCLUDE":
        numbers.count("lamp to luminaire geometry", 1, 3)
        pairs = numbers.count("number of tilt angles", 1)
        angles = numbers.angles(pairs, "tilt angles", 0, 180)
        factor = float(np.interp(0, angles, numbers.take(pairs, "tilt factors")))
    elif tilt != "NONE":
        numbers.fail(f"TILT={tilt[:40]}: only NONE and INCLUDE are read; include the tilt factors.")
    lamps = numbers.take_number("number of lamps", 0, 1e6)
    lumens = numbers.take_number("lumens per lamp", -1, 1e10)
    factor *= numbers.take_number("candela multiplier", 0, 1e6)
    rows = numbers.count("number of vertical angles", 2)
    columns = numbers.count("number of horizontal angles", 1)
    system: System = ("C", "B", "A")[numbers.count("photometric type", 1, 3) - 1]
    unit = (FOOT, 1.0)[numbers.count("units type", 1, 2) - 1]
    width, length, height = unit * numbers.take(3, "luminous opening")
    factor *= numbers.take_number("ballast factor", 0, 1e3)
    further = numbers.take_number("ballast-lamp photometric factor", -math.inf, math.inf)
    first = lines[0].strip().upper()
    # later versions give the field another meaning
    if not first.startswith("IES") or "91" in first:
        factor *= further
    watts = numbers.take_number("input watts", 0, 1e7)
    ends = (0.0, 180.0) if system == "C" else (-90.0, 90.0)
    vertical = numbers.angles(rows, "vertical angles", *ends)
    turns = (-180.0, 360.0) if system == "C" else (-90.0, 90.0)
    horizontal = numbers.angles(columns, "horizontal angles", *turns)
    table = factor * numbers.take(rows * columns, "candela values").reshape(columns, rows).T
    numbers.end()
    if system == "C":
        _check_polar(numbers, vertical)
        _warn_of_contradictions(path, vertical, horizontal, table)
        horizontal, table = _whole_turn(numbers, horizontal, table)
    else:
        if columns > 1 and horizontal[0] == 0:
            horizontal, table = _mirror(horizontal, table)
        if system == "B" and vertical[0] == 0:
            vertical, across = _mirror(vertical, table.T)
            table = across.T
    if width < 0 and length == 0:  # a circle in LM-63-1995
        length = width
    round_one = _SQUARE_SIDE if width < 0 and length < 0 else 1.0
    opening = np.array([abs(length) * round_one, abs(width) * round_one, abs(height)])
    name = _keyword(lines[:at], "LUMINAIRE") or _keyword(lines[:at], "LUMCAT")
    total = math.nan if lumens < 0 else lamps * lumens
    return _lamp(numbers, table, vertical, horizontal, opening, total, watts, system, name)


def _keyword(lines: Sequence[str], word: str) -> str:
    for line in lines:
        if line.strip().upper().startswith(f"[{word}]"):
            return line.partition("]")[2].strip()
    return ""


def _check_polar(numbers: _Numbers, vertical: np.ndarray) -> None:
    if vertical[0] not in (0, 90) or vertical[-1] not in (90, 180):
        numbers.fail(
            f"vertical angles run from {vertical[0]:g} to {vertical[-1]:g} degrees, where a lamp "
            "of type C begins at 0 or 90 and ends at 90 or 180; add the angles that are missing."
        )


def _warn_of_contradictions(
    path: Path, vertical: np.ndarray, horizontal: np.ndarray, table: np.ndarray
) -> None:
    """Warn about values of one direction that differ: at the poles, and at 0 and 360 degrees."""
    cases = [
        (f"all planes at a vertical angle of {angle:g} degrees", table[row])
        for angle, row in ((vertical[0], 0), (vertical[-1], -1))
        if angle in (0, 180)
    ]
    if horizontal[-1] - horizontal[0] == 360:
        cases.append(("the planes at 0 and 360 degrees", table[:, [0, -1]].T))
    for which, values in cases:
        off = np.ptp(values, axis=0).max()
        if off > SAME * np.abs(table).max():
            warn(
                f"{path}: {which} describe the same direction, and differ by up to {off:.4g} cd; "
                "its angles or the order of its candela values are wrong."
            )


def _whole_turn(
    numbers: _Numbers, angles: np.ndarray, table: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Complete a type C lamp to 360 degrees, by the symmetry that its end angles imply."""
    if len(angles) == 1:
        return angles[:1], table
    ends = float(angles[0]), float(angles[-1])
    match ends:
        case (0.0, 90.0):
            return _fill_turn(angles, table, (0, 180))
        case (0.0, 180.0):
            return _fill_turn(angles, table, (0,))
        case (90.0, 270.0):
            return _fill_turn(angles, table, (180,))
    step = float(np.diff(angles).max())
    gap = 360 - (ends[1] - ends[0])
    if abs(gap) > 1e-6 and not 0 < gap <= 1.001 * step:
        numbers.fail(
            f"horizontal angles run from {ends[0]:g} to {ends[1]:g} degrees, where a lamp of type "
            "C has 0 to 90, 180 or 360, or 90 to 270; add the angles that are missing."
        )
    return _fill_turn(angles, table, ())


def _fill_turn(
    angles: np.ndarray, table: np.ndarray, mirrors: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Complete the angles h to 360 degrees, by adding m - h for each m in `mirrors`."""
    for mirror in mirrors:
        angles = np.concatenate([angles, mirror - angles])
        table = np.concatenate([table, table], axis=1)
    turned, places = np.unique(np.round(angles % 360, 6) % 360, return_index=True)
    table = table[:, places]
    return np.append(turned, turned[0] + 360), np.concatenate([table, table[:, :1]], axis=1)


def _mirror(angles: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Extend columns to negative angles: the value at -h equals the value at h."""
    whole = np.concatenate([table[:, :0:-1], table], axis=1)
    return np.concatenate([-angles[:0:-1], angles]), whole


def _lamp(
    numbers: _Numbers,
    table: np.ndarray,
    vertical: np.ndarray,
    horizontal: np.ndarray,
    opening: np.ndarray,
    lumens: float,
    watts: float,
    system: System,
    name: str,
    stated: float = 0.0,
) -> Luminaire:
    """Make the luminaire, if plausible. `stated`: light output ratio, per cent; 0 for none."""
    if table.min() < 0 or table.max() > _BRIGHTEST:
        numbers.fail(
            f"candela values run from {table.min():g} to {table.max():g} cd, where a lamp has 0 to "
            f"{_BRIGHTEST:g}; correct them or their multiplier."
        )
    if not table.any():
        numbers.fail("all candela values are 0: such a lamp is dark; correct them.")
    if np.abs(opening).max() > 100:
        numbers.fail(f"its luminous opening is {opening.max():g} m wide; correct it or its units.")
    angles = np.radians(vertical), np.radians(horizontal)
    lamp = Luminaire(table, *angles, opening, lumens, watts, system=system, name=name)
    leaves = LUMINOUS_EFFICACY * float(flux(goniometric_light(lamp, [0.0, 0.0, 0.0]))[0])
    widest = float(np.abs(opening).max())
    if widest > OPENING[1] or 0 < widest < OPENING[0]:
        warn(
            f"{numbers.path}: its luminous opening is {widest:.3g} m wide, as if its size were in "
            "another unit (EULUMDAT has millimetres, IES feet or metres); correct it."
        )
    if leaves > MAX_OUTPUT * lumens or leaves < MIN_OUTPUT * lumens:
        warn(
            f"{numbers.path}: {leaves:.4g} lm leave a luminaire whose lamps give {lumens:.4g} lm; "
            "its candela values, their multiplier or the lamps' lumens are wrong."
        )
    elif stated and abs(100 * leaves / lumens - stated) > RATIO * stated:
        warn(
            f"{numbers.path}: states a light output ratio of {stated:g} % (line 23), and its "
            f"intensities send {100 * leaves / lumens:.3g} % of its lamps' {lumens:.4g} lm; one of "
            "them is wrong."
        )
    elif watts > 0 and not EFFICACY[0] <= leaves / watts <= EFFICACY[1]:
        warn(
            f"{numbers.path}: {leaves:.4g} lm leave a luminaire of {watts:.4g} W, "
            f"{leaves / watts:.2g} lm/W; its candela values, their multiplier, the lamps' lumens "
            "or its watts are wrong."
        )
    return lamp


# ---------------------------------------------------------------- EULUMDAT


def _eulumdat(path: Path, lines: list[str]) -> Luminaire:
    while lines and not lines[-1].strip():
        lines = lines[:-1]
    if len(lines) < 28:
        raise InputError(f"{path}: has {len(lines)} lines, too few for EULUMDAT; it is cut off.")

    def line_numbers(line: int) -> _Numbers:
        return _Numbers(path, [lines[line - 1].strip().replace(",", ".")])

    symmetry = line_numbers(3).count("symmetry (line 3)", 0, 4)
    planes = line_numbers(4).count("number of C planes (line 4)", 1)
    rows = line_numbers(6).count("number of angles (line 6)", 2)
    size = [line_numbers(i).take_number(f"line {i}", 0, 1e5) / 1000 for i in (16, 17, 18)]  # m
    ratio = line_numbers(23).take_number("light output ratio (line 23)", 0, 1e4)
    factor = line_numbers(24).take_number("conversion factor (line 24)", 0, 1e6)
    if tilt := line_numbers(25).take_number("tilt (line 25)", -360, 360):
        warn(
            f"{path}: was measured at a tilt of {tilt:g} degrees (line 25), which is not used; "
            "turn the light by it where the intensities are those of the tilted luminaire."
        )
    sets = line_numbers(26).count("number of lamp sets (line 26)", 1, 20)
    start = 26 + 6 * sets
    flux_line, watts_line = _first_lamp_set(path, lines[26:start], sets)
    if len(lines) < start + 10:
        raise InputError(f"{path}: ends within its sets of lamps; it is cut off.")
    lumens = line_numbers(flux_line).take_number("flux of the lamps", 0, 1e10)
    watts = line_numbers(watts_line).take_number("power of the lamps", 0, 1e7)
    words = [line.strip().replace(",", ".") for line in lines[start + 10 :] if line.strip()]
    numbers = _Numbers(path, words)
    turns = numbers.angles(planes, "C planes", 0, 360)
    vertical = numbers.angles(rows, "angles", 0, 180)
    _check_polar(numbers, vertical)
    first, kept = {
        0: (0, planes),
        1: (0, 1),
        2: (0, planes // 2 + 1),
        3: (3 * planes // 4, planes // 2 + 1),
        4: (0, planes // 4 + 1),
    }[symmetry]
    if kept > planes or (symmetry > 1 and planes % 4):
        numbers.fail(f"symmetry {symmetry} needs a multiple of 4 C planes, got {planes}.")
    table = numbers.take(rows * kept, "intensities").reshape(kept, rows).T
    numbers.end()
    table = table * (factor * lumens / 1000)
    if symmetry == 1:
        horizontal = turns[:1]
    else:
        own = turns[(first + np.arange(kept)) % planes]
        mirrors = {0: (), 2: (0,), 3: (180,), 4: (0, 180)}[symmetry]
        horizontal, table = _fill_turn(own, table, mirrors)
    length, width, height = size
    if width == 0:  # round
        length = width = length * _SQUARE_SIDE
    opening = np.array([width, length, height])
    name = lines[8].strip()
    return _lamp(numbers, table, vertical, horizontal, opening, lumens, watts, "C", name, ratio)


def _first_lamp_set(path: Path, lines: Sequence[str], sets: int) -> tuple[int, int]:
    """Return the line numbers of the lumens and watts of the first lamp set. The standard stores
    the sets field by field, but many programs store them set by set. The fields of a set are its
    number of lamps, type, lumens, colour, colour rendering and watts."""

    def holds_numbers(stride: int, step: int) -> bool:
        places = [field * stride + one * step for field in (0, 2, 5) for one in range(sets)]
        return all(_is_number(lines[i].strip().replace(",", ".")) for i in places)

    if len(lines) < 6 * sets or holds_numbers(sets, 1):
        return 27 + 2 * sets, 27 + 5 * sets
    if holds_numbers(1, 6):
        return 29, 32
    raise InputError(
        f"{path}: the {sets} sets of lamps (line 27 on) have no numbers where their counts, lumens "
        "and watts are due; correct them."
    )
