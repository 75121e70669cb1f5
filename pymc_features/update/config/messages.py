"""From what pydantic and libraries refuse to one sentence that names the key."""

import re
from contextlib import contextmanager

from pydantic import ValidationError

from pymc_features.exceptions import ConfigError, DatasetUnavailableError
from pymc_features.update.config.keys import Schema

LONGEST = 600  # characters of a message, which may quote the name of a file
#: What samplers ask for, and the keys of the file that do it: draws decide on the draws of a stage.
ARGUMENTS = {
    "`draws` and `stage_draws`": "`sampler.draws`",
    "`draws` or `stage_draws`": "`sampler.draws`",
    "`stage_draws`": "`sampler.draws`",
    "`runs`": "`external.emulate`",
    "sample with sample_smc()": "leave out `external.emulate`",
}


def sentence(error: ValidationError, raw: dict) -> str:
    """The first error in words, and how many other places have one."""
    schema, found = Schema(), error.errors(include_url=False)
    places = [schema.place(e["loc"], raw) for e in found]
    more = len({path for path, *_ in places}) - 1
    first = words(found[0], *places[0])
    return f"{first} ({more} more after this one.)" if more else first


def words(error, path, meaning, entry, schema) -> str:
    """One error: "`key` must be ..., got ..."."""
    kind, given = error["type"], error["input"]
    if kind == "missing":
        return f"`{path}` must be given: {meaning}."
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        type_ = given.get("type") if isinstance(given, dict) else given
        got = "none" if type_ is None else shown(type_)
        return f"`{path}.type` must be one of {', '.join(schema.types())}, got {got}."
    if kind == "value_error":
        return f"`{path}` {error['ctx']['error']}."
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"`{path}` must be a table, got {shown(given)}."
    whole = re.sub(r"\[\d+\]$", "", path)  # the words are those of the list
    return f"`{whole}` must be {meaning}, got {shown(given)}{f' for {entry}' if entry else ''}."


def shown(value) -> str:
    """A value as the file has it, short."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


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


def refuse(config, keys: str, words: str) -> None:
    """Raise ConfigError at the first of some sections, or keys of sections, that a file has."""
    for key in keys.split():
        section, _, name = key.partition(".")
        owner = getattr(config, section) if name else config
        if owner is not None and (name or section) in owner.model_fields_set:
            raise ConfigError(f"`{key}` must be left out {words}")
