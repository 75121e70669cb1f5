"""Functions that travel to worker processes by value: a program outside Python, a user's gradient."""

import re
import shlex
import subprocess
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

PLACE = re.compile(r"\{\{\s*([^\W\d]\w*)(?:\[(\d+)\])?(?::([^}]*))?\s*\}\}")
TAIL = 300  # characters of a program's last words that are kept


class ProgramSimulator:
    """A program: input files written from templates, a command run, a result file read.

    Parameters
    ----------
    command : str or sequence of str
        The program and its arguments; no shell. A string is split as a shell would.
    parameters : sequence of str
        Names of the parameters, in the order in which the simulator is called.
    inputs : dict of str to str or path-like
        For each file to be written its template: a text, or a `Path` to a file. `{{name}}` stands for a
        parameter with all its digits, `{{name[2]}}` for an entry of one that is an array, and
        `{{name:.3e}}` for a format of your own. Also in `command`.
    result : str or callable
        The file that the program leaves: `.npy`, `.csv` (commas) or text in columns. Or a function that reads
        the folder: path -> array.
    columns : sequence of int, optional
        Columns of the file that count, for example without that of the times. All by default.
    transpose : bool
        Rows of the file are times (the default) and become columns: (sensor, time).
    files : sequence of path-like
        Copied into the folder as they are.

    Raises
    ------
    ValueError, TypeError
        If a template names no parameter, or a file is missing.

    Notes
    -----
    Runs in the folder it is called in, a scratch folder of `ExternalSimulator`. An exit code other than zero
    is a failure, with the last line that the program wrote.

    Examples
    --------
    >>> import sys
    >>> program = "import sys, numpy; numpy.savetxt('out.txt', numpy.ones((3, 2)) / float(sys.argv[1]))"
    >>> halves = ProgramSimulator([sys.executable, "-c", program, "{{k}}"], ["k"], {}, "out.txt")
    >>> from pymc_features import ExternalSimulator
    >>> with ExternalSimulator(halves, shape=(2, 3), executor=1) as simulator:
    ...     simulator.responses([2.0])[0, 0]
    array([0.5, 0.5, 0.5])
    """

    needs_scratch = True

    def __init__(
        self,
        command: str | Sequence[str],
        parameters: Sequence[str],
        inputs: Mapping[str, str | Path],
        result: str | Callable[[Path], np.ndarray],
        *,
        columns: Sequence[int] | None = None,
        transpose: bool = True,
        files: Sequence[str | PathLike] = (),
    ):
        # here, because this class is sent to processes that are to import nothing of the package
        from pymc_features import _checks as checks

        names, paths = checks.as_list(parameters), checks.as_list(files)
        if not names or not all(isinstance(p, str) and p.isidentifier() for p in names):
            raise ValueError(checks.message("parameters", "a list of names", checks.shown(parameters)))
        if not callable(result):
            if not isinstance(result, str):
                what = "the name of a file or a function"
                raise TypeError(checks.message("result", what, checks.shown(result)))
            checks.check_path(result, "result")
        if paths is None:
            raise TypeError(checks.message("files", "a list of paths", checks.shown(files)))
        if columns is not None:
            array = checks.as_array(columns)
            if array.ndim != 1 or not array.size or array.dtype.kind not in "iu":
                raise TypeError(checks.message("columns", "a list of integers", checks.shown(columns)))
            columns = tuple(array.tolist())
        self.command, self.parameters = words_of(command), tuple(names)
        self.result, self.columns = result, columns
        self.transpose = checks.check_flag(transpose, "transpose")
        inputs = checks.check_mapping(inputs, "inputs", "a dict of names of files to templates")
        self.inputs = {str(name): template_text(name, text) for name, text in inputs.items()}
        for where, text in [*self.inputs.items(), *(("command", word) for word in self.command)]:
            self.check_places(where, text)
        paths = [checks.check_path(path, "files") for path in paths]
        self.files = {path.name: (read_bytes(path, "files"), path.stat().st_mode) for path in paths}

    def check_places(self, where: str, text: str) -> None:
        """Refuse a template that asks for what is not there."""
        for name, _, form in PLACE.findall(text):
            if name not in self.parameters:
                raise ValueError(
                    f"`inputs` must name parameters ({', '.join(self.parameters)}), got {name!r} in {where}."
                )
            try:
                format(1.0, form.rstrip())
            except ValueError:
                raise ValueError(
                    f"`inputs` must have formats of numbers, such as .3e, got {form!r} in {where}."
                ) from None

    def __call__(self, *values: ArrayLike) -> np.ndarray:
        if len(values) != len(self.parameters):
            raise TypeError(f"the program has {len(self.parameters)} parameters, got {len(values)}")
        known = dict(zip(self.parameters, values, strict=True))
        for name, (content, mode) in self.files.items():
            Path(name).write_bytes(content)
            Path(name).chmod(mode)  # a program among them runs
        for name, text in self.inputs.items():
            Path(name).parent.mkdir(parents=True, exist_ok=True)
            Path(name).write_text(filled(text, known), encoding="utf-8")
        command = [filled(word, known) for word in self.command]
        done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL)
        if done.returncode:
            words = (done.stderr or done.stdout).decode(errors="replace").strip()[-TAIL:].splitlines()
            raise RuntimeError(f"exit code {done.returncode}" + (f": {words[-1]}" if words else ""))
        return self.read()

    def read(self) -> np.ndarray:
        """The result as (sensor, time), or as the user's function gives it."""
        if callable(self.result):
            return self.result(Path.cwd())
        path = Path(self.result)
        if not path.exists():
            raise FileNotFoundError(f"the program left no {self.result}")
        if path.suffix == ".npy":
            table = np.load(path, allow_pickle=False)
        else:
            table = np.loadtxt(path, delimiter="," if path.suffix == ".csv" else None, ndmin=2)
        if self.columns is not None:
            table = table[:, self.columns]
        return table.T if self.transpose else table


