"""What is wrong with a config, in one line: field, value, what is allowed. For every model that people write."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

VALUE_MAX = 80
"""Longer values are not shown."""
ALTERNATIVE = "|"
"""What the tags of a union begin with: they are no part of a field's name."""


def one_line(error: ValidationError, model: type[BaseModel]) -> str:
    """The first thing that is wrong with a `model`, and how many more there are."""
    first, *others = lines(error, model)
    return f"{first} (and {len(others)} more)" if others else first


def lines(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """All that is wrong with a `model`, one line each; unknown keys first, since what is missing may be behind them."""
    details = sorted(error.errors(), key=lambda detail: detail["type"] != "extra_forbidden")
    return [_line(detail, model) for detail in details]


def _line(detail: ErrorDetails, model: type[BaseModel]) -> str:
    field = ".".join(str(part) for part in detail["loc"] if not str(part).startswith(ALTERNATIVE))
    if detail["type"] == "extra_forbidden":
        return f"{field}: unknown key, {_nearest(str(detail['loc'][-1]), _keys_at(model, detail['loc'][:-1]))}"
    if detail["type"] == "missing":
        return f"{field}: missing"
    message = detail["msg"].removeprefix("Value error, ")
    if detail["type"] == "value_error":
        # Validators of whole sections begin with the name of the field that they mean.
        of_section = isinstance(detail["input"], Mapping | BaseModel)
        return f"{field}{'.' if field and of_section else ': ' if field else ''}{message}"
    value = repr(detail["input"])
    if len(value) > VALUE_MAX:
        value = "..."
    message = message.replace("a valid tuple", "a list")  # as YAML and JSON call it
    return f"{f'{field}: ' if field else ''}{value} is not allowed: {message[:1].lower()}{message[1:]}"


def _keys_at(model: type[BaseModel], parents: tuple[int | str, ...]) -> list[str]:
    for part in parents:
        field = model.model_fields.get(str(part))
        model = next(_models_in(field.annotation), model) if field is not None else model
    return [*getattr(model, "SHORTHANDS", ()), *model.model_fields]


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    """Models that a field may hold, e.g. that of `Section | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def _nearest(key: str, known: list[str]) -> str:
    """What somebody who wrote `key` may have meant; all there is when nothing is like it."""
    near = get_close_matches(key, known)
    return f"did you mean {' or '.join(near)}?" if near else f"allowed are {', '.join(known)}"
