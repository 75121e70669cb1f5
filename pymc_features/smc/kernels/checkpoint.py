"""A journal of a sampler's evaluations, by which a run that was killed goes on as if nothing had happened.

A kernel is deterministic given its random numbers and the results of its evaluations. So these are written
down as they come; a run started again asks for the same particles, and is given the results on record until
there are no more of them. Its particles are then those of an uninterrupted run, bit for bit.
"""

import hashlib
import io
import json
import operator
import os
import re
import struct
import threading
import zlib
from pathlib import Path

import numpy as np
import pytensor
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant
from pytensor.graph.traversal import ancestors
from pytensor.tensor.random.type import RandomGeneratorType

from pymc_features._checks import says_where_it_is_full
from pymc_features.exceptions import CheckpointError
from pymc_features.system import lock_file

MAGIC = b"pymc_features journal 2\n"
HEAD = struct.Struct("<QQI")  # rows and columns of the particles, CRC-32 of the run and what follows
ONE_CHAIN = threading.Lock()  # of those in threads, at a time, says what run this is
VALUES = 3  # log prior, log-likelihood, failed, each (p,); arrays (p, d) of gradients may follow
ADVICE = "Choose another folder, or remove this one to begin anew."


class Journal:
    """The evaluations of one chain.

    Parameters
    ----------
    path : Path
        The file; continued if it exists.
    run : str
        What the evaluations belong to; it is part of every sum.

    Raises
    ------
    CheckpointError
        If it is damaged, or another process writes to it.

    Notes
    -----
    An incomplete record at the end, of a run that was killed while it wrote, is dropped. Plain binary
    numbers; nothing is pickled.
    """

    def __init__(self, path: Path, run: str = ""):
        self.path, self.start = path, zlib.crc32(run.encode())
        try:
            self.file = open(path, "a+b")  # noqa: SIM115  open as long as the chain runs
        except OSError as error:
            raise CheckpointError(
                f"`checkpoint` must hold files that can be written, got {path}: {error.strerror}. {ADVICE}"
            ) from error
        try:
            lock_file(self.file)
        except OSError:
            raise CheckpointError(
                f"`checkpoint` must belong to one run at a time, got {path} in use. Wait for the other one."
            ) from None
        self.file.seek(0)
        start = self.file.read(len(MAGIC))
        if start != MAGIC[: len(start)]:
            raise CheckpointError(f"`checkpoint` must hold journals of a sampler, got {path}. {ADVICE}")
        self.end = self.file.tell()
        if len(start) < len(MAGIC):
            self.file.truncate(0)
            self.file.write(MAGIC)
            self.file.flush()
            self.end = len(MAGIC)
        self.replays = True

    def evaluate(self, function, particles: np.ndarray, n_gradients: int = 0):
        """Results of a function of particles (p, d): from the record, or computed and added.

        They are log prior, log-likelihood and failed, each (p,), and behind them `n_gradients` arrays (p, d).
        """
        if self.replays:
            known = self.read(*particles.shape, n_gradients)
            if known is not None:
                if not np.array_equal(known[0], particles, equal_nan=True):
                    raise CheckpointError(
                        f"`checkpoint` must be of this run, got other particles in {self.path}. It was "
                        f"written by another version of the software or another model. {ADVICE}"
                    )
                _, prior, likelihood, failed, *gradients = known
                return prior, likelihood, failed.astype(bool), *gradients
            self.replays = False
            self.file.truncate(self.end)
            self.file.seek(self.end)
        results = function(particles)
        self.write(particles, results)
        return results

    def read(self, rows, columns, n_gradients=0):
        """Particles, values and gradients of the next record; None at the end."""
        head = self.file.read(HEAD.size)
        if len(head) < HEAD.size:
            return None
        n, d, check = HEAD.unpack(head)
        size = 8 * n * (d + VALUES + n_gradients * columns)
        if (n, d) != (rows, columns):
            # a damaged head must not make us read gigabytes
            raise CheckpointError(
                f"`checkpoint` must be of this run, got {n} particles of {d} parameters for {rows} of "
                f"{columns} in {self.path}: it is damaged, or of another run. {ADVICE}"
            )
        body = self.file.read(size)
        if len(body) < size:
            return None
        if zlib.crc32(body, self.start) != check:
            raise CheckpointError(
                f"`checkpoint` must be intact, got a wrong sum in {self.path}: it is damaged, or of another "
                f"run. {ADVICE}"
            )
        self.end = self.file.tell()
        numbers = np.frombuffer(body, dtype=np.float64)
        particles, values, gradients = np.split(numbers, [n * d, n * (d + VALUES)])
        gradients = gradients.reshape(n_gradients, n, d)
        return particles.reshape(n, d), *(a.copy() for a in (*values.reshape(VALUES, n), *gradients))

    def write(self, particles, results):
        """Add a record; what is written outlives the process."""
        body = io.BytesIO()
        for array in (particles, *results):
            body.write(np.ascontiguousarray(array, dtype=np.float64).tobytes())
        body = body.getvalue()
        with says_where_it_is_full(self.path):
            self.file.write(HEAD.pack(*particles.shape, zlib.crc32(body, self.start)) + body)
            self.file.flush()

    def close(self):
        """Close the file."""
        self.file.close()


