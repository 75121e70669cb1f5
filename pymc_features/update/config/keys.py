"""The parsed configuration file, its keys by the JSON schema, and messages that name them.

Neither PyMC nor pydantic is imported: a typo is said before seconds of imports.
"""

import difflib
import json
import re
import tomllib
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from pymc_features.exceptions import ConfigError, DatasetUnavailableError

SCHEMA = Path(__file__).with_name("schema.json")  # of `Config`; `python docs/tables.py` writes it anew
LARGEST = 2**63 - 1  # integers of TOML have 64 bits
LONGEST = 200  # characters of a key
OTHER = "of another kind"  # what a key must be that says nothing of itself
ENTRY = 80  # characters of a name that the user chose, in a message
MESSAGE = 600  # characters of a message, which may quote the name of a file
#: What samplers ask for, and the keys of the file that do it: draws decide on the draws of a stage.
ARGUMENTS = {
    "`draws` and `stage_draws`": "`sampler.draws`",
    "`draws` or `stage_draws`": "`sampler.draws`",
    "`stage_draws`": "`sampler.draws`",
    "Increase `draws`,": "Increase `sampler.draws`,",
    "`runs`": "`external.emulate`",
    "sample with sample_smc()": "leave out `external.emulate`",
}


def demand(holds, text: str) -> None:
    """Refuse what does not hold of a file, in a sentence."""
    if not holds:
        raise ConfigError(text)


def parsed(path) -> dict:
    """The tables of a configuration file, in which every key is known, or an error that names all others."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"`CONFIG` must be an existing file, got {path}. `pymc-features init` writes an example."
        )
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        check_sizes(raw)
        check_keys(raw)
    except ConfigError as error:
        raise ConfigError(f"{path.name}: {error}") from error
    except RecursionError:
        raise ConfigError(f"{path.name} must be a TOML file: lists in it are nested too deeply.") from None
    except ValueError as error:  # of TOML, of its encoding, or of a number with thousands of digits
        reason = str(error).partition(";")[0].rstrip(".")
        raise ConfigError(f"{path.name} must be a TOML file: {reason}.") from error
    return raw


def items_of(value, key: str):
    """Names, or numbers, and values of a table or a list at a key, and the keys of these values."""
    if isinstance(value, list):
        yield from ((number, item, f"{key}[{number}]") for number, item in enumerate(value))
    elif isinstance(value, dict):
        yield from ((name, item, f"{key}.{name}" if key else name) for name, item in value.items())


def check_sizes(value, key: str = "") -> None:
    """Refuse what would only fail later, in a conversion or in a message without end."""
    if isinstance(value, int) and abs(value) > LARGEST:
        raise ConfigError(f"`{key}` must be a number of at most 64 bits, got one of {value.bit_length()}.")
    for name, item, place in items_of(value, key):
        if len(str(name)) > LONGEST:
            at = f"`{key}`" if key else "the file"
            raise ConfigError(f"{at} must have keys of at most {LONGEST} characters, got {len(name)}.")
        check_sizes(item, place)


def check_keys(raw: dict) -> None:
    """Refuse unknown keys, all of them in one message."""
    if unknown := " ".join(unknown_keys([schema()], raw)):
        raise ConfigError(unknown)


@cache
def schema() -> dict:
    """The JSON schema of a file."""
    return json.loads(SCHEMA.read_text(encoding="utf-8"))


def choices(parts):
    """Yield all alternatives of some schemas, references and unions looked through."""
    for part in parts:
        if "$ref" in part:
            part = schema()["$defs"][part["$ref"].rpartition("/")[2]]
        either = part.get("anyOf", part.get("oneOf"))
        yield from [part] if either is None else choices(either)


def types(parts) -> list[str]:
    """What the key `type` of a table may be."""
    keys = (part.get("properties", {}).get("type", {}) for part in choices(parts))
    return [key["const"] for key in keys if "const" in key]


def tables(parts, value) -> list[dict]:
    """The alternatives that a value may be: objects for a table, of its `type` if it has one; arrays."""
    wanted = {dict: "object", list: "array"}.get(type(value))
    found = [part for part in choices(parts) if part.get("type") == wanted]
    named = value.get("type") if isinstance(value, dict) else None
    return [part for part in found if named in types([part])] or found


def below(parts, value, part) -> list[dict]:
    """Schemas of an item of a list, or of a key of a table; none of a key that is unknown."""
    of_value = tables(parts, value)
    if isinstance(value, list):
        return [one["items"] for one in of_value if "items" in one]
    known = [one["properties"][part] for one in of_value if part in one.get("properties", {})]
    others = [one.get("additionalProperties") for one in of_value]
    return known or [one for one in others if isinstance(one, dict)]


def unknown_keys(parts, value, at: str = ""):
    """Yield a sentence for every key of a value that is unknown."""
    of_value = tables(parts, value)
    for name, item, place in items_of(value, at) if of_value else ():
        if of_item := below(parts, value, name):
            yield from unknown_keys(of_item, item, place)
        elif all(one.get("additionalProperties", True) is False for one in of_value):
            known = list(dict.fromkeys(key for one in of_value for key in one["properties"]))
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"Did you mean `{close[0]}`?" if close else f"Known here: {', '.join(known)}."
            yield f"`{place}` must be left out, it is no key. {hint}"


def place_of(location, value) -> tuple[str, str, str, list[dict]]:
    """Keys of an error joined by dots, what the last of them must be, which entry it is, and its schemas.

    A `location` of pydantic has tags of unions and names of types besides: only what the file holds is
    followed, or a last key that is missing there. The user chose the names of entries of plain values.
    """
    path, words, entry, parts = "", OTHER, "", [schema()]
    for number, part in enumerate(location):
        of_part = below(parts, value, part)
        is_known = any(part in one.get("properties", ()) for one in tables(parts, value))
        held = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
        is_held = part in held
        if not is_held and not (is_known and number == len(location) - 1):
            continue
        if isinstance(part, int):
            path = f"{path}[{part}]"
        elif is_known or tables(of_part, {}):
            path = f"{path}.{part}" if path else str(part)
            words = next((one["description"] for one in of_part if "description" in one), OTHER)
        else:
            entry = str(part)[:ENTRY]
        value, parts = value[part] if is_held else None, of_part
    return path, words, entry, parts


def sentence(error, raw: dict) -> str:
    """The first error of pydantic in words, and how many other places have one."""
    found = error.errors(include_url=False)
    places = [place_of(one["loc"], raw) for one in found]
    more = len({re.sub(r"(\[\d+\])+$", "", path) for path, *_ in places}) - 1
    first = words(found[0], *places[0])
    return f"{first} ({more} more after this one.)" if more else first


def words(error, path, meaning, entry, parts) -> str:
    """One error: "`key` must be ..., got ..."."""
    kind, given = error["type"], error["input"]
    if kind == "missing":
        return f"`{path}` must be given: {meaning}."
    if kind in ("union_tag_invalid", "union_tag_not_found") and types(parts):
        type_ = given.get("type") if isinstance(given, dict) else given
        got = "none" if type_ is None else shown(type_)
        return f"`{path}.type` must be one of {', '.join(types(parts))}, got {got}."
    if kind == "extra_forbidden":
        return f"`{path}` must be left out here, got {shown(given)}."
    if kind == "value_error":
        text = str(error["ctx"]["error"])
        return f"`{path}` {text}{'' if text[-1] in '.?' else '.'}"
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
        text = text if len(text) <= MESSAGE else f"{text[:MESSAGE]}..."
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
