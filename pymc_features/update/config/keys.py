"""The parsed configuration file, and its keys, all known: what needs neither PyMC nor seconds of imports."""

import difflib
import json
import tomllib
from pathlib import Path

from pymc_features.exceptions import ConfigError

SCHEMA = Path(__file__).with_name("schema.json")  # of `Config`; `python docs/tables.py` writes it anew
LARGEST = 2**63 - 1  # integers of TOML have 64 bits
DEEPEST = 16  # tables and lists within each other
LONGEST = 200  # characters of a key


def check_sizes(value, key: str = "", depth: int = 0) -> None:
    """Refuse what would only fail later, in a conversion, by a recursion or in a message without end."""
    if isinstance(value, int) and abs(value) > LARGEST:
        raise ConfigError(f"`{key}` must be a number of at most 64 bits, got one of {value.bit_length()}.")
    if not isinstance(value, dict | list):
        return
    if depth > DEEPEST:
        raise ConfigError(f"`{key}` must have at most {DEEPEST} tables or lists within each other, got more.")
    if isinstance(value, list):
        for number, item in enumerate(value):
            check_sizes(item, f"{key}[{number}]", depth + 1)
        return
    for name, item in value.items():
        if len(name) > LONGEST:
            at = f"`{key}`" if key else "the file"
            raise ConfigError(f"{at} must have keys of at most {LONGEST} characters, got {len(name)}.")
        check_sizes(item, f"{key}.{name}" if key else name, depth + 1)


def parsed(path) -> dict:
    """The tables of a configuration file, in which every key is known.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ConfigError
        If it is not TOML, or keys are unknown: all of them, each with the nearest known one.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"`CONFIG` must be an existing file, got {path}. `pymc-features init` writes an example."
        )
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        check_sizes(raw)
    except ConfigError as error:
        raise ConfigError(f"{path.name}: {error}") from error
    except RecursionError:
        raise ConfigError(f"{path.name} must be a TOML file: lists in it are nested too deeply.") from None
    except ValueError as error:  # of TOML, of its encoding, or of a number with thousands of digits
        reason = str(error).partition(";")[0].rstrip(".")
        raise ConfigError(f"{path.name} must be a TOML file: {reason}.") from error
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    if unknown := list(unknown_keys(raw, schema, schema["$defs"])):
        raise ConfigError(f"{path.name}: {' '.join(unknown)}")
    return raw


def unknown_keys(value, schema: dict, definitions: dict, at: str = ""):
    """A sentence for every key of a value that its JSON schema does not have."""
    tables = list(tables_of(value, schema, definitions))
    if isinstance(value, list):
        items = [one["items"] for one in tables if "items" in one]
        for number, item in enumerate(value):
            yield from unknown_keys(item, {"anyOf": items}, definitions, f"{at}[{number}]")
    if not isinstance(value, dict) or not tables:
        return
    is_open = any(one.get("additionalProperties", True) is not False for one in tables)
    known = {key: part for one in tables for key, part in one.get("properties", {}).items()}
    others = [
        one["additionalProperties"] for one in tables if isinstance(one.get("additionalProperties"), dict)
    ]
    for name, item in value.items():
        place = f"{at}.{name}" if at else name
        if name in known or others:
            part = known.get(name, {"anyOf": others})
            yield from unknown_keys(item, part, definitions, place)
        elif not is_open:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"Did you mean `{close[0]}`?" if close else f"Known here: {', '.join(known)}."
            yield f"`{place}` must be left out, it is no key. {hint}"


def tables_of(value, schema: dict, definitions: dict):
    """The parts of a schema that a value may be one of: objects for a table, arrays for a list."""
    if "$ref" in schema:
        schema = definitions[schema["$ref"].rpartition("/")[2]]
    choices = schema.get("anyOf", schema.get("oneOf"))
    if choices is None:
        wanted = {dict: "object", list: "array"}.get(type(value))
        if schema.get("type") == wanted:
            yield schema
        return
    mapping = schema.get("discriminator", {}).get("mapping", {})
    named = value.get("type") if isinstance(value, dict) else None
    if mapping and named in mapping:
        choices = [{"$ref": mapping[named]}]
    for choice in choices:
        yield from tables_of(value, choice, definitions)
