"""Every key of a configuration refuses what it cannot be."""

import typing

import pytest
from pydantic import BaseModel, ValidationError

from pymc_features.update.configuration import Config

IMPOSSIBLE = [[{"x": [[]]}]]  # lists of lists of tables are nothing that any key may be


def as_it_is(value):
    return value


def sections_in(annotation):
    """Sections in a type, unions looked through, each with what a list or a table makes of a value."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [(annotation, as_it_is)]
    around = {dict: lambda value: {"name": value}, list: lambda value: [value]}
    own = around.get(typing.get_origin(annotation), as_it_is)
    return [
        (section, lambda value, inner=inner: own(inner(value)))
        for part in typing.get_args(annotation)
        for section, inner in sections_in(part)
    ]


def keys_of(model, within=as_it_is, path=""):
    """Each key of a section and of those in it, with the file that has this key alone."""
    kind = typing.get_args(model.model_fields["type"].annotation)[:1] if "type" in model.model_fields else ()
    for name, field in model.model_fields.items():

        def alone(value, name=name):
            return within({"type": kind[0], name: value} if kind and name != "type" else {name: value})

        yield f"{path}{name}", alone
        for section, inner in sections_in(field.annotation):
            label = f"{path}{name}<{section.__name__}>."
            yield from keys_of(section, lambda value, inner=inner, alone=alone: alone(inner(value)), label)


KEYS = {key: alone for key, alone in keys_of(Config) if not key.endswith(".type")}


@pytest.mark.parametrize("key", KEYS)
def test_every_key_refuses_what_it_cannot_be(key):
    with pytest.raises(ValidationError) as caught:
        Config.model_validate(KEYS[key](IMPOSSIBLE))
    name = key.rpartition(".")[2]
    about = {error["type"] for error in caught.value.errors() if name in error["loc"]} - {"missing"}
    assert about and "extra_forbidden" not in about


def test_a_key_that_takes_anything_is_found():
    class Loose(BaseModel):
        inner: dict[str, typing.Any] | None = None

    [(key, alone)] = keys_of(Loose)
    assert key == "inner" and Loose.model_validate(alone({"x": IMPOSSIBLE})).inner["x"] == IMPOSSIBLE
    assert {"data<Data>.files<SensorFile>.anchors", "external<ExternalSection>.cache"} <= set(KEYS)
