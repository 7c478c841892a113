"""Read TOML files and check them against a schema; the first mistake is reported in one sentence.

The sentence names the file, the table with its own `name`, and the key. For a misspelt key or word,
the sentence suggests the nearest known key or word. The models of a schema are its documentation.
"""

import os
import re
import tomllib
from collections.abc import Mapping
from inspect import signature
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import InputError, nearest, plain_text, shorten
from ._plain_content import DEEPEST, check_content, check_size, file_at

# A number and its unit, as in `exposure = 0.5 ms`.
_WITH_UNIT = re.compile(
    r"\s*[\w.\"-]+\s*=\s*[-+]?[\d._]+(?:e[-+]?\d+)?\s*([^\W\d_]+|%)[^#=]*(?:#.*)?"
)
# The beginning of a key of more parts than tables may be nested, which costs the parser gigabytes.
_LONG_KEY = re.compile(
    r"(?:^[ \t]*\[{0,2}|[{,])[ \t]*+"
    rf"(?:(?:[A-Za-z0-9_-]++|\"[^\"\n]*+\"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{DEEPEST}}}",
    re.MULTILINE,
)


class Entry(BaseModel):
    """Base of the models for the tables of a file. A key that is not in the schema is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Show `float` without its range in `help`, because the attributes state the range."""
        plain = get_type_hints(cls)
        whole = signature(cls)
        said = [x.replace(annotation=plain[x.name]) for x in whole.parameters.values()]
        cls.__signature__ = whole.replace(parameters=said)


# strict: strings and booleans are not numbers
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(strict=True, ge=0, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
Count = Annotated[int, Field(strict=True, ge=1, lt=2**31)]

Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: str | os.PathLike[str], kind: str) -> dict[str, Any]:
    """Read the tables of a TOML file by name. `kind` is the expected kind of file, such as "scene".
    `InputError` is raised if the file is missing or is not TOML."""
    file = file_at(path, kind)
    check_size(file)
    text = ""
    try:
        text = plain_text(file)
        if found := _LONG_KEY.search(text):
            line = text.count("\n", 0, found.end()) + 1
            raise InputError(f"{file}: line {line} has a key of more than {DEEPEST} parts.")
        content = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{file}: is nested more than {DEEPEST} deep; flatten it.") from None
    except InputError:
        raise
    except ValueError as error:  # not TOML, or a number of thousands of digits
        stopped = re.search(r"at line (\d+)", str(error))
        line = text.splitlines()[int(stopped[1]) - 1] if stopped else ""
        if with_unit := _WITH_UNIT.fullmatch(line):
            raise InputError(
                f"{file}: {line.strip()[:60]!r} has a unit, {with_unit[1]}; give the number alone, "
                "in the file's own unit (s, m, W)."
            ) from error
        raise InputError(f"{file}: not a TOML file ({error}); correct that line.") from error
    check_content(str(file), content)
    return content


def checked(
    path: str | os.PathLike[str],
    content: Mapping[str, Any],
    schema: type[Model],
    kind: str,
    *,
    first: int = 1,
    called: Mapping[str, str] | None = None,
) -> Model:
    """Return the content of a file as an instance of its schema; `InputError` for the first
    mistake. The error message counts the items of arrays from `first`. `called` maps a location to
    the name that the message uses, such as {"flat.exposure": "exposures"}."""
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise InputError(
            f"{path}: {_first_mistake(error, content, schema, kind, first, called or {})}."
        ) from error


def _first_mistake(
    error: ValidationError,
    content: Mapping[str, Any],
    schema: type[BaseModel],
    kind: str,
    first: int,
    called: Mapping[str, str],
) -> str:
    mistakes = error.errors()
    unknown = [mistake for mistake in mistakes if mistake["type"] == "extra_forbidden"]
    mistake = (unknown or mistakes)[0]  # a misspelt key also leaves another one missing
    context = mistake.get("ctx", {})
    missing = mistake["type"] == "missing"
    place = _place(mistake["loc"], content, missing, first)
    where = _call_lists(place, called) or "the file"
    reason = mistake["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    match mistake["type"]:
        case "missing":
            return f"{where} is missing; add it"
        case "extra_forbidden":
            key = str(mistake["loc"][-1])
            hint = nearest(key, _known_keys(schema, mistake["loc"][:-1]))
            return f"{where} is not a key of a {kind} file; {hint}"
        case "too_short" | "too_long" if context.get("field_type") == "Tuple":
            short = mistake["type"] == "too_short"
            end = f"least {context['min_length']}" if short else f"most {context['max_length']}"
            return f"{where} lists {context['actual_length']}; give at {end}"
        case "value_error":
            return f"{where}: {reason}"
        case "literal_error":
            known = context["expected"].replace(" or ", ", ").split(", ")
            hint = nearest(str(mistake["input"]), [word.strip("'") for word in known])
            return f"{where} = {shorten(mistake['input'])} is unknown; {hint}"
        case "tuple_type" if isinstance(mistake["input"], dict):
            return f"{where} is one of several tables; head it [[{where}]]"
        case "model_type" | "model_attributes_type" | "dict_type":
            return f"{where} must be a table; head it [{where}] or write it in braces"
    return f"{where} = {shorten(mistake['input'])}: {reason[:1].lower()}{reason[1:]}"


def _place(loc: tuple[int | str, ...], content: Any, missing: bool, first: int) -> str:
    """Return the text of a location, such as `surface "left wall".corner`, without unions."""
    place, node = "", content
    for part in loc:
        if isinstance(node, list) and isinstance(part, int) and part < len(node):
            node = node[part]
            name = node.get("name") if isinstance(node, dict) else None
            place += f' "{name}"' if isinstance(name, str) else f"[{part + first}]"
        elif isinstance(node, dict) and part in node:
            node = node[part]
            place += f".{part}"
    if missing:
        last = loc[-1]
        place += f"[{last + first}]" if isinstance(last, int) else f".{last}"
    return place.lstrip(".")


def _call_lists(place: str, called: Mapping[str, str]) -> str:
    """Replace `flat[0].exposure` by `exposures[0]` for {"flat.exposure": "exposures"}."""
    within = re.match(r"(\w+)(\[\d+\])\.(\w+)", place)
    name = called.get(f"{within[1]}.{within[3]}") if within else None
    return f"{name}{within[2]}{place[within.end() :]}" if within and name else place


def _known_keys(schema: type[BaseModel], loc: tuple[int | str, ...]) -> set[str]:
    """Return the known keys of the table at a location."""
    models = [schema]
    for part in loc:
        within = [m.model_fields[part].annotation for m in models if part in m.model_fields]
        models = [m for kind in within for m in _models(kind)] if within else models
    return {key for model in models for key in model.model_fields}


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Return the models inside a type annotation, such as a union or a tuple."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]
