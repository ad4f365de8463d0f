"""Records: frozen, typed data that is checked as it is made, and whose mistakes are one sentence each.

Whatever a person writes down (options, configurations, cards) is a record. Its fields state type and range;
from these come the check, the sentence that names field, value and what is allowed, and the options of the
command line.
"""

from __future__ import annotations

import re
import types
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self, TypeVar, Union, get_args, get_origin

import annotated_types
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from robosim.errors import InputError, nearest_names, refused, shown

_Item = TypeVar("_Item")
_LONGEST_KEY = 60
"""Characters of a field's name as mistakes print it."""

Many = Annotated[tuple[_Item, ...], Field(strict=False)]
"""A tuple that may also be given as a list, as files have it."""


class Option(NamedTuple):
    """A field of a record, or of one nested in it."""

    path: tuple[str, ...]
    """Names of the fields that lead to it, its own last."""
    field: FieldInfo

    @property
    def help(self) -> str:
        """What the field means."""
        return self.field.description or ""


class Record(BaseModel):
    """Base of all records. Raises InputError, in one sentence, for a field that is unknown or wrong."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )
    short_names: ClassVar[Mapping[str, str]] = {}
    """Short names of fields when the record is nested in another, where they are not FIELD_OWN-NAME."""
    plain_options: ClassVar[bool] = False
    """Whether the fields of nested records go by their own names where `short_names` says nothing else."""

    def __init__(self, /, **values: Any) -> None:
        plain = {name: _plain(value) for name, value in values.items()}
        try:
            super().__init__(**plain)
        except ValidationError as error:
            raise InputError(sentence(type(self), error)) from None

    # So that pydantic checks nested records itself and reports where in the whole a mistake is.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def from_table(cls, table: Mapping[str, Any], place: str) -> Self:
        """Return the record that a parsed file holds; errors begin with `place`, the file's name."""
        try:
            return cls.model_validate(table)
        except ValidationError as error:
            raise InputError(f"{place}: {sentence(cls, error)}") from None

    def changed(self, **values: Any) -> Self:
        """Return a copy with other values in some fields, checked anew."""
        return type(self)(**({name: getattr(self, name) for name in type(self).model_fields} | values))

    @classmethod
    def options(cls) -> dict[str, Option]:
        """Return every field, those of nested records too, by its short name."""
        return dict(_options(cls, ()))

    def own_options(self) -> dict[str, Option]:
        """Return `options` of this record as it is, with the fields of the classes that its records have."""
        return dict(_options(type(self), (), self))

    def require_options(self, names: Iterable[str]) -> None:
        """Raise InputError for a name that `with_options` does not know."""
        known = {*self.own_options(), *filter(self._holds_record, type(self).model_fields)}
        for name in names:
            if name not in known:
                raise InputError(f"{shown(name)} is not an option: {nearest_names(name, known)}")

    def _holds_record(self, name: str) -> bool:
        """Return whether a field is, or may be, a record."""
        field = type(self).model_fields[name]
        return isinstance(getattr(self, name), Record) or _record_in(field.annotation) is not None

    def with_options(self, **values: Any) -> Self:
        """Return a copy with other values in the fields of these short names, checked anew.

        A nested record may also be given whole, by the name of its field.
        """
        self.require_options(values)
        known, fields = self.own_options(), type(self).model_fields
        whole = {
            name: value for name, value in values.items() if name in fields and isinstance(value, Record)
        }
        nested: dict[str, Any] = {}
        for name in (name for name in values if name not in whole):
            if name not in known:
                raise refused(name, values[name], f"a {type(getattr(self, name)).__name__}")
            *outer, own = known[name].path
            inner = nested
            for step in outer:
                inner = inner.setdefault(step, {})
            inner[own] = values[name]
        base = self.changed(**whole) if whole else self
        return type(self)(**base._with(nested))

    def _with(self, nested: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields, those in `nested` replaced; a record in which one changes becomes a table."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        for name, value in nested.items():
            before = values[name]
            inside = isinstance(before, Record) and isinstance(value, dict)
            values[name] = before._with(value) if inside else value
        return values


def _plain(value: object) -> object:
    """Return numpy's scalars as Python's: strict checks know those alone."""
    return value.item() if isinstance(value, np.generic) else value


def _options(
    model: type[Record], path: tuple[str, ...], record: Record | None = None
) -> Iterator[tuple[str, Option]]:
    for name, field in model.model_fields.items():
        value = getattr(record, name, None)
        nested = type(value) if isinstance(value, Record) else _record_in(field.annotation)
        if nested is not None:
            for inner, option in _options(nested, (*path, name), value):
                own = option.path[-1] if len(option.path) == len(path) + 2 else None
                plain = inner if model.plain_options else f"{name}_{inner}"
                short = nested.short_names.get(inner, plain) if own else inner
                yield short, option
        else:
            yield name, Option((*path, name), field)


def _record_in(annotation: Any) -> type[Record] | None:
    """Return the record that a field holds, by itself or where it may also be None."""
    parts = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    kinds = [part for part in parts if part is not type(None)]
    return (
        kinds[0] if len(kinds) == 1 and isinstance(kinds[0], type) and issubclass(kinds[0], Record) else None
    )


def sentence(model: type[BaseModel], error: ValidationError) -> str:
    """Return the first of pydantic's errors in our words: field, value, and what is allowed."""
    first = error.errors()[0]
    return _sentence(model, first)


def _sentence(model: type[BaseModel], error: ErrorDetails) -> str:
    keys = [part for part in error["loc"] if isinstance(part, str)]
    # Keys of a stranger's file must not steer a terminal.
    names = [key if key.isprintable() and len(key) <= _LONGEST_KEY else shown(key) for key in keys]
    place, owner, field = ".".join(names), model, None
    described = error["msg"]
    for key in keys:
        field = owner.model_fields.get(key)
        if field is None:
            break
        if get_origin(field.annotation) is dict and key is not keys[-1]:
            # What follows are keys of the table itself.
            described, field = _allowed(get_args(field.annotation)[1], []), None
            break
        described = allowed(field)
        owner = _model_in(field.annotation) or owner
    if error["type"] == "extra_forbidden":
        table = f" of {'.'.join(names[:-1])}" if len(keys) > 1 else ""
        return f"{shown(keys[-1])} is not an option{table}: {nearest_names(keys[-1], owner.model_fields)}"
    if error["type"] == "missing":
        return f"{place} is missing" + (f"; it must be {allowed(field)}." if field else ".")
    value = error["input"]
    if error["type"] == "value_error":
        text = error["msg"].removeprefix("Value error, ").rstrip(".")
        return f"{place + ': ' if place else ''}{text}" + ("" if text.endswith("?") else ".")
    return str(refused(place, value, described))


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model that a field holds, by itself, in a list, or where it may also be None."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_in, get_args(annotation))), None)


def allowed(field: FieldInfo) -> str:
    """Return in words which values a field takes."""
    return _allowed(field.annotation, field.metadata)


def _allowed(annotation: Any, metadata: list[Any]) -> str:
    while get_origin(annotation) is Annotated:
        annotation, *inner = get_args(annotation)
        metadata = [*inner, *metadata]
    metadata = [part for one in metadata for part in (one.metadata if isinstance(one, FieldInfo) else [one])]
    origin = get_origin(annotation)
    if origin in (Union, types.UnionType):
        return " or ".join(
            "None" if part is type(None) else _allowed(part, metadata) for part in get_args(annotation)
        )
    if origin is Literal:
        return " or ".join(shown(value) for value in get_args(annotation))
    if origin is tuple:
        return f"a list of {_lengths(metadata)}{_plural(annotation)}"
    if origin is dict:
        most = _first(metadata, annotated_types.MaxLen)
        return "a table" + (f" of at most {most.max_length} entries" if most else "")
    if annotation is bool:
        return "true or false"
    if annotation in (int, float):
        kind = "a whole number" if annotation is int else "a number"
        return kind + _bounds(metadata)
    if annotation is str:
        longest = _first(metadata, annotated_types.MaxLen)
        return "a text" + (f" of at most {longest.max_length} characters" if longest else "")
    return "a table"


def _plural(annotation: Any) -> str:
    item = _allowed(get_args(annotation)[0], [])
    # Of its words the first noun takes the plural: a whole number from 1 to 9, a list of texts.
    return re.sub("(number|list|text|table)", r"\1s", item.removeprefix("a "), count=1)


def _lengths(metadata: list[Any]) -> str:
    low, high = _first(metadata, annotated_types.MinLen), _first(metadata, annotated_types.MaxLen)
    if low is not None and high is not None and low.min_length == high.max_length:
        return f"{high.max_length} "
    return f"{low.min_length if low else 0} to {high.max_length} " if high is not None else ""


def _bounds(metadata: list[Any]) -> str:
    low, high = _first(metadata, annotated_types.Ge), _first(metadata, annotated_types.Le)
    over, under = _first(metadata, annotated_types.Gt), _first(metadata, annotated_types.Lt)
    parts = []
    if low is not None:
        parts.append(f" from {_figure(low.ge)}")
    if over is not None:
        parts.append(f" above {_figure(over.gt)}")
    if high is not None:
        parts.append(f" to {_figure(high.le)}" if low is not None else f" of at most {_figure(high.le)}")
    if under is not None:
        parts.append(f" below {_figure(under.lt)}")
    return " and".join(parts) if over is not None else "".join(parts)


def _figure(number: Any) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"


def _first(metadata: list[Any], kind: type[_Item]) -> _Item | None:
    return next((one for one in metadata if isinstance(one, kind)), None)
