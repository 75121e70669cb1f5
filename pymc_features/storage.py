"""What a study has finished, on disk, so that it can be stopped and continued."""

import hashlib
import json
import os
from contextlib import contextmanager
from datetime import datetime
from itertools import count
from pathlib import Path

import xarray as xr

from pymc_features._checks import says_where_it_is_full
from pymc_features.exceptions import StudyMismatchError

SUM, SUMMED = ".sha256", "parts_have_sums"  # folders without this key are older, and so are their parts


class PartStore:
    """Finished parts of a study, one netCDF file each, in `folder/parts`; in memory without a folder.

    Beside each file is one with a sum of its bytes, its name and the settings: a part that was damaged, or
    put there from elsewhere, is never taken for a result.

    Parameters
    ----------
    folder : path or None
        Where the study is kept; made if needed.
    settings : dict
        All that determines the results. A folder with other settings is refused.
    what : str
        What has these parts: the name of the file with the settings, and of it in messages.
    """

    def __init__(self, folder, settings: dict, what: str = "study"):
        self.folder, self.what = None if folder is None else Path(folder), what
        self.settings = json.loads(json.dumps(settings))
        self._memory: dict[str, xr.DataTree] = {}
        self.summed = True
        if self.folder is None:
            return
        try:
            (self.folder / "parts").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OSError(
                f"`out` must be a folder that can be written, got {error.filename}: {error.strerror}. "
                "Choose another."
            ) from error
        found, wanted = settings_in(self.folder, what), self.settings
        if found is None:
            text = json.dumps(wanted | {SUMMED: True}, indent=2)
            write_atomically(
                self.folder / f"{what}.json", lambda p: p.write_text(f"{text}\n", encoding="utf-8")
            )
            return
        self.summed = found.pop(SUMMED, False) is True
        if found != wanted:
            different = [
                f"{key} = {found.get(key)!r} instead of {wanted.get(key)!r}"
                for key in wanted | found
                if found.get(key) != wanted.get(key)
            ]
            raise StudyMismatchError(
                f"`out` must be empty or hold the same {what}, got {self.folder} with "
                f"{', '.join(different)}. Choose another folder, or delete this one (--force on the command "
                "line)."
            )

    def _path(self, name):
        return self.folder / "parts" / f"{name}.nc"

    def _sum(self, name, raw: bytes) -> str:
        about = json.dumps([name, self.settings], sort_keys=True)
        return hashlib.sha256(about.encode() + raw).hexdigest()

    def load(self, name: str) -> xr.DataTree | None:
        """Return a finished part, None if there is none."""
        if self.folder is None:
            return self._memory.get(name)
        path = self._path(name)
        beside = path.with_suffix(SUM)
        if not path.exists() or (self.summed and not beside.exists()):
            return None
        try:
            if beside.exists() and beside.read_text(encoding="utf-8").strip() != self._sum(
                name, path.read_bytes()
            ):
                raise ValueError("wrong sum")
            with xr.open_datatree(path, engine="h5netcdf") as tree:
                return tree.load()
        except Exception as error:  # HDF5 fails in many ways
            raise StudyMismatchError(
                f"`out` must hold parts of this {self.what} as they were written, got {path}, which is "
                f"damaged or from elsewhere ({str(error)[:100]}). Delete this file, and it is sampled again."
            ) from error

    def save(self, name: str, part: xr.DataTree):
        """Keep a finished part; a file appears only when it is complete."""
        if self.folder is None:
            self._memory[name] = part
            return
        path = self._path(name)
        path.unlink(missing_ok=True)  # a sum and a part that do not belong together are never there

        def write(temporary):
            raw = netcdf_bytes(part)
            temporary.write_bytes(raw)
            total = self._sum(name, raw)
            write_atomically(path.with_suffix(SUM), lambda p: p.write_text(f"{total}\n", encoding="utf-8"))

        write_atomically(path, write)


def netcdf_bytes(tree: xr.DataTree) -> bytes:
    """A tree as a netCDF file; made in memory, for HDF5 ends the process on a disk that is full."""
    return bytes(tree.to_netcdf(None, engine="h5netcdf"))


@contextmanager
def held(folder, what: str):
    """Keep other processes out of a folder; the system lets go of it when this one ends, however it ends.

    Raises
    ------
    StudyMismatchError
        If another process has it.
    """
    from filelock import FileLock, Timeout

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    about = folder / f".{what}.process"
    lock = FileLock(folder / f".{what}.lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        known = about.read_text(encoding="utf-8") if about.exists() else "another process"
        raise StudyMismatchError(
            f"`out` must be in use by one {what} at a time, got {folder}, which {known} is writing to. Wait "
            "for it, or choose another folder."
        ) from None
    try:
        start = datetime.now().strftime("%Y-%m-%d %H:%M:%S")
        who = f"process {os.getpid()}, started at {start},"
        write_atomically(about, lambda p: p.write_text(who, encoding="utf-8"))
        yield
    finally:
        about.unlink(missing_ok=True)
        lock.release()


def moved_aside(folder: Path) -> Path:
    """Rename a folder to the first of NAME-1, NAME-2, ... that is free, and return that."""
    names = (folder.with_name(f"{folder.name}-{number}") for number in count(1))
    return folder.rename(next(path for path in names if not path.exists()))


def remove_parts(folder, what: str) -> int:
    """Delete finished parts and the file with their settings, nothing else; return how many there were."""
    folder = Path(folder)
    parts = sorted((folder / "parts").glob("*.nc"))
    for path in parts:
        path.unlink()
        path.with_suffix(SUM).unlink(missing_ok=True)
    (folder / f"{what}.json").unlink(missing_ok=True)
    return len(parts)


def settings_in(folder: Path, what: str) -> dict | None:
    """The settings that a folder holds, None if it holds none.

    Raises
    ------
    StudyMismatchError
        If the file with them is damaged.
    """
    path = folder / f"{what}.json"
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found, dict):
            raise ValueError(f"no table but a {type(found).__name__}")
    except FileNotFoundError:
        return None
    except (ValueError, OSError, RecursionError) as error:
        raise StudyMismatchError(
            f"`out` must be empty or hold the same {what}, got {path}, which is damaged: {error}. Choose "
            f"another folder, or delete {folder}."
        ) from None
    return found


def write_atomically(path: Path, write):
    """Call `write` on a temporary path beside `path`, then rename it into place."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with says_where_it_is_full(path):
            write(temporary)
            os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def fingerprint(array) -> str:
    """SHA-256 of an array's bytes, to recognise a record by."""
    return hashlib.sha256(array.tobytes()).hexdigest()
