"""From what pydantic finds to one sentence that names the key."""

import difflib
import re
import typing
from contextlib import contextmanager
from dataclasses import dataclass

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from pymc_features.exceptions import ConfigError, DatasetUnavailableError

LONGEST = 600  # characters of a message, which may quote the name of a file
TAGS = ("union_tag_invalid", "union_tag_not_found")


@dataclass
class Place:
    """Place of an error in the file.

    Attributes
    ----------
    path : str
        Keys joined by dots.
    field : FieldInfo or None
        Of the last key.
    sections : list of type
        Those that may own the last key.
    entry : str
        Which entry of a table of plain values, whose names the user chose.
    """

    path: str
    field: FieldInfo | None
    sections: list[type[BaseModel]]
    entry: str = ""


def sentence(error: ValidationError, raw: dict, model: type[BaseModel]) -> str:
    """The first error in words, and how many other places have one."""
    found = error.errors(include_url=False)
    places = [place(e, raw, model) for e in found]
    more = len({p.path for p in places}) - 1
    first = words(found[0], places[0])
    return f"{first} ({more} more after this one.)" if more else first


def words(error, at: Place) -> str:
    """One error: "`key` must be ..., got ..."."""
    kind = error["type"]
    if kind == "extra_forbidden":
        return unknown_key(at)
    if kind == "missing":
        return f"`{at.path}` must be given: {meaning(at)}."
    if kind in TAGS:
        given = error["input"]
        type_ = given.get("type") if isinstance(given, dict) else given
        got = "none" if type_ is None else shown(type_)
        return f"`{at.path}.type` must be one of {', '.join(types_of(at))}, got {got}."
    if kind == "value_error":
        return f"`{at.path}` {error['ctx']['error']}."
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"`{at.path}` must be a table, got {shown(error['input'])}."
    whole = re.sub(r"\[\d+\]$", "", at.path)  # the words are those of the list
    where = f" for {at.entry}" if at.entry else ""
    return f"`{whole}` must be {meaning(at)}, got {shown(error['input'])}{where}."


def meaning(at: Place) -> str:
    """What a key must be."""
    if at.field is not None and at.field.description:
        return at.field.description
    return "of another kind"


def unknown_key(at: Place) -> str:
    """An unknown key, with the nearest known one."""
    known = list(dict.fromkeys(name for section in at.sections for name in section.model_fields))
    close = difflib.get_close_matches(at.path.rpartition(".")[2], known, n=1)
    hint = f"Did you mean `{close[0]}`?" if close else f"Known here: {', '.join(known)}."
    return f"`{at.path}` must be left out, it is no key. {hint}"


def types_of(at: Place) -> list[str]:
    """What the key `type` of a table may be."""
    sections = sections_in(at.field.annotation)
    return [name for s in sections for name in typing.get_args(s.model_fields["type"].annotation)]


def place(error, raw: dict, model: type[BaseModel]) -> Place:
    """Find an error in the file.

    Its location also has tags of unions ("SpringMassChain") and names of types ("list[str]"), which are no
    keys: only what the file holds is followed, or a key that is missing there.
    """
    node, at = raw, Place("", None, [model])
    sections, is_table = [model], False
    for number, part in enumerate(error["loc"]):
        held = (isinstance(node, dict) and part in node) or (
            isinstance(node, list) and isinstance(part, int) and part < len(node)
        )
        if not held and not (error["type"] == "missing" and number == len(error["loc"]) - 1):
            continue
        node = node[part] if held else None
        if isinstance(part, int):
            at = Place(f"{at.path}[{part}]", at.field, at.sections)
            continue
        path = f"{at.path}.{part}" if at.path else str(part)
        if is_table:  # a name that the user chose
            at, is_table = Place(path, None, sections), False
            continue
        owners = sections
        if not owners:  # a name that the user chose, in a table of plain values
            at = Place(at.path, at.field, at.sections, str(part)[:80])
            continue
        field = next((s.model_fields[part] for s in owners if part in s.model_fields), None)
        at = Place(path, field, owners)
        sections = [] if field is None else sections_in(field.annotation)
        is_table = bool(sections) and typing.get_origin(field.annotation) is dict
        if isinstance(node, dict) and "type" in node:
            named = [s for s in sections if is_called(s, node["type"])]
            sections = named or sections
    return at


def is_called(section, name) -> bool:
    """Whether the key `type` of a section may be this name."""
    field = section.model_fields.get("type")
    return field is not None and name in typing.get_args(field.annotation)


def sections_in(annotation) -> list[type[BaseModel]]:
    """All sections in a type, unions and tables looked through."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [section for part in typing.get_args(annotation) for section in sections_in(part)]


def shown(value) -> str:
    """A value as the file has it, short."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


#: What samplers ask for, and the keys of the file that do it: draws decide on the draws of a stage.
ARGUMENTS = {
    "`draws` and `stage_draws`": "`sampler.draws`",
    "`draws` or `stage_draws`": "`sampler.draws`",
    "`stage_draws`": "`sampler.draws`",
    "`runs`": "`external.emulate`",
    "sample with sample_smc()": "leave out `external.emulate`",
}


def with_keys(text: str) -> str:
    """What a sampler says, with keys of the file in place of its arguments."""
    for argument, name in ARGUMENTS.items():
        text = text.replace(argument, name)
    return text


@contextmanager
def named_key(key: str, **renamed: str):
    """Errors inside get the section `key` in front, and the keys for arguments that are `renamed`."""
    try:
        yield
    except (ConfigError, DatasetUnavailableError):
        raise
    except (ValueError, TypeError, OSError) as error:
        text = str(error)
        text = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
        for argument, name in renamed.items():
            text = text.replace(f"`{argument}`", f"`{name}`")
        raise ConfigError(f"[{key}]: {text}") from error