def evaluated(journal: Journal | None, function, particles: np.ndarray, n_gradients: int = 0):
    """Results of a function of particles (p, d), remembered where there is a journal; see there."""
    return function(particles) if journal is None else journal.evaluate(function, particles, n_gradients)


def chain_journal(folder, run: dict, rng: np.random.Generator) -> Journal:
    """The journal, in a folder that is made if absent, of the chain that begins with these random numbers.

    Raises
    ------
    CheckpointError
        If the folder belongs to another run.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with ONE_CHAIN:
        run = claimed(folder, run)
    state = json.dumps(rng.bit_generator.state, sort_keys=True, default=int)
    name = hashlib.sha256(state.encode()).hexdigest()[:16]
    return Journal(folder / f"{name}.journal", json.dumps(run, sort_keys=True))


def claimed(folder: Path, run: dict) -> dict:
    """Write what run this is, or compare; return it as it is written."""
    run = json.loads(json.dumps(run, default=float))
    path = folder / "run.json"
    known = read_json(path)
    if known is None and any(folder.glob("*.journal")):
        known = read_json(path)  # another chain's process may just have written both
        if known is None:
            raise CheckpointError(f"`checkpoint` must have a run.json, got none in {folder}. {ADVICE}")
    if known is None:
        write_json(path, run)
    elif differing := sorted(k for k in run if known.get(k) != run[k]):
        raise CheckpointError(
            f"`checkpoint` must be of this run, got {folder} of one with other: "
            f"{', '.join(differing)}. {ADVICE}"
        )
    return run


def remembered(folder, random_seed, chains, default_chains):
    """Seed and number of chains: those given, or of the checkpoint's run, or new ones, kept there."""
    path = Path(folder) / "seed.json"
    known = read_json(path)
    try:
        asked = None if random_seed is None else [operator.index(s) for s in np.ravel(random_seed)]
    except TypeError:
        raise TypeError(
            f"`random_seed` must be integers with `checkpoint`, got {random_seed!r}. Or leave it out: the "
            "checkpoint keeps one."
        ) from None
    if known is None:
        known = {
            "random_seed": asked or [int(np.random.default_rng().integers(2**31))],
            "chains": default_chains if chains is None else chains,
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, known)
    elif asked not in (None, known["random_seed"]) or chains not in (None, known["chains"]):
        raise CheckpointError(
            f"`checkpoint` must be of this run, got {folder} of one with random_seed="
            f"{known['random_seed']}, chains={known['chains']}. {ADVICE}"
        )
    seeds = known["random_seed"]
    return seeds if len(seeds) > 1 else seeds[0], known["chains"]


def model_fingerprint(model) -> str:
    """SHA-256 of a model's log-probability: its graph, constants and data.

    Simulators of ours count with what they do; of other functions called by it only the name.
    """
    outputs = [model.varlogp, model.datalogp]
    text = pytensor.dprint(outputs, file="str", id_type="CHAR")
    digest = hashlib.sha256(re.sub(r"0x[0-9a-fA-F]+", "", text).encode())
    for v in ancestors(outputs):
        if isinstance(v.type, RandomGeneratorType):
            continue
        if isinstance(v, Constant | SharedVariable):
            value = np.asarray(v.data if isinstance(v, Constant) else v.get_value(borrow=True))
            digest.update(repr(value.shape).encode())
            if value.dtype != object:
                digest.update(value.tobytes())
        op = getattr(v.owner, "op", None)
        for called in (op, getattr(op, "fn", None)):
            identity = getattr(called, "identity", None)
            if isinstance(identity, str):
                digest.update(identity.encode())
    return digest.hexdigest()


def read_json(path):
    """Contents of a JSON file of `write_json`, None if there is none."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict) or content.pop("crc32", None) != checksum(content):
            raise ValueError("a wrong sum")
        return content
    except FileNotFoundError:
        return None
    except (ValueError, OSError, RecursionError) as error:
        raise CheckpointError(f"`checkpoint` must be intact, got {path}: {error}. {ADVICE}") from None


def write_json(path, content):
    """Write a JSON file that is there in whole or not at all, with a sum of what it holds."""
    part = path.with_suffix(f".{os.getpid()}.part")
    try:
        with says_where_it_is_full(path):
            text = json.dumps(content | {"crc32": checksum(content)}, indent=1, sort_keys=True)
            part.write_text(text, encoding="utf-8")
            os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def checksum(content: dict) -> int:
    """CRC-32 of what a JSON file holds."""
    return zlib.crc32(json.dumps(content, sort_keys=True).encode())
