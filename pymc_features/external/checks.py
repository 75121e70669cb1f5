"""Settings of a simulator, checked before anything runs."""

import shlex
from os import PathLike
from pathlib import Path
from typing import NamedTuple

from pymc_features._checks import (
    LARGEST_COUNT,
    as_array,
    as_list,
    check_choice,
    check_flag,
    check_integer,
    check_mapping,
    check_path,
    is_number,
    message,
    shown,
    single,
    to_float,
)
from pymc_features.processes.executors import check_executor

RETURNS = ("response", "mean_square")


def check_simulator(function, shape, returns, gradient, version, dt):
    """Refuse what cannot be used of a simulator."""
    for name, value in (("function", function), ("gradient", gradient)):
        if not callable(value) and not (name == "gradient" and value is None):
            raise TypeError(f"`{name}` must be callable, got {type(value).__name__}.")
    sizes = as_array(shape).tolist() if as_array(shape).ndim == 1 else []
    if len(sizes) != 2 or not all(is_number(n) and n % 1 == 0 and 1 <= n <= LARGEST_COUNT for n in sizes):
        raise ValueError(
            f"`shape` must be (sensors, times) of the data, got {shown(shape)}. Pass data.shape."
        )
    check_choice(returns, "returns", RETURNS)
    check_seconds("dt", dt)
    if not (version is None or isinstance(version, str)):
        raise TypeError(f"`version` must be a text, got {shown(version)}.")


def check_evaluation(timeout, retries, executor, progress):
    """Refuse what cannot be used to run it."""
    check_seconds("timeout", timeout)
    check_flag(progress, "progress")
    check_integer(retries, "retries", least=0)
    check_executor(executor)


def check_seconds(name, value):
    """Refuse a time that is given and not positive."""
    number = single(value)
    if value is not None and not (is_number(number) and 0 < to_float(number) < float("inf")):
        raise ValueError(f"`{name}` must be a positive number of seconds, got {shown(value)}.")


class Program(NamedTuple):
    """Checked arguments of a `ProgramSimulator`."""

    command: list[str]
    parameters: tuple[str, ...]
    columns: tuple[int, ...] | None
    transpose: bool
    inputs: dict
    files: list[Path]


def checked_program(command, parameters, inputs, result, columns, transpose, files) -> Program:
    """Refuse what no program can be run with."""
    names, listed = as_list(parameters), as_list(files)
    if not names or not all(isinstance(p, str) and p.isidentifier() for p in names):
        raise ValueError(message("parameters", "a list of names", shown(parameters)))
    if not callable(result):
        if not isinstance(result, str):
            raise TypeError(message("result", "the name of a file or a function", shown(result)))
        check_path(result, "result")
    if listed is None:
        raise TypeError(message("files", "a list of paths", shown(files)))
    return Program(
        checked_command(command),
        tuple(names),
        None if columns is None else checked_columns(columns),
        check_flag(transpose, "transpose"),
        check_mapping(inputs, "inputs", "a dict of names of files to templates"),
        [check_path(path, "files") for path in listed],
    )


def checked_command(command) -> list[str]:
    """The words of a command."""
    if isinstance(command, str):
        try:
            words = shlex.split(command)
        except ValueError as error:
            got = f"{shown(command)} ({error})"
            raise ValueError(
                message("command", "split as by a shell", got, "Pass a list of words.")
            ) from None
    else:
        words = as_list(command)
    known = words is not None and all(isinstance(word, str | PathLike) or is_number(word) for word in words)
    if not known or (words and is_number(words[0])):
        raise TypeError(message("command", "a text or a list of words", shown(command)))
    words = [str(word) for word in words]
    if not words or not words[0]:
        raise ValueError("`command` must name a program, got nothing. Give it as a list of words.")
    if any("\0" in word for word in words):
        raise ValueError(message("command", "words without nulls", shown(command)))
    return words


def checked_columns(columns) -> tuple[int, ...]:
    """Numbers of columns."""
    array = as_array(columns)
    if array.ndim != 1 or not array.size or array.dtype.kind not in "iu":
        raise TypeError(message("columns", "a list of integers", shown(columns)))
    return tuple(array.tolist())