def words_of(command) -> list[str]:
    """The words of a command."""
    from pymc_features._checks import as_list, is_number, message, shown

    if isinstance(command, str):
        try:
            words = shlex.split(command)
        except ValueError as error:
            got = f"{shown(command)} ({error})"
            what = "split as by a shell"
            raise ValueError(message("command", what, got, "Pass a list of words.")) from None
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


def template_text(name, template) -> str:
    """The text of a template, or of the file it is in."""
    if isinstance(template, Path):
        return read_bytes(template, "inputs").decode()
    if not isinstance(template, str):
        raise TypeError(f"`inputs` must give a text or a Path for {name}, got {type(template).__name__}.")
    return template


def read_bytes(path, name: str) -> bytes:
    """Contents of a file that must be there."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"`{name}` must be an existing file, got {path} ({error.strerror}).") from None


def filled(text: str, values: dict) -> str:
    """A template with its parameters; numbers with all their digits."""

    def number(match):
        name, index, form = match.groups()
        value = values[name] if index is None else np.ravel(values[name])[int(index)]
        return format(float(value), form.rstrip()) if form else repr(float(value))

    return PLACE.sub(number, text)


class FlatGradient:
    """Gradients by all parameters, one behind the other, of `gradient(*parameters, cotangent)`."""

    def __init__(self, gradient):
        self.gradient = gradient

    def __call__(self, *parameters_and_cotangent):
        *parameters, _ = parameters_and_cotangent
        results = self.gradient(*parameters_and_cotangent)
        if len(parameters) == 1 and np.shape(results) == np.shape(parameters[0]):
            results = [results]
        if [np.shape(r) for r in results] != [np.shape(p) for p in parameters]:
            raise ValueError(
                f"`gradient` must return arrays of the shapes {[np.shape(p) for p in parameters]}, got "
                f"{[np.shape(r) for r in results]}."
            )
        return np.concatenate([np.ravel(r) for r in results])
