"""What a study has finished, on disk, so that it can be stopped and continued."""

import hashlib
import json
import os
from pathlib import Path

import xarray as xr

from pymc_features.exceptions import StudyMismatchError


class PartStore:
    """Finished parts of a study, one netCDF file each, in `folder/parts`; in memory without a folder.

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
        self.what = what
        self._memory: dict[str, xr.DataTree] = {}
        self.folder = None if folder is None else Path(folder)
        if self.folder is not None:
            (self.folder / "parts").mkdir(parents=True, exist_ok=True)
            self._check(settings)

    def _check(self, settings):
        path = self.folder / f"{self.what}.json"
        wanted = json.loads(json.dumps(settings))
        if not path.exists():
            write_atomically(path, lambda p: p.write_text(json.dumps(wanted, indent=2) + "\n"))
            return
        try:
            found = json.loads(path.read_text())
        except json.JSONDecodeError:
            found = {}
        different = [
            f"{key} = {found.get(key)!r} instead of {wanted.get(key)!r}"
            for key in wanted | found
            if found.get(key) != wanted.get(key)
        ]
        if different:
            raise StudyMismatchError(
                f"`out` must be empty or hold the same {self.what}, got {self.folder} with "
                f"{', '.join(different)}. Choose another folder, or delete this one."
            )

    def _path(self, name):
        return self.folder / "parts" / f"{name}.nc"

    def load(self, name: str) -> xr.DataTree | None:
        """Return a finished part, None if there is none."""
        if self.folder is None:
            return self._memory.get(name)
        if not self._path(name).exists():
            return None
        with xr.open_datatree(self._path(name), engine="h5netcdf") as tree:
            return tree.load()

    def save(self, name: str, part: xr.DataTree):
        """Keep a finished part; a file appears only when it is complete."""
        if self.folder is None:
            self._memory[name] = part
        else:
            write_atomically(self._path(name), lambda p: part.to_netcdf(p, engine="h5netcdf"))


def write_atomically(path: Path, write):
    """Call `write` on a temporary path beside `path`, then rename it into place."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def fingerprint(array) -> str:
    """SHA-256 of an array's bytes, to recognise a record by."""
    return hashlib.sha256(array.tobytes()).hexdigest()
